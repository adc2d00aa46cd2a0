"""What the statements of the monitors say for and against each hypothesis: likelihoods, bounded and accumulated.

A monitor that accuses is explained by the hypotheses of the sources that it names. Its statements are correlated over
its window, so that one a window counts, and a change of what it says at once.
"""

from collections.abc import Collection, Mapping
from math import log

from shared.messages.explanation import ReferenceKind
from shared.messages.trust import Hypothesis, Outcome
from shared.trust.accused import GNSS, IMU, ODOMETER, reference

from ..facts import INERTIAL, MOTION, SECOND_NS, Facts, Monitor, Statement

# Probability that a monitor accuses although nothing that it names is wrong: its design says less, but its model of the
# vehicle has tails that no design knows.
FALSE_ALARM = 1e-3
EXPLAINED = 0.5  # that it accuses, where a source that it names is wrong
PARTLY = 0.2  # where a source is wrong that it needs and does not name
# Largest sum of logarithms that one monitor may say for a hypothesis: two independent windows. More of the same does
# not make it another monitor.
MAX_LOG_LIKELIHOOD = 2.0 * log(EXPLAINED / FALSE_ALARM)
OF_EVIDENCE = 2.0  # the same of the receiver's own flags, which are wrong more often than a comparison of two sensors
DEFAULT_WINDOW_S = 5.0
# Power: probability that a monitor which passes would have accused, if the hypothesis were true; and the least sum of
# logarithms that its passing may say against it. An error across the way changes no speed, a slow one passes the short
# windows, and a gyroscope may be right while an accelerometer is not.
POWER: Mapping[Monitor, Mapping[Hypothesis, tuple[float, float]]] = {
    Monitor.MOTION_FAST: {
        Hypothesis.GNSS: (0.3, log(0.3)),
        Hypothesis.ODOMETER: (0.7, log(0.01)),
    },
    Monitor.INERTIAL_SHORT: {
        Hypothesis.GNSS: (0.5, log(0.1)),
        Hypothesis.IMU: (0.7, log(0.05)),
        Hypothesis.GNSS_AND_ODOMETER: (0.3, log(0.3)),
    },
    Monitor.INERTIAL_LONG: {
        Hypothesis.GNSS: (0.7, log(0.1)),
        Hypothesis.IMU: (0.9, log(0.05)),
        Hypothesis.GNSS_AND_ODOMETER: (0.3, log(0.3)),
    },
    Monitor.GYROSCOPE: {
        Hypothesis.IMU: (0.5, log(0.1)),
        Hypothesis.GNSS: (0.3, log(0.3)),
    },
    Monitor.COHERENT_SCALE: {Hypothesis.GNSS_AND_ODOMETER: (0.7, log(0.05))},
    Monitor.SATELLITES: {Hypothesis.SATELLITES: (0.9, log(0.01))},
    # It compares the odometer with the inertial sensors alone; a wrong one of GNSS may be across the way.
    Monitor.HYPOTHESES: {Hypothesis.ODOMETER: (0.5, log(0.1))},
}
OF_SOURCE = {GNSS: Hypothesis.GNSS, IMU: Hypothesis.IMU, ODOMETER: Hypothesis.ODOMETER}
TIME_TESTS = frozenset({"host_time"})
GRAVITY_TESTS = frozenset({"gravity"})  # of an inertial unit that contradicts itself


def explained_by(statement: Statement, *, odometer_in_use: bool) -> dict[Hypothesis, float]:
    """Probability that a monitor accuses as it does under each hypothesis that explains it.

    Parameters
    ----------
    statement : Statement
        That accuses.
    odometer_in_use : bool
        Fusion, and with it the free propagations, use the odometer.

    Returns
    -------
    dict
        Hypotheses that explain it; under all others it is a false alarm.
    """
    monitor, named = statement.monitor, set(statement.accused)
    if monitor is Monitor.COHERENT_SCALE and ODOMETER in named:  # errors of the inertial scale look alike
        return {Hypothesis.GNSS_AND_ODOMETER: EXPLAINED, Hypothesis.IMU: PARTLY}
    if monitor is Monitor.HYPOTHESES and len(named) > 1:
        return {Hypothesis.GNSS_AND_ODOMETER: EXPLAINED, Hypothesis.IMU: EXPLAINED}
    if named == {IMU} and GRAVITY_TESTS & set(statement.accusing_tests):
        return {Hypothesis.IMU: EXPLAINED}  # accelerometers against gyroscopes: no other source has a part in it
    found = {hypothesis: EXPLAINED for name, hypothesis in OF_SOURCE.items() if name in named}
    if monitor is Monitor.GYROSCOPE and IMU in named and odometer_in_use:  # course and wheels falsified alike
        found[Hypothesis.GNSS_AND_ODOMETER] = EXPLAINED if named == {IMU} else PARTLY
    if monitor is Monitor.SATELLITES and any(_is_satellite(name) for name in named):
        found[Hypothesis.SATELLITES] = EXPLAINED
    if monitor is Monitor.EVIDENCE and TIME_TESTS & set(statement.accusing_tests):
        found[Hypothesis.RECEIVER_TIME] = EXPLAINED
    if GNSS in named:
        found |= _with_gnss(monitor, named, odometer_in_use=odometer_in_use)
    return found


def _with_gnss(monitor: Monitor, named: set[str], *, odometer_in_use: bool) -> dict[Hypothesis, float]:
    """Other hypotheses that explain in part why a monitor names GNSS."""
    found: dict[Hypothesis, float] = {}
    # The long windows use the odometer: of one that is falsified as well, they cannot say that it decides.
    if (monitor in (*INERTIAL, Monitor.DRIFT) and IMU in named) or monitor is Monitor.INERTIAL_LONG:
        found[Hypothesis.GNSS_AND_ODOMETER] = PARTLY
    if monitor in (Monitor.INERTIAL_LONG, Monitor.DRIFT) and odometer_in_use and ODOMETER not in named:
        found[Hypothesis.ODOMETER] = PARTLY  # it aids what GNSS is compared with
    if monitor in (*INERTIAL, *MOTION):
        found[Hypothesis.RECEIVER_TIME] = PARTLY  # late velocities look as if GNSS were wrong
    return found


def _is_satellite(name: str) -> bool:
    return reference(name).kind is ReferenceKind.SATELLITE


class Evidence:
    """What one monitor has said for and against each hypothesis, as sums of logarithms of likelihood ratios.

    The ratio is that of the hypothesis to "nothing is wrong".
    """

    def __init__(self, monitor: Monitor) -> None:
        self.monitor = monitor
        self.sums: dict[Hypothesis, float] = {}
        self._said: tuple[Outcome, tuple[str, ...]] | None = None
        self._counted_ns = 0
        self._against: set[Hypothesis] = set()  # of the last update

    def update(self, statement: Statement, facts: Facts, suspected: Collection[Hypothesis]) -> None:
        """Count a statement, unless one of the same window has been counted; one without evaluation says nothing.

        It counts for and against hypotheses that some monitor has spoken for: before, there may have been no fault yet.
        """
        if statement.outcome is Outcome.NOT_EVALUATED:
            self._said = None
            return
        said = statement.outcome, statement.accused
        window_ns = round((statement.window_s or DEFAULT_WINDOW_S) * SECOND_NS)
        new = set(suspected) - self._against
        self._against = set(suspected)
        due = said != self._said or facts.time_ns - self._counted_ns >= window_ns
        if due:
            self._said, self._counted_ns = said, facts.time_ns
        if statement.outcome is Outcome.PASS:
            self._pass(suspected if due else new)
        elif due:
            self._accuse(statement, facts, suspected)

    def _accuse(self, statement: Statement, facts: Facts, suspected: Collection[Hypothesis]) -> None:
        explained = explained_by(statement, odometer_in_use=facts.odometer_in_use)
        most = OF_EVIDENCE if self.monitor is Monitor.EVIDENCE else MAX_LOG_LIKELIHOOD
        for hypothesis in suspected:
            ratio = log(explained.get(hypothesis, FALSE_ALARM) / FALSE_ALARM)
            before = self.sums.get(hypothesis, 0.0)
            # What it has said for a hypothesis that it no longer names was said of the same wrong source.
            self.sums[hypothesis] = min(most, max(before, 0.0) + ratio) if ratio else min(before, 0.0)
        if self.monitor is Monitor.HYPOTHESES:  # of three sources, those that it does not name agree
            self._pass([hypothesis for hypothesis in suspected if hypothesis not in explained])

    def _pass(self, suspected: Collection[Hypothesis]) -> None:
        for hypothesis, (power, least) in POWER.get(self.monitor, {}).items():
            if hypothesis in suspected:
                before = self.sums.get(hypothesis, 0.0)
                self.sums[hypothesis] = max(before + log(1.0 - power), min(before, least))

    def forget(self, hypothesis: Hypothesis) -> None:
        """Drop what it has said of a hypothesis that has been contradicted."""
        self.sums.pop(hypothesis, None)
