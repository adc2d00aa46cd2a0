"""Passes whole frames of corrections on, from the best source that delivers, and states what came of each source."""

from collections import Counter
from collections.abc import Iterator
from itertools import groupby

from pydantic import Field

from shared.messages.base import Message, Tick
from shared.messages.corrections import (
    MAX_CORRECTION_SOURCES,
    MAX_CORRECTION_TYPES,
    CorrectionBytes,
    CorrectionProtocol,
    CorrectionSources,
    CorrectionsState,
    GnssCorrection,
    SourcePhase,
)
from shared.runtime.config import Section

from .choice import Choice
from .frames import CorrectionFrame
from .names import name_of
from .stream import NS, Stream

OTHER = "other"


class Config(Section):
    """Settings of the parser of corrections."""

    silent_s: float = Field(
        default=30.0,
        gt=0.0,
        le=600.0,
        description="time without a valid frame after which a source is replaced by the next one in the list",
    )
    settle_s: float = Field(
        default=10.0,
        ge=0.0,
        le=600.0,
        description="time for which a preferred source must deliver again until it replaces the present one",
    )


class Process:
    """One `Stream` a source; time is taken from the stamps of the messages only."""

    def __init__(self, config: Config) -> None:
        self.rejects: Counter[str] = Counter()
        self._silent_ns = round(config.silent_s * NS)
        self._streams: dict[str, Stream] = {}  # the preferred one first, once the driver has stated the order
        self._choice = Choice(round(config.settle_s * NS))
        self._types: Counter[str] = Counter()
        self._forwarded_bytes = 0
        self._forwarded_ns: int | None = None
        self._protocol: CorrectionProtocol | None = None
        self._now_ns = 0

    def handle(self, message: Message) -> Iterator[GnssCorrection | CorrectionsState]:
        """Process bytes of a source, the state of the connections, or a tick."""
        before = self._choice.active
        match message:
            case CorrectionBytes():
                self._now_ns = max(self._now_ns, message.received_ns)
                yield from self._take(message)
            case CorrectionSources():
                self._now_ns = max(self._now_ns, message.now_ns)
                self._order(message)
            case Tick():
                self._now_ns = message.now_ns
                self._choice.update(list(self._streams.values()), self._now_ns)
        if isinstance(message, Tick) or self._choice.active is not before:
            yield self._state()

    def _take(self, message: CorrectionBytes) -> Iterator[GnssCorrection]:
        stream = self._stream(message.source)
        if stream is None:
            return
        frames = stream.take(message.data, self._now_ns)
        self._choice.update(list(self._streams.values()), self._now_ns)
        if self._choice.active is not stream:
            return
        for protocol, group in groupby(frames, key=lambda frame: frame.protocol):
            yield self._correction(message, protocol, list(group))

    def _correction(
        self, message: CorrectionBytes, protocol: CorrectionProtocol, frames: list[CorrectionFrame]
    ) -> GnssCorrection:
        data = b"".join(frame.data for frame in frames)
        for frame in frames:
            name = name_of(frame.protocol, frame.kind)
            self._types[name if name in self._types or len(self._types) < MAX_CORRECTION_TYPES else OTHER] += 1
        self._forwarded_bytes += len(data)
        self._forwarded_ns, self._protocol = self._now_ns, protocol
        return GnssCorrection(
            received_ns=message.received_ns, source=message.source, data=data, protocol=protocol, frames=len(frames)
        )

    def _stream(self, source: str) -> Stream | None:
        if source not in self._streams:
            if len(self._streams) >= MAX_CORRECTION_SOURCES:
                self.rejects["too_many_sources"] += 1
                return None
            self._streams[source] = Stream(source, self.rejects, self._silent_ns)
        return self._streams[source]

    def _order(self, message: CorrectionSources) -> None:
        """Take over the order of the driver; sources that it does not name any more are forgotten."""
        known, self._streams = self._streams, {}
        for connection in message.sources:
            stream = known.get(connection.source) or Stream(connection.source, self.rejects, self._silent_ns)
            stream.connection = connection
            self._streams[connection.source] = stream
        self._choice.update(list(self._streams.values()), self._now_ns)

    def _state(self) -> CorrectionsState:
        active = self._choice.active
        streams = tuple(stream.statement(self._now_ns) for stream in self._streams.values())
        return CorrectionsState(
            sampled_ns=self._now_ns,
            active=active.source if active else None,
            since_ns=self._choice.since_ns if active else None,
            reason=f"corrections from {active.source}" if active else self._why_none(),
            protocol=self._protocol if active else None,
            frame_age_s=None if self._forwarded_ns is None else max(self._now_ns - self._forwarded_ns, 0) / NS,
            forwarded_bytes=self._forwarded_bytes,
            types=dict(self._types),
            rejects=dict(self.rejects),
            streams=streams,
        )

    def _why_none(self) -> str:
        """Say of the preferred source why it delivers nothing."""
        if not self._streams:
            return "no corrections: sensors.corrections has not stated its sources"
        streams = [stream.statement(self._now_ns) for stream in self._streams.values()]
        first = next((stream for stream in streams if stream.phase is not SourcePhase.IDLE), streams[0])
        return f"no corrections: {first.source}: {first.reason or 'no frame yet'}"[:400]
