"""Lag of a process behind its inputs, and which work is paused until it has caught up.

The lag follows from the journal alone: it is the newest `Tick` minus the arrival stamp of the first message consumed
after it. No clock is read, so a repetition of the process makes the same decisions.
"""

from .messages.operation import ProcessLoad, Work

SHED_ABOVE_S = 0.4  # lag from which the checks are paused
HURRY_ABOVE_S = 0.7  # lag from which all work is paused
RESUME_BELOW_S = 0.2  # lag below which the process keeps up
RESUME_AFTER = 10  # ticks below it after which all work is resumed
RESUME_AFTER_MAX = 40  # the same, while resuming has led to another lag within RELAPSE ticks
RELAPSE = 60
SKIP_ABOVE_S = 0.8  # lag from which inputs are skipped, once everything else is paused
SKIP_AFTER = 2  # ticks above it
SHRINKS_S = 0.3  # lag by which a process that catches up is less far behind with each tick
SKIP_UNTIL_S = 0.2  # age of the oldest input that is not skipped then
ORDER = tuple(Work)  # in which work is paused
CHECKS = (Work.HYPOTHESES, Work.INERTIAL_WINDOWS)  # without which no position is SAFE


class Load:
    """Decides from ticks and arrival stamps which work is paused, and which inputs are skipped.

    With each tick whose lag is above the limit more work is paused, in its order. All of it is resumed together once
    the process has kept up for a while, which becomes longer each time this was too early.
    """

    def __init__(self, process: str) -> None:
        self._process = process
        self._tick_ns: int | None = None  # newest tick that no lag was measured for
        self._paused = 0  # number of kinds of work, in their order
        self._calm = self._wait = 0
        self._since_resumed: int | None = None  # ticks
        self._stuck = 0  # ticks with everything paused and a lag above SKIP_ABOVE_S
        self._skip_before_ns = 0
        self._told_skipped: int | None = None  # skipped inputs when it was last said that nothing is paused
        self.lag_s = 0.0
        self.skipped = 0

    def tick(self, now_ns: int) -> None:
        """Note a tick; the next stamp gives the lag."""
        self._tick_ns = now_ns
        if self._since_resumed is not None:
            self._since_resumed += 1

    def skips(self, arrival_ns: int) -> bool:
        """Whether an input that arrived at a time is too old to be used; it is counted."""
        skipped = arrival_ns < self._skip_before_ns
        self.skipped += skipped
        return skipped

    def see(self, arrival_ns: int) -> ProcessLoad | None:
        """Measure the lag by the first stamp after a tick; returns the load where it is to be published."""
        if self._tick_ns is None:
            return None
        now_ns, self._tick_ns, before_s = self._tick_ns, None, self.lag_s
        self.lag_s = max(0.0, (now_ns - arrival_ns) * 1e-9)
        self._judge(now_ns, shrinks=self.lag_s < before_s - SHRINKS_S)
        quiet = self.lag_s < RESUME_BELOW_S and not self._paused
        if quiet and self._told_skipped == self.skipped:
            return None
        self._told_skipped = self.skipped if quiet else None
        return ProcessLoad(
            sampled_ns=now_ns, process=self._process, lag_s=self.lag_s, paused=ORDER[: self._paused],
            skipped=self.skipped,
        )  # fmt: skip

    def _judge(self, now_ns: int, *, shrinks: bool) -> None:
        if self.lag_s > SHED_ABOVE_S:
            self._pause()
        elif self.lag_s < RESUME_BELOW_S:
            self._calm += 1
            if self._paused and self._calm >= self._wait:
                self._paused, self._since_resumed = 0, 0
        else:
            self._calm = 0
        everything = self._paused == len(ORDER) and self.lag_s > SKIP_ABOVE_S
        self._stuck = self._stuck + 1 if everything and not shrinks else 0
        if self._stuck >= SKIP_AFTER:
            self._stuck, self._skip_before_ns = 0, now_ns - round(SKIP_UNTIL_S * 1e9)

    def _pause(self) -> None:
        if not self._paused:
            early = self._since_resumed is not None and self._since_resumed < RELAPSE
            self._wait = min(2 * self._wait, RESUME_AFTER_MAX) if early else RESUME_AFTER
        self._calm = 0
        more = len(ORDER) if self.lag_s > HURRY_ABOVE_S else len(CHECKS)
        self._paused = min(len(ORDER), self._paused + more)
