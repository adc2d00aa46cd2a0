"""One process as it looks from outside: its heartbeat, its will, its lives."""

from enum import StrEnum

from shared.messages.operation import ProcessHealth, ProcessState
from shared.topics import BY_NAME

SILENT_AFTER_S = BY_NAME["health/+"].silent_after_s or 2.0
SUSPECT_AFTER_S = 1.2  # two heartbeats are missing: too early to call it silent, too late to call it running


class Condition(StrEnum):
    """What can be said of a process; the words complete "core.fusion is ..."."""

    RUNNING = "running"
    SUSPECT = "late with its heartbeat"
    SILENT = "silent"
    LOST = "lost"
    ENDED = "ended"
    MISSING = "missing"  # was never seen although it should run
    WAITED_FOR = "not there yet"

    @property
    def down(self) -> bool:
        """Whether it does no work."""
        return self not in (Condition.RUNNING, Condition.SUSPECT, Condition.WAITED_FOR)


class ProcessWatch:
    """Follows one process through its lives."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.state: ProcessState | None = None
        self.incarnation = 0
        self.restarts = 0
        self.heartbeat_ns: int | None = None
        self.back_ns: int | None = None  # when it was last heard again after it was down
        self.seen_ns: int | None = None  # its last word, or the broker's word that it was lost
        self.kept = False  # what is known of it was kept by the broker, and may be of a former life of the unit

    def take(self, health: ProcessHealth, received_ns: int, *, retained: bool) -> None:
        """Note a birth, heartbeat, farewell or last will; the will of a former life says nothing of this one."""
        if health.incarnation < self.incarnation:
            return
        if health.incarnation > self.incarnation and self.incarnation:
            self.restarts += 1
            self.back_ns = received_ns
        elif (self.age_s(received_ns) or 0.0) >= SILENT_AFTER_S:
            self.back_ns = received_ns
        self.kept = retained
        self.incarnation, self.state = health.incarnation, health.state
        self.seen_ns = min(health.sent_ns, received_ns) if retained else received_ns
        if health.state is not ProcessState.LOST or self.heartbeat_ns is None:
            self.heartbeat_ns = self.seen_ns

    def age_s(self, now_ns: int) -> float | None:
        """Give the age of the last heartbeat."""
        return None if self.heartbeat_ns is None else max(now_ns - self.heartbeat_ns, 0) * 1e-9

    def condition(self, now_ns: int, judged_from_ns: int, *, grace_over: bool) -> Condition:
        """Judge the process; silence counts only from `judged_from_ns`, before which nobody could be heard."""
        if self.state is None or self.heartbeat_ns is None:
            return Condition.MISSING if grace_over else Condition.WAITED_FOR
        if self.state is ProcessState.LOST:
            return Condition.LOST
        silence_s = (now_ns - max(self.heartbeat_ns, judged_from_ns)) * 1e-9
        if self.state is ProcessState.DISCONNECTED:
            return Condition.ENDED if silence_s >= SILENT_AFTER_S else Condition.SUSPECT
        if silence_s >= SILENT_AFTER_S:
            return Condition.SILENT
        return Condition.SUSPECT if silence_s >= SUSPECT_AFTER_S else Condition.RUNNING
