"""What the verdict is made of: the monitors' latest statements, fusion's state, and the limits."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property

from shared.messages.explanation import Explanation, explain
from shared.messages.trust import Hypothesis, Outcome

from .codes import Code

DEFAULT_RISK = 1e-3  # before fusion has stated one
SECOND_NS = 1_000_000_000
CLOCK_TOLERANCE_NS = SECOND_NS  # by which a stamp may be ahead; one further ahead could never become stale


class Monitor(StrEnum):
    """Source of a statement."""

    MOTION = "motion"  # tachograph's tests
    MOTION_FAST = "motion_fast"  # difference of speeds over 5 s
    INERTIAL_SHORT = "inertial_short"  # 5 s windows
    INERTIAL_LONG = "inertial_long"  # 30 to 60 s of free propagation
    SATELLITES = "satellites"
    EVIDENCE = "evidence"  # the receiver's own flags, C/N0, AGC, clock
    COHERENT_SCALE = "coherent_scale"  # common scale of GNSS and odometer against the inertial sensors
    GYROSCOPE = "gyroscope"  # yaw rate against wheels, course, second antenna
    HYPOTHESES = "hypotheses"  # solutions that leave sensors out, against each other; stated by core.trust itself
    DRIFT = "drift"  # accumulated innovations over 30 to 300 s


MOTION = (Monitor.MOTION, Monitor.MOTION_FAST)
INERTIAL = (Monitor.INERTIAL_SHORT, Monitor.INERTIAL_LONG)
AGAINST_GNSS = (*INERTIAL, Monitor.GYROSCOPE, Monitor.DRIFT, Monitor.SATELLITES)
# Without a statement of these the verdict is at best CAUTION; the others are tests that not every vehicle has.
REQUIRED = (*MOTION, *INERTIAL, Monitor.SATELLITES, Monitor.EVIDENCE)


@dataclass(frozen=True)
class Statement:
    """What a monitor has published last."""

    monitor: Monitor
    outcome: Outcome
    stated_ns: int
    reason: str
    accused: tuple[str, ...] = ()
    statistic: float | None = None
    threshold: float | None = None
    false_alarm_rate: float | None = None
    window_s: float | None = None
    since_ns: int | None = None
    suspect_since_ns: int | None = None
    doubtful: bool = False
    accusing_tests: tuple[str, ...] = ()
    why: Explanation | None = None  # in place of `reason`, where this process says it


@dataclass(frozen=True)
class Posterior:
    """One hypothesis, at one time."""

    hypothesis: Hypothesis
    prior: float
    probability: float
    survives: bool
    acted_on: bool
    since_ns: int | None = None  # suspect time


@dataclass(frozen=True)
class Alternative:
    """Solution under a hypothesis, beside the published one."""

    distance_m: float  # horizontal
    level_m: float  # horizontal protection level
    agrees: bool  # the difference is within its spread


@dataclass(frozen=True)
class Solution:
    """Newest solution of fusion."""

    sampled_ns: int
    navigating: bool  # phase is navigating, coasting or GNSS only
    phase: str
    protection_level_horizontal_m: float | None
    protection_level_vertical_m: float | None
    gnss_age_s: float | None  # since the last fix that was used
    gnss_excluded_since_ns: int | None = None  # no GNSS with a later stamp is part of it
    risk: float = 1e-3  # at which its levels hold
    gnss_only: bool = False  # without inertial sensors

    @property
    def protection_levels_m(self) -> tuple[float | None, float | None]:
        """Horizontal and vertical protection level."""
        return self.protection_level_horizontal_m, self.protection_level_vertical_m


@dataclass(frozen=True)
class Limits:
    """Alert limits, deadlines, and the monitors whose absence lowers the verdict."""

    horizontal_m: float = 10.0
    vertical_m: float = 20.0
    near_share: float = 0.8  # of the alert limit, above which the verdict is CAUTION
    solution_silent_after_s: float = 2.0
    coasting_after_s: float = 3.0
    silent_after_s: Mapping[Monitor, float] = field(default_factory=lambda: dict.fromkeys(Monitor, 5.0))
    required: frozenset[Monitor] = frozenset(REQUIRED)


@dataclass(frozen=True)
class Facts:
    """Everything that the verdict depends on, at one time."""

    time_ns: int
    solution: Solution | None = None
    statements: Mapping[Monitor, Statement] = field(default_factory=dict)
    conflict_open: bool = False  # GNSS contradicts other sensors, and no evidence has ended it
    gnss_excluded: bool = False  # trust has excluded it
    exclusion_confirmed: bool = False  # and the solution contains none of it
    # of the newest position against the solution without GNSS: above 1 they contradict each other
    excluded_test_ratio: float | None = None
    gnss_was_apart: bool = False  # they have contradicted each other since the conflict began
    other_distance_m: float | None = None  # between the two solutions of a conflict, None without a second one
    other_level_m: float | None = None  # horizontal protection level of the one that is not published
    without_gnss_level_m: float | None = None  # horizontal protection level of the solution without GNSS
    exclusion_declined: bool = False  # fusion goes on using GNSS
    held_m: tuple[float, float] | None = None  # differences of positions, horizontal and vertical, that the level holds
    held_why: tuple[Explanation, ...] = ()  # of fusion: what it is, and what would end it
    odometer_in_use: bool = False  # by fusion
    odometer_excluded: bool = False  # trust has excluded it
    imu_excluded: bool = False
    imu_exclusion_confirmed: bool = False  # the position is that of the model without inertial sensors
    beliefs: tuple[Posterior, ...] = ()  # most probable first
    alternatives: Mapping[Hypothesis, Alternative] = field(default_factory=dict)  # newest, of fusion
    satellites_left_out: frozenset[str] = frozenset()  # of the position in use
    merge_lag_s: float = 0.0  # by which fusion waits for late measurements
    fixes_late_s: float | None = None  # by which positions arrive late, and are taken as older
    disturbed_since_ns: int | None = (
        None  # last position before a loss with interference, until its return is confirmed
    )
    start_unconfirmed: Explanation | None = None  # why a long inertial window has to pass before SAFE
    checks_paused: bool = False  # this computer is too slow for the checks beside the position
    limits: Limits = field(default_factory=Limits)

    @property
    def risk(self) -> float:
        """Integrity risk [-] at which fusion's levels hold."""
        return DEFAULT_RISK if self.solution is None else self.solution.risk

    @cached_property
    def surviving(self) -> tuple[Posterior, ...]:
        """Hypotheses of a fault that survive, the most probable first."""
        return tuple(
            belief for belief in self.beliefs if belief.survives and belief.hypothesis is not Hypothesis.NOTHING
        )

    def survivor(self, hypothesis: Hypothesis) -> Posterior | None:
        """A hypothesis of a fault if it survives."""
        return next((posterior for posterior in self.surviving if posterior.hypothesis is hypothesis), None)

    def survives(self, hypothesis: Hypothesis) -> bool:
        """Whether a hypothesis survives."""
        return self.survivor(hypothesis) is not None

    def acts_on(self, hypothesis: Hypothesis) -> bool:
        """Whether a hypothesis alone survives."""
        found = self.survivor(hypothesis)
        return found is not None and found.acted_on

    @property
    def level_exceeded(self) -> bool:
        """Whether a protection level is above its alert limit, or missing."""
        levels = (None, None) if self.solution is None else self.solution.protection_levels_m
        limits = self.limits.horizontal_m, self.limits.vertical_m
        return any(level is None or level > limit for level, limit in zip(levels, limits, strict=True))

    def is_silent(self, monitor: Monitor) -> bool:
        """Whether a monitor has not published within its deadline, or never."""
        statement = self.statements.get(monitor)
        if statement is None:
            return True
        age_ns = self.time_ns - statement.stated_ns
        return not -CLOCK_TOLERANCE_NS <= age_ns <= self.limits.silent_after_s[monitor] * SECOND_NS

    def statement(self, monitor: Monitor) -> Statement:
        """Latest statement of a monitor; a silent one has not evaluated anything since its last message.

        An accusation by a monitor that has died is no longer one. What has been excluded on it stays excluded, because
        readmission takes statements that pass.
        """
        return self._current[monitor]

    @cached_property
    def _current(self) -> Mapping[Monitor, Statement]:
        """Statement of each monitor."""
        return {monitor: self._silenced(monitor) if self.is_silent(monitor) else self.statements[monitor]
                for monitor in Monitor}  # fmt: skip

    @cached_property
    def _accusers(self) -> Mapping[Monitor, Statement]:
        """Those of these statements that accuse."""
        return {monitor: said for monitor, said in self._current.items() if said.outcome is Outcome.ACCUSES}

    def with_decided(self, **decided: object) -> "Facts":
        """These facts with what has been decided by them: neither time nor statements nor deadlines."""
        made = replace(self, **decided)  # type: ignore[arg-type]  # its fields, by name
        made.__dict__["_current"], made.__dict__["_accusers"] = self._current, self._accusers
        return made

    def _silenced(self, monitor: Monitor) -> Statement:
        """What counts of a monitor that is silent."""
        last = self.statements.get(monitor)
        if last is None:
            return Statement(
                monitor,
                Outcome.NOT_EVALUATED,
                self.time_ns,
                "",
                why=explain(Code.MONITORS_MISSING, monitors=(monitor,)),
            )
        ahead_s = (last.stated_ns - self.time_ns) / SECOND_NS
        if ahead_s > 0.0:
            why = explain(Code.MONITOR_AHEAD, monitor=monitor, ahead_s=ahead_s)
        else:
            why = explain(Code.MONITOR_SILENT, monitor=monitor, since_ns=last.stated_ns)
        return replace(
            last, outcome=Outcome.NOT_EVALUATED, reason="", why=why, accused=(), statistic=None, suspect_since_ns=None,
            doubtful=False, since_ns=last.stated_ns,
        )  # fmt: skip

    def outcome(self, monitor: Monitor) -> Outcome:
        """Outcome of a monitor, `not_evaluated` if it is silent."""
        return self.statement(monitor).outcome

    def accusing(self, monitors: tuple[Monitor, ...], accused: str | None = None) -> list[Statement]:
        """Statements of these monitors that accuse (somebody, or the one named)."""
        found = [self._accusers[monitor] for monitor in monitors if monitor in self._accusers]
        return [statement for statement in found if accused is None or accused in statement.accused]
