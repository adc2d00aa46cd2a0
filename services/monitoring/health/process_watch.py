"""Status of one process from its heartbeats, state `disconnected` and last will."""

from collections import deque

from shared.messages.operation import Freshness, ProcessHealth, ProcessState, ProcessStatus
from shared.runtime.freshness import freshness_of, limits_of
from shared.topics import BY_NAME

LIMITS = limits_of(BY_NAME["health/+"])
EARLIER_LIVES = 8
RECOVERY_TIME_NS = 1_000_000_000  # of heartbeats in time, after which a pause between them is over
OVER = {ProcessState.LOST: ProcessStatus.LOST, ProcessState.DISCONNECTED: ProcessStatus.ENDED}


class ProcessWatch:
    """Follows one process through its restarts."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.state: ProcessState | None = None
        self.incarnation = 0
        self._earlier: deque[int] = deque(maxlen=EARLIER_LIVES)
        self.restarts = 0
        self.heartbeat_ns: int | None = None
        self._steady_ns = 0  # since when its heartbeats have been in time
        self.seen_ns: int | None = None  # its last message, or its last will
        self.retained = False  # only retained messages came, which may be older than this run of the unit

    def take(self, health: ProcessHealth, received_ns: int, *, retained: bool) -> None:
        """Process a health message; one older than the newest is ignored."""
        known = self.heartbeat_ns is not None and retained and health.sent_ns <= self.heartbeat_ns
        if known or health.incarnation < self.incarnation:
            return
        if self.incarnation and health.incarnation > self.incarnation:
            self._earlier.append(self.incarnation)
        self.restarts += health.incarnation > self.incarnation > 0
        self.retained = retained
        self.incarnation, self.state = health.incarnation, health.state
        self.seen_ns = min(health.sent_ns, received_ns) if retained else received_ns
        if health.state is not ProcessState.LOST or self.heartbeat_ns is None:
            if freshness_of(max(self.seen_ns - (self.heartbeat_ns or 0), 0) * 1e-9, LIMITS) is not Freshness.FRESH:
                self._steady_ns = self.seen_ns
            self.heartbeat_ns = self.seen_ns

    def is_of_earlier_life(self, health: ProcessHealth) -> bool:
        """Whether this heartbeat is of a life that another has followed: two programs run under this name."""
        return health.state is ProcessState.READY and health.incarnation in self._earlier

    def spoke_after(self, due_ns: int) -> bool:
        """Whether a heartbeat came after a time, and not right after a pause between heartbeats."""
        return (self.heartbeat_ns or 0) >= max(due_ns, self._steady_ns + RECOVERY_TIME_NS if self._steady_ns else 0)

    def age_s(self, now_ns: int) -> float | None:
        """Give the age of the last heartbeat."""
        return None if self.heartbeat_ns is None else max(now_ns - self.heartbeat_ns, 0) * 1e-9

    def status(self, now_ns: int, judged_from_ns: int, *, grace_over: bool) -> ProcessStatus:
        """Judge the process; silence counts only from `judged_from_ns`, before which nothing could be received."""
        if self.state is None or self.heartbeat_ns is None:
            return ProcessStatus.MISSING if grace_over else ProcessStatus.WAITING
        if self.state is ProcessState.LOST:
            return ProcessStatus.LOST
        silence_s = max(now_ns - max(self.heartbeat_ns, judged_from_ns), 0) * 1e-9
        freshness = freshness_of(silence_s, LIMITS)
        if freshness is Freshness.STALE:
            return OVER.get(self.state, ProcessStatus.STALE)
        late = freshness is Freshness.LATE or self.state is ProcessState.DISCONNECTED
        return ProcessStatus.LATE if late else ProcessStatus.READY
