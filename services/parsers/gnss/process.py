"""Decodes UBX and NMEA bytes to fixes and satellites, and encodes configuration requests as UBX."""

from collections import Counter
from collections.abc import Iterator

from pydantic import Field

from shared.kinds import Kinds
from shared.messages.base import Message, Tick
from shared.messages.gnss import GnssConfigure, GnssRaw, GnssReceiver, GnssWrite
from shared.messages.operation import DeviceState
from shared.runtime.config import Section

from .dialect import Output
from .receiver import Receiver

MAX_RECEIVERS = 8


class Config(Section):
    """Settings of the GNSS parser."""

    minimum_delay_s: float = Field(
        default=0.05, ge=0.0, description="minimum delay from a GNSS epoch to its first received byte"
    )


class Process:
    """One `Receiver` per source; time is taken from the stamps of the messages only."""

    def __init__(self, config: Config) -> None:
        self.rejects: Counter[str] = Counter()
        self.kinds = Kinds()
        self._config = config
        self._receivers: dict[str, Receiver] = {}
        self._now_ns = 0

    def handle(self, message: Message) -> Iterator[Output | GnssReceiver | GnssWrite]:
        """Process raw bytes, a configuration request or a tick."""
        match message:
            case GnssRaw():
                self._now_ns = message.received_ns
                if receiver := self._receiver(message.source):
                    yield from receiver.take(message)
            case GnssConfigure():
                if receiver := self._receiver(message.source):
                    yield from receiver.configure(message, self._now_ns)
            case DeviceState():
                if receiver := self._receiver(message.source):
                    receiver.rate_baud = message.rate_baud
            case Tick():
                self._now_ns = message.now_ns
                for receiver in self._receivers.values():
                    yield from receiver.tick(self._now_ns)
                    if said := receiver.seen.statement(self._now_ns):
                        yield said

    def _receiver(self, source: str) -> Receiver | None:
        if source not in self._receivers:
            if len(self._receivers) >= MAX_RECEIVERS:
                self.rejects["too_many_sources"] += 1
                return None
            self._receivers[source] = Receiver(
                source, minimum_delay_s=self._config.minimum_delay_s, rejects=self.rejects, kinds=self.kinds
            )
        return self._receivers[source]
