"""Publishes a recording in place of every process: at its pace, faster or slower, from any position."""

import logging
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from pydantic import Field

from shared.bus.bus import Bus, Envelope
from shared.errors import BadPayload, BadRecording, UserError
from shared.library.summary import SummaryWorker
from shared.messages.fitting import fitting
from shared.messages.operation import Origin, OriginKind
from shared.messages.replay import FASTEST, SLOWEST, ReplayCommand, ReplayControl, ReplayEvents, ReplayState
from shared.recording import Recording
from shared.recording.index import RecordingIndex
from shared.runtime.config import Section

from .position import Position
from .selection import PLOTTED, Thinning, playable, shown

log = logging.getLogger(__name__)

STATE_S, ORIGIN_S = 0.1, 2.0
STEP_S = 0.02  # of the host's clock, between two looks for messages that are due
SETTLING_TIME_S = 0.3  # after the last jump: then the past minute follows
PAST_NS, RECENT_NS = 60_000_000_000, 3_000_000_000
OUTAGES_BYTES = 190_000  # in one message, beside 500 changes of the verdict
MAX_BURST = 100  # messages between two turns of the network
WATCHED_NICE = 5  # of the computation of events that somebody waits for


class Config(Section):
    """The recording and how it is played."""

    file: str = Field(default="", description="recording with an index, as `obu record repair` writes it")
    speed: float = Field(default=1.0, ge=SLOWEST, le=FASTEST, description="recorded seconds per second, at the start")
    summaries: str | None = Field(
        default=None, description="folder that keeps the summary if none is beside the recording; `obu replay` sets it"
    )


class Process:
    """Publishes each message when it is due; after a jump the newest message of every topic, then the past minute."""

    def __init__(self, config: Config) -> None:
        if not config.file:
            raise UserError("[sensors.replay] names no file; use `obu replay FILE`")
        self._config = config
        self._path = Path(config.file)
        self._epoch = 0
        self._thinning = Thinning()
        self._received: list[Envelope] = []  # while messages were being sent

    def run(self, bus: Bus) -> None:
        """Publish until `bus.stopping`; at the end of the recording the replay pauses."""
        with Recording(self._path) as recording:
            try:
                self._index = RecordingIndex(recording)
            except BadRecording as error:
                raise UserError(f"{error}; make one that has with `obu record repair FILE -o whole.mcap`") from error
            self._position = Position(self._index.begin_ns, self._index.end_ns, self._config.speed, time.monotonic())
            self._all, self._shown = playable(self._index.topics), shown(self._index.topics)
            events = SummaryWorker(self._path, Path(self._config.summaries or bus.state_dir), nice=WATCHED_NICE)
            try:
                self._play(bus, events)
            finally:
                events.stop()

    def _play(self, bus: Bus, events: SummaryWorker) -> None:
        played_ns, settle_s = self._index.begin_ns - 1, 0.0
        state_s = origin_s = 0.0
        summarised = False
        while not bus.stopping:
            jumped = self._controls([*self._received, *bus.receive(STEP_S)])
            self._received.clear()
            now_s = time.monotonic()
            ended = self._position.stop_at_end(now_s)
            until_ns = self._position.at(now_s)
            if jumped or (settle_s and now_s >= settle_s):
                self._jump(bus, until_ns, past=not jumped)
                played_ns, settle_s, origin_s = until_ns, now_s + SETTLING_TIME_S if jumped else 0.0, 0.0
            elif until_ns > played_ns and not settle_s:
                self._send(bus, self._due(played_ns, until_ns))
                played_ns = until_ns
            if now_s >= origin_s:
                origin_s = now_s + ORIGIN_S
                self._say_origin(bus, until_ns)
            if now_s >= state_s or jumped or ended:
                state_s = now_s + STATE_S
                bus.publish(self._state(until_ns))
            if not summarised and (summary := events.result()) is not None:
                summarised = True
                outages = fitting(summary.outages, OUTAGES_BYTES)
                bus.rejects["outages left out"] += len(summary.outages) - len(outages)
                bus.publish(ReplayEvents(trust=summary.trust, outages=tuple(outages)))

    def _controls(self, envelopes: Iterable[Envelope]) -> bool:
        """Carry out the commands that came; return whether the position jumped."""
        jumped = False
        for envelope in envelopes:
            try:
                message = envelope.decode()
            except BadPayload as error:
                log.warning("rejected a command: %s", error)
                continue
            if isinstance(message, ReplayControl):
                if not self._epoch:  # the first observer is there: the drive begins
                    self._position.apply(ReplayControl(command=ReplayCommand.SEEK), time.monotonic())
                jumped = self._position.apply(message, time.monotonic()) or jumped
        return jumped

    def _due(self, after_ns: int, until_ns: int) -> Iterator[Envelope]:
        speed = self._position.speed
        for envelope in self._index.between(after_ns, until_ns, self._all):
            if self._thinning.keeps(envelope.topic, envelope.received_ns, speed):
                yield envelope

    def _jump(self, bus: Bus, at_ns: int, *, past: bool) -> None:
        """Rebuild a position: the newest of every topic, and with `past` what the plots and rates show before it."""
        self._epoch += 1
        from_ns, recent_ns = at_ns - PAST_NS, at_ns - RECENT_NS
        bus.publish(self._state(from_ns if past else at_ns, complete=False))
        self._say_origin(bus, at_ns)
        if past:
            self._send(bus, self._of(self._index.newest(from_ns)))
            thinning = Thinning()
            self._send(bus, (
                envelope for envelope in self._index.between(from_ns, recent_ns, PLOTTED)
                if thinning.keeps_plotted(envelope.topic, envelope.received_ns)
            ))  # fmt: skip
            self._send(bus, self._of(self._index.newest(recent_ns)))
            self._send(bus, self._index.between(recent_ns, at_ns, self._shown))
        else:
            self._send(bus, self._of(self._index.newest(at_ns)))
        bus.publish(self._state(at_ns))

    def _of(self, envelopes: Iterable[Envelope]) -> Iterator[Envelope]:
        return (envelope for envelope in envelopes if envelope.topic in self._shown)

    def _send(self, bus: Bus, envelopes: Iterable[Envelope]) -> None:
        for count, envelope in enumerate(envelopes, 1):
            bus.forward(envelope)
            if count % MAX_BURST == 0:
                self._received += bus.receive(0.0)

    def _say_origin(self, bus: Bus, at_ns: int) -> None:
        name = self._path.stem[:64]
        bus.publish(Origin(now_ns=at_ns, kind=OriginKind.REPLAY, name=name, speed=self._position.speed))

    def _state(self, at_ns: int, *, complete: bool = True) -> ReplayState:
        position = self._position
        return ReplayState(
            position_ns=at_ns, begin_ns=position.begin_ns, end_ns=position.end_ns, speed=position.speed,
            playing=position.playing, epoch=self._epoch, complete=complete, name=self._path.name[:64],
        )  # fmt: skip
