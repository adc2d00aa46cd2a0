"""Opens a conflict of a source with others when it is accused, and ends it after it has agreed for a minimum time.

GNSS is excluded only while its hypothesis alone survives (`hypotheses/beliefs.py`). With GNSS and inertial sensors
alone one difference says the same of both.

The minimum healthy time is 2 s after a first fault of under 10 s and grows for longer faults in proportion to their
duration; each further fault within 10 minutes doubles it; it is at most 60 s.
"""

from collections import deque
from dataclasses import dataclass

from shared.messages.trust import Hypothesis, Outcome
from shared.trust.accused import GNSS, IMU

from .facts import INERTIAL, SECOND_NS, Facts, Monitor
from .hypotheses.evidence import GRAVITY_TESTS
from .verdict import solution_lost

HEALTHY_S = 2.0
SHORT_FAULT_S = 10.0
REPEATED_WITHIN_S = 600.0
MAX_HEALTHY_S = 60.0
HEALTHY_BOUNDS_S = (0.0, MAX_HEALTHY_S)  # bounds of the healthy time
UNCHECKED_BOUNDS_S = (
    MAX_HEALTHY_S,
    MAX_HEALTHY_S,
)  # the same where there is nothing that the source can be compared with
RETURN_S = (0.0, 5.0)  # after a closure: positions that were apart have come back
# Normalised innovation squared over its gate up to which a position agrees with the solution without GNSS, and with one
# whose protection level is above the alert limit: three times the distance.
SPEAKING = tuple(monitor for monitor in Monitor if monitor not in (Monitor.EVIDENCE, Monitor.HYPOTHESES))
USEFUL_LIMITS = 3.0  # alert limits up to which the level of the solution without GNSS may be, to decide of a return
REACHING_BACK = (Monitor.INERTIAL_LONG, Monitor.DRIFT, Monitor.GYROSCOPE, Monitor.MOTION)
AGREES, AGREES_ABOVE_LIMIT = 1.0, 9.0


def healthy_time(fault_s: float, earlier_faults: int) -> float:
    """Minimum healthy time [s] after a fault.

    Notes
    -----
    min(60 s, 2 s · max(1, fault / 10 s) · 2^n) with n faults before within 10 minutes.
    """
    doublings = min(earlier_faults, 10)  # far beyond the maximum
    return float(min(MAX_HEALTHY_S, HEALTHY_S * max(1.0, fault_s / SHORT_FAULT_S) * 2**doublings))


@dataclass(frozen=True)
class Admission:
    """Whether there is a conflict, whether GNSS is excluded, and since when it is suspect."""

    open: bool
    excluded: bool = False
    suspect_since_ns: int | None = None


class Readmission:
    """State of GNSS: admitted, in conflict while accused, in conflict until it has agreed for long enough."""

    def __init__(self) -> None:
        self._faults: deque[int] = deque(maxlen=16)  # ends of earlier faults
        self._began_ns: int | None = None  # of the present exclusion
        self._accused_ns = 0  # last accusation of it
        self._suspect_ns: int | None = None
        self._healthy_ns: int | None = None  # since when it agrees
        self._decided = False  # its hypothesis alone has survived
        self.was_apart = False  # the two solutions have contradicted each other in this conflict

    @property
    def suspect_since_ns(self) -> int | None:
        """Suspect time of the present exclusion."""
        return self._suspect_ns

    def update(
        self, time_ns: int, *, accused: bool, agrees: bool, decided: bool = False, contradicted: bool = False,
        declined: bool = False, suspect_since_ns: int | None = None, within_s: tuple[float, float] = HEALTHY_BOUNDS_S,
    ) -> Admission:  # fmt: skip
        """Use the monitors' judgement of one time.

        Parameters
        ----------
        time_ns : int
            Stamp; not before the one of the last call.
        accused : bool
            A monitor accuses the source.
        agrees : bool
            Every monitor that can judge the source passes it; "not evaluated" does not agree.
        decided : bool
            No other hypothesis survives.
        contradicted : bool
            This hypothesis does not survive any more: what was decided is taken back.
        declined : bool
            Fusion has no good solution without the source: it is used in spite of a decision.
        suspect_since_ns : int, optional
            Earliest time from which the evidence of the accusation may be wrong.
        within_s : tuple of float
            [s] Bounds of the time of agreement that is needed.
        """
        if accused:
            self._accuse(time_ns, suspect_since_ns)
            self._decided |= decided
        self._decided &= not contradicted
        if self._began_ns is None:
            return Admission(open=False)
        if accused or not agrees:
            self._healthy_ns = None
        elif self._healthy_ns is None:
            self._healthy_ns = time_ns
        healthy_s = 0.0 if self._healthy_ns is None else (time_ns - self._healthy_ns) / SECOND_NS
        required_s = min(max(self._required_s(), within_s[0]), within_s[1])
        if self._healthy_ns is not None and healthy_s >= required_s:
            self.end(self._accused_ns)
            return Admission(open=False)
        return Admission(True, self._decided and not declined, self._suspect_ns)

    def end(self, time_ns: int) -> None:
        """End the conflict, if there is one, and count it as a fault that ended at a time."""
        if self._began_ns is not None:
            self._faults.append(time_ns)
            self._began_ns = self._suspect_ns = self._healthy_ns = None
            self._decided = self.was_apart = False

    def _accuse(self, time_ns: int, suspect_since_ns: int | None) -> None:
        suspect_ns = time_ns if suspect_since_ns is None else suspect_since_ns
        if self._began_ns is None:
            self._began_ns, self._suspect_ns = time_ns, suspect_ns
        self._suspect_ns = suspect_ns if self._suspect_ns is None else min(self._suspect_ns, suspect_ns)
        self._accused_ns = time_ns

    def _required_s(self) -> float:
        began_ns = self._began_ns or 0
        earlier = sum(began_ns - fault_ns <= REPEATED_WITHIN_S * SECOND_NS for fault_ns in self._faults)
        return healthy_time((self._accused_ns - began_ns) / SECOND_NS, earlier)


@dataclass(frozen=True)
class Judgement:
    """What the monitors say of a source at one time."""

    accused: bool
    decided: bool  # no other hypothesis survives
    contradicted: bool  # its own does not
    agrees: bool
    suspect_since_ns: int | None
    within_s: tuple[float, float] = HEALTHY_BOUNDS_S  # bounds of the time of agreement that is needed


def judge_gnss(facts: Facts) -> Judgement:
    """Say whether GNSS is accused and may be wrong, whether it alone may, whether it agrees, and since when.

    Agreement takes an inertial window that passes, no monitor that accuses, and a position that does not contradict the
    solution without GNSS while there is one. Velocities alone cannot tell an attack that holds its offset from one that
    has ended. A position may be three times as far from a solution whose protection level is above the alert limit. The
    long windows and the drift reach back into an error that has ended: where positions were apart and have come back,
    the solution without GNSS decides in their place.
    """
    accusing = facts.accusing(SPEAKING, GNSS)
    found = facts.survivor(Hypothesis.GNSS)
    passing = any(facts.outcome(monitor) is Outcome.PASS for monitor in INERTIAL)
    ratio, level_m = facts.excluded_test_ratio, facts.without_gnss_level_m
    # Of a state that was saved during an exclusion there is one solution only.
    exceeded = facts.level_exceeded if level_m is None else level_m > facts.limits.horizontal_m
    limit = AGREES_ABOVE_LIMIT if exceeded else AGREES
    compared = ratio is not None and ratio <= limit
    alone = facts.exclusion_declined and level_m is None  # the level holds the difference
    useful = level_m is not None and level_m <= USEFUL_LIMITS * facts.limits.horizontal_m
    came_back = facts.gnss_was_apart and useful and ratio is not None and ratio <= AGREES
    present = [statement for statement in accusing if not (came_back and statement.monitor in REACHING_BACK)]
    agrees = not present and (is_lost(facts) or (passing and (compared or alone) and not _may_be_alike(facts)))
    accused = bool(present) and found is not None
    decided, since_ns = facts.acts_on(Hypothesis.GNSS), None if found is None else found.since_ns
    return Judgement(accused, decided, found is None, agrees, since_ns, _bounds(facts, came_back=came_back))


def _bounds(facts: Facts, *, came_back: bool) -> tuple[float, float]:
    if is_lost(facts):
        return UNCHECKED_BOUNDS_S
    return RETURN_S if came_back else HEALTHY_BOUNDS_S


def _may_be_alike(facts: Facts) -> bool:
    """Whether an odometer that agrees with GNSS may be falsified like it, as far as the inertial sensors alone say."""
    shown = facts.outcome(Monitor.HYPOTHESES)
    return facts.odometer_in_use and facts.survives(Hypothesis.GNSS_AND_ODOMETER) and shown is not Outcome.PASS


def judge_imu(facts: Facts) -> Judgement:
    """Say the same of the inertial sensors.

    They are decided against only where they contradict themselves: GNSS, wheel speeds and the yaw of the wheels may all
    be falsified alike, and then it looks as if the inertial sensors were wrong. They agree when the short windows pass,
    the gyroscope is not accused, and the filter is within the spread of the
    solution without them. The long windows reach back into the fault, and the drift as well.
    """
    knocked = GRAVITY_TESTS & set(facts.statement(Monitor.GYROSCOPE).accusing_tests)
    alone = facts.acts_on(Hypothesis.IMU) and bool(knocked)
    accusing = facts.accusing((Monitor.INERTIAL_SHORT, Monitor.GYROSCOPE), IMU)
    other = facts.alternatives.get(Hypothesis.IMU)
    agrees = not accusing and (is_lost(facts) or (other is not None and other.agrees))
    found = facts.survivor(Hypothesis.IMU)
    since_ns = None if found is None else found.since_ns
    return Judgement(bool(accusing), alone, found is None, agrees, since_ns, _bounds(facts, came_back=False))


def is_lost(facts: Facts) -> bool:
    """Whether fusion is without a position, or publishes none: nothing is left that GNSS can be compared with."""
    return bool(solution_lost(facts))
