"""Feeds the state from a replay: in recorded time, and rebuilt in one step after each jump."""

from collections.abc import Iterable

from shared.bus.bus import Envelope
from shared.errors import BadPayload
from shared.messages.operation import Origin
from shared.messages.replay import ReplayEvents, ReplayState

from .state import State

RUNS_ON_NS = 1_000_000_000  # of the host: so long recorded time goes on without news of the replay
MAX_JUMP = 5_000  # messages that rebuild a position


class ReplayFeed:
    """Recorded time, and the messages of the replay as if they arrived at that time."""

    def __init__(self, state: State) -> None:
        self._state = state
        self.newest: ReplayState | None = None
        self.events = ReplayEvents()
        self.broken = 0  # messages that could not be read
        self.fresh = False  # a jump is complete and has not been shown yet
        self._received_ns = 0  # time of the host at the newest replay state
        self._jump: list[Envelope] | None = None  # messages of a jump that is not complete
        self._context_ns = 0  # up to this arrival they say what was known, and no time passes between them

    def now_ns(self, host_ns: int) -> int:
        """Give the recorded time at a time of the host; the time of the host before the replay begins."""
        newest = self.newest
        if newest is None:
            return host_ns
        elapsed_ns = min(host_ns - self._received_ns, RUNS_ON_NS) if newest.playing else 0
        return min(newest.position_ns + round(elapsed_ns * newest.speed), newest.end_ns)

    def lost(self, host_ns: int) -> bool:
        """Whether the replay has not reported its position lately."""
        return self.newest is None or host_ns - self._received_ns > RUNS_ON_NS

    def take(self, envelopes: Iterable[Envelope], host_ns: int) -> None:
        """Take what was received; the heartbeats of the processes that run the replay are not part of it."""
        for envelope in envelopes:
            try:
                self._take(envelope, host_ns)
            except BadPayload:
                self.broken += 1

    def _take(self, envelope: Envelope, host_ns: int) -> None:
        if envelope.topic == "replay/state":
            self._follow(envelope, host_ns)
        elif envelope.topic == "replay/events":
            self._note_events(envelope)
        elif envelope.recorded_ns is not None or envelope.topic == "origin/state":
            if self._jump is None:
                self._play(envelope)
            elif len(self._jump) < MAX_JUMP:
                self._jump.append(envelope)

    def _follow(self, envelope: Envelope, host_ns: int) -> None:
        state = envelope.decode()
        assert isinstance(state, ReplayState), "the contract says so"
        jumped = self.newest is not None and state.epoch != self.newest.epoch
        if not state.complete:
            self._jump, self._context_ns = [], state.position_ns
            return
        messages, self._jump = self._jump, None
        self.newest, self._received_ns = state, host_ns
        if messages is None and not jumped:
            return
        self._state.clear(state.begin_ns)
        self._recall(self._context_ns)
        for message in messages or ():
            try:
                self._play(message, context=(message.recorded_ns or 0) <= self._context_ns)
            except BadPayload:
                self.broken += 1
        self.fresh = True

    def _play(self, envelope: Envelope, *, context: bool = False) -> None:
        if isinstance(envelope.recorded_ns, int):
            arrival_ns = envelope.recorded_ns
        else:
            origin = envelope.decode()
            assert isinstance(origin, Origin), "nothing else comes without the time of its recording"
            arrival_ns = origin.now_ns
        if not context:
            self._state.pass_to(arrival_ns)
        self._state.receive(envelope._replace(received_ns=arrival_ns, retained=False))

    def _note_events(self, envelope: Envelope) -> None:
        events = envelope.decode()
        assert isinstance(events, ReplayEvents), "the contract says so"
        self.events = events
        if self.newest is not None:
            self._recall(self.newest.position_ns)

    def _recall(self, until_ns: int) -> None:
        """Restore from the events of the drive what happened before the messages that rebuild a position."""
        changes = [(c.since_ns, c.state) for c in self.events.trust if c.since_ns < until_ns]
        self._state.recall(changes, [o for o in self.events.outages if (o.until_ns or o.since_ns) < until_ns])
