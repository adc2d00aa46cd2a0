"""The statement `satellites` of the tests of one raw epoch, and of the time without one."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

from shared.messages.explanation import Explanation, explain
from shared.messages.trust import Outcome, TrustMonitor
from shared.trust.accused import GNSS, NEIGHBOUR
from shared.trust.result import NO_TESTS, Test, judged, lasting, statement

from .codes import Code
from .detection import local_threshold
from .measurements import NeighbourFinding, RawEpoch, SatelliteFinding, SatelliteVerdict, references

MONITOR = "satellites"
UNRESOLVED_NS = 60_000_000_000
COOPERATIVE, LEVEL = "cooperative", "horizontal protection level"
MAX_TESTS = 64  # one a satellite: GPS and Galileo have 68 numbers
MAX_ACCUSED = 16  # more satellites at once are a fault of GNSS as a whole
WITHOUT_EPHEMERIS = ("no_ephemeris", "old_ephemeris")


class SatelliteStatements:
    """Gives the statements; remembers since when the outcome lasts, and when no satellite was accused last."""

    def __init__(self, alert_limit_m: float) -> None:
        self._alert_limit_m = alert_limit_m  # horizontal
        self._known: Test | None = None
        self._passed_ns: int | None = None

    def of_epoch(
        self, plain: SatelliteVerdict, cooperative: SatelliteVerdict | None, epoch: RawEpoch, time_ns: int
    ) -> TrustMonitor:
        """Give the statement of an epoch.

        Parameters
        ----------
        plain : SatelliteVerdict
            Of plain RAIM, on the satellites that the cooperative test has not excluded.
        cooperative : SatelliteVerdict or None
            Of the test that uses neighbours; None where it is switched off.
        epoch : RawEpoch
            The measurements that were tested.
        time_ns : int
            [ns, OBU time line] Of the epoch.

        Returns
        -------
        TrustMonitor
            Evaluated if either test is. An accusation names the excluded satellites if the others agree without them,
            and GNSS as a whole if the fault cannot be attributed; it names neighbours that contradict the others. It is
            suspect since the last epoch in which no satellite was accused.
        """
        verdict = cooperative if cooperative and cooperative.evaluated and not plain.evaluated else plain
        if not verdict.evaluated:
            return self._stated(Test(Outcome.NOT_EVALUATED, why_not(verdict, epoch)), time_ns)
        neighbours = cooperative.neighbours if cooperative else ()
        satellites = _accused(verdict)
        accused = (*satellites, *(_name(finding) for finding in neighbours if finding.excluded))[:MAX_ACCUSED]
        found = Test(
            Outcome.ACCUSES if accused else Outcome.PASS, _why(verdict, neighbours), statistic=verdict.statistic,
            threshold=verdict.threshold, false_alarm_rate=verdict.false_alarm_rate, accused=accused,
            suspect_since_ns=time_ns if self._passed_ns is None else self._passed_ns,
        )  # fmt: skip
        tests = {**_satellite_tests(verdict), **dict(_cooperative_tests(cooperative))}
        levels = [
            satellite_verdict.hpl_m
            for satellite_verdict in (plain, cooperative)
            if satellite_verdict and satellite_verdict.hpl_m is not None
        ]
        if levels:
            tests[LEVEL] = _level_test(min(levels), self._alert_limit_m)
        stated = self._stated(found, time_ns, tests)
        if not satellites:
            self._passed_ns = time_ns
        return stated

    def silent(self, time_ns: int, epoch_ns: int | None) -> TrustMonitor:
        """Give the statement without raw measurements.

        Where a satellite was excluded in the last epoch, the receiver's own position contains it and nothing replaces
        that: GNSS is accused as a whole, for a minute.
        """
        excluded = self._known is not None and self._known.accuses and self._passed_ns != epoch_ns
        if not excluded or epoch_ns is None or time_ns - epoch_ns > UNRESOLVED_NS:
            return self._stated(Test(Outcome.NOT_EVALUATED, why_silent(time_ns, epoch_ns)), time_ns)
        why = explain(Code.SILENT_AFTER_EXCLUSION, age_s=_age_s(time_ns, epoch_ns))
        return self._stated(Test(Outcome.ACCUSES, why, accused=(GNSS,), suspect_since_ns=epoch_ns), time_ns)

    def _stated(self, found: Test, time_ns: int, tests: Mapping[str, Test] = NO_TESTS) -> TrustMonitor:
        self._known = lasting(found, self._known, time_ns)
        return statement(MONITOR, self._known, time_ns, tests)


def why_silent(time_ns: int, epoch_ns: int | None) -> Explanation:
    """Say since when there are no raw measurements."""
    if epoch_ns is None:
        return explain(Code.NO_RECEIVER)
    return explain(Code.SILENT, age_s=_age_s(time_ns, epoch_ns))


def why_not(verdict: SatelliteVerdict, epoch: RawEpoch) -> Explanation:
    """Say why the satellites of an epoch are not evaluated."""
    n = len(epoch.measurements)
    if n == 0:
        return explain(Code.NO_MEASUREMENTS)
    if missing := sum(verdict.rejected.get(reason, 0) for reason in WITHOUT_EPHEMERIS):
        return explain(Code.EPHEMERIDES_MISSING, known_count=n - missing, measured_count=n)
    return verdict.why


def _age_s(time_ns: int, epoch_ns: int) -> int:
    return round(abs(time_ns - epoch_ns) / 1e9)


def _name(neighbour: NeighbourFinding) -> str:
    return f"{NEIGHBOUR} {neighbour.name}"


def _accused(verdict: SatelliteVerdict) -> tuple[str, ...]:
    """Excluded satellites, or GNSS where they do not explain the fault."""
    if not verdict.accuses:
        return ()
    named = verdict.fault_free and len(verdict.excluded) <= MAX_ACCUSED
    return tuple(str(satellite) for satellite in verdict.excluded) if named else (GNSS,)


def _why(verdict: SatelliteVerdict, neighbours: tuple[NeighbourFinding, ...]) -> Explanation:
    """Why an epoch has its result: a fault of satellites before one of neighbours."""
    wrong = [finding for finding in neighbours if finding.excluded]
    if verdict.accuses or not wrong:
        return verdict.why
    most = len(wrong) > max(1, len(neighbours) / 2)
    code = Code.MOST_NEIGHBOURS_CONTRADICT if most else Code.NEIGHBOURS_CONTRADICTED
    return explain(code, neighbours=references(wrong))


def _satellite_tests(verdict: SatelliteVerdict) -> dict[str, Test]:
    used = sum(not finding.excluded for finding in verdict.findings)
    rate = verdict.false_alarm_rate or 0.0
    threshold = local_threshold(max(used, 1), rate)
    ordered = sorted(verdict.findings, key=lambda finding: (not finding.excluded, -finding.w))
    return {
        str(finding.satellite): _satellite_test(finding, threshold, rate / max(used, 1))
        for finding in ordered[:MAX_TESTS]
    }


def _satellite_test(finding: SatelliteFinding, threshold: float, rate: float) -> Test:
    """One satellite: |residual| over its standard deviation; an excluded one is tested against the others."""
    subject, residual_m = finding.satellite.reference, round(finding.residual_m, 1)
    if finding.excluded:
        why = explain(Code.LEFT_OUT, subject, residual_m=residual_m)
    elif finding.mdb_m is None:
        why = explain(Code.USED_WITHOUT_BIAS, subject, residual_m=residual_m)
    else:
        why = explain(Code.USED, subject, residual_m=residual_m, bias_m=round(finding.mdb_m, 1))
    return judged(Test(Outcome.NOT_EVALUATED, why, false_alarm_rate=rate), finding.w, threshold)


def _cooperative_tests(verdict: SatelliteVerdict | None) -> Iterator[tuple[str, Test]]:
    """The test with neighbours as a whole, then each neighbour."""
    if verdict is None:
        return
    yield COOPERATIVE, replace(
        verdict, false_alarm_rate=verdict.false_alarm_rate if verdict.statistic is not None else None
    )  # fmt: skip
    for finding in verdict.neighbours:
        code = Code.NEIGHBOUR_LEFT_OUT if finding.excluded else Code.NEIGHBOUR_USED
        why = explain(code, finding.reference, innovation_m_s=round(finding.innovation_m_s, 2))
        yield _name(finding), judged(Test(Outcome.NOT_EVALUATED, why), finding.t, finding.threshold)


def _level_test(level_m: float, alert_limit_m: float) -> Test:
    """Horizontal protection level against the alert limit: beyond it, a fault inside the limit may not be excluded."""
    enough = level_m <= alert_limit_m
    return Test(
        Outcome.PASS if enough else Outcome.NOT_EVALUATED, explain(Code.LEVEL if enough else Code.LEVEL_TOO_LARGE),
        "m", statistic=level_m, threshold=alert_limit_m,
    )  # fmt: skip
