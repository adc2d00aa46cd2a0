"""Decodes UBX and NMEA bytes to fixes and satellites, and encodes configuration requests as UBX."""

from collections import Counter
from collections.abc import Iterator

from pydantic import Field

from shared.faults import Faults
from shared.kinds import Kinds
from shared.maths.dates import DeviceDates
from shared.messages.base import Message, Tick
from shared.messages.corrections import CorrectionsState
from shared.messages.gnss import CarrierSolution, GnssConfigure, GnssFix, GnssRaw, GnssReceiver, GnssReset, GnssWrite
from shared.messages.operation import DeviceState
from shared.runtime.config import Section

from .dialect import Output, Stream
from .receiver import Receiver

MAX_RECEIVERS = 8
CORRECTED_NS = 60_000_000_000  # after the last correction: RTK engines use one for at most a minute


class Config(Section):
    """Settings of the GNSS parser."""

    minimum_delay_s: float = Field(
        default=0.05, ge=0.0, description="minimum delay from a GNSS epoch to its first received byte"
    )
    use_receiver_imu: bool = Field(
        default=False,
        description="whether the inertial sensors inside the receiver (UBX-ESF-RAW), or of a phone, are used as an IMU",
    )
    metres_per_wheel_tick: float = Field(
        default=0.0, ge=0.0, le=10.0, description="distance of a wheel tick of UBX-ESF-MEAS; 0: ticks are not used"
    )


class Process:
    """One `Receiver` per source; time is taken from the stamps of the messages only."""

    def __init__(self, config: Config) -> None:
        self.rejects: Counter[str] = Counter()
        self.kinds = Kinds()
        self._config = config
        self._receivers: dict[str, Receiver] = {}
        self._now_ns = 0
        self._corrections: CorrectionsState | None = None  # the newest with a source

    def handle(self, message: Message) -> Iterator[Output | GnssReceiver | GnssWrite]:
        """Process raw bytes, a request for a receiver, or a tick."""
        match message:
            case GnssRaw() | GnssConfigure() | GnssReset() | DeviceState(process="sensors.gnss"):
                if receiver := self._receiver(message.source):
                    yield from self._of_receiver(receiver, message)
            case CorrectionsState(active=str()):
                self._corrections = message
            case Tick():
                self._now_ns = message.now_ns
                yield from self._tick()

    def _of_receiver(
        self, receiver: Receiver, message: GnssRaw | GnssConfigure | GnssReset | DeviceState
    ) -> Iterator[Output | GnssWrite]:
        match message:
            case GnssRaw():
                self._now_ns = message.received_ns
                yield from map(self._with_source, receiver.take(message))
            case GnssConfigure():
                yield from receiver.configure(message, self._now_ns)
            case GnssReset():
                yield from receiver.restart(message.start, self._now_ns)
            case DeviceState():
                receiver.rate_baud = message.rate_baud

    def _tick(self) -> Iterator[Output | GnssReceiver | GnssWrite]:
        for receiver in self._receivers.values():
            yield from receiver.tick(self._now_ns)
            if said := receiver.seen.statement(self._now_ns):
                yield said

    def _with_source(self, output: Output | GnssWrite) -> Output | GnssWrite:
        """Add the source of corrections to a fix that the receiver has made with corrections."""
        given = self._corrections
        if given is None or not isinstance(output, GnssFix) or self._now_ns - given.sampled_ns > CORRECTED_NS:
            return output
        corrected = output.differential or output.carrier_solution is not CarrierSolution.NONE
        return output.model_copy(update={"correction_source": given.active}) if corrected else output

    def _receiver(self, source: str) -> Receiver | None:
        if source not in self._receivers:
            if len(self._receivers) >= MAX_RECEIVERS:
                self.rejects["too_many_sources"] += 1
                return None
            config = self._config
            stream = Stream(
                source, self.rejects, DeviceDates(self.rejects), Faults(self.rejects), config.minimum_delay_s,
                uses_imu=config.use_receiver_imu, metres_per_wheel_tick=config.metres_per_wheel_tick,
            )  # fmt: skip
            self._receivers[source] = Receiver(stream, self.kinds)
        return self._receivers[source]
