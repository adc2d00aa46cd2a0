"""The statement `satellites` of the verdicts on one raw epoch."""

from collections.abc import Iterator
from dataclasses import dataclass

from shared.messages.trust import MonitorTest, Outcome, TrustMonitor

from .detection import local_threshold
from .measurements import NeighbourFinding, RawEpoch, SatelliteFinding, SatelliteVerdict

MONITOR, GNSS = "satellites", "gnss"
UNRESOLVED_NS = 60_000_000_000
NEIGHBOUR = "neighbour"  # begins the name of each of them
COOPERATIVE, LEVEL = "cooperative", "horizontal protection level"
MAX_TESTS = 64  # one a satellite: GPS and Galileo have 68 numbers
MAX_ACCUSED = 16  # more satellites at once are a fault of GNSS as a whole
WITHOUT_EPHEMERIS = ("no_ephemeris", "old_ephemeris")


@dataclass(frozen=True)
class Since:
    """The outcome of the statement before, when it was reached, and when no satellite was accused last."""

    outcome: Outcome | None = None
    since_ns: int | None = None
    passed_ns: int | None = None


def not_evaluated(reason: str, time_ns: int, since: Since) -> TrustMonitor:
    """Give the statement of a monitor that has nothing to test."""
    return TrustMonitor(
        sampled_ns=time_ns, monitor=MONITOR, outcome=Outcome.NOT_EVALUATED, reason=reason[:400],
        since_ns=_since_ns(Outcome.NOT_EVALUATED, time_ns, since),
    )  # fmt: skip


def silent(reason: str, time_ns: int, epoch_ns: int | None, since: Since) -> TrustMonitor:
    """Give the statement without raw measurements.

    Where a satellite was excluded in the last epoch, the receiver's own position contains it and nothing replaces that:
    GNSS is accused as a whole, for a minute.
    """
    excluded = since.outcome is Outcome.ACCUSES and since.passed_ns != epoch_ns
    if not excluded or epoch_ns is None or time_ns - epoch_ns > UNRESOLVED_NS:
        return not_evaluated(reason, time_ns, since)
    return TrustMonitor(
        sampled_ns=time_ns, monitor=MONITOR, outcome=Outcome.ACCUSES, accused=(GNSS,),
        reason=f"{reason}, and a satellite was excluded before", since_ns=since.since_ns, suspect_since_ns=epoch_ns,
    )  # fmt: skip


def statement(
    plain: SatelliteVerdict,
    cooperative: SatelliteVerdict | None,
    epoch: RawEpoch,
    time_ns: int,
    since: Since,
    alert_limit_m: float,
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
    since : Since
        Of the statement before.
    alert_limit_m : float
        [m] Horizontal.

    Returns
    -------
    TrustMonitor
        Evaluated if either test is. An accusation names the excluded satellites if the others agree without them, and
        GNSS as a whole if the fault cannot be attributed; it names neighbours that contradict the others. It is
        suspect since the last epoch in which no satellite was accused.
    """  # fmt: skip
    verdict = plain
    if plain.outcome is Outcome.NOT_EVALUATED and cooperative and cooperative.outcome is not Outcome.NOT_EVALUATED:
        verdict = cooperative
    if verdict.outcome is Outcome.NOT_EVALUATED:
        return not_evaluated(why_not(verdict, epoch), time_ns, since)
    neighbours = cooperative.neighbours if cooperative else ()
    accused = (*_accused(verdict), *(finding.name for finding in neighbours if finding.excluded))[:MAX_ACCUSED]
    outcome = Outcome.ACCUSES if accused else Outcome.PASS
    return TrustMonitor(
        sampled_ns=time_ns, monitor=MONITOR, outcome=outcome, reason=_reason(verdict, neighbours)[:400],
        accused=accused,
        suspect_since_ns=(time_ns if since.passed_ns is None else since.passed_ns) if accused else None,
        since_ns=_since_ns(outcome, time_ns, since),
        statistic=verdict.statistic, threshold=verdict.threshold, false_alarm_rate=verdict.false_alarm_rate,
        tests=(
            *_tests(verdict), *_cooperative_tests(cooperative),
            *_level_test(plain, cooperative, alert_limit_m),
        ),
    )  # fmt: skip


def after(published: TrustMonitor, since: Since) -> Since:
    """Remember what a statement says for the next one."""
    satellites_agree = published.outcome is not Outcome.NOT_EVALUATED and all(
        name.startswith(NEIGHBOUR) for name in published.accused
    )
    passed_ns = published.sampled_ns if satellites_agree else since.passed_ns
    return Since(published.outcome, published.since_ns, passed_ns)


def _accused(verdict: SatelliteVerdict) -> tuple[str, ...]:
    """Excluded satellites, or GNSS where they do not explain the fault."""
    if verdict.outcome is not Outcome.ACCUSES:
        return ()
    named = verdict.fault_free and len(verdict.excluded) <= MAX_ACCUSED
    return tuple(str(satellite) for satellite in verdict.excluded) if named else (GNSS,)


def _since_ns(outcome: Outcome, time_ns: int, since: Since) -> int:
    return since.since_ns if since.outcome is outcome and since.since_ns is not None else time_ns


def why_not(verdict: SatelliteVerdict, epoch: RawEpoch) -> str:
    """Say why the satellites of an epoch are not evaluated."""
    n = len(epoch.measurements)
    if n == 0:
        return "no raw measurements of GPS L1 or Galileo E1 in this epoch"
    reasons = []
    if missing := sum(verdict.rejected.get(reason, 0) for reason in WITHOUT_EPHEMERIS):
        reasons.append(f"ephemerides of {n - missing} of {n} satellites")
    if verdict.reason:
        reasons.append(verdict.reason)
    return "; ".join(reasons)


def _reason(verdict: SatelliteVerdict, neighbours: tuple[NeighbourFinding, ...]) -> str:
    used = sum(not finding.excluded for finding in verdict.findings)
    level = "unbounded" if verdict.hpl_m is None else f"{verdict.hpl_m:.1f} m"
    redundancy = f", redundancy {verdict.dof}" if verdict.dof else ""
    agree = f"{used} satellites{redundancy}, horizontal protection level {level}"
    wrong = [finding.name for finding in neighbours if finding.excluded]
    contradicting = f"{', '.join(wrong)} contradicted by the others" if wrong else None
    if len(wrong) > max(1, len(neighbours) / 2):
        contradicting = (
            f"most neighbours contradict the satellites ({', '.join(wrong)}): they collude, or GNSS is wrong"
        )
    return "; ".join(part for part in (verdict.reason, contradicting, agree) if part)


def _tests(verdict: SatelliteVerdict) -> tuple[MonitorTest, ...]:
    used = sum(not finding.excluded for finding in verdict.findings)
    threshold = local_threshold(max(used, 1), verdict.false_alarm_rate)
    ordered = sorted(verdict.findings, key=lambda finding: (not finding.excluded, -finding.w))
    return tuple(_test(finding, threshold, verdict.false_alarm_rate / max(used, 1)) for finding in ordered[:MAX_TESTS])


def _test(finding: SatelliteFinding, threshold: float, rate: float) -> MonitorTest:
    """One satellite: |residual| over its standard deviation; an excluded one is tested against the others."""
    bias = "" if finding.mdb_m is None else f", minimal detectable bias {finding.mdb_m:.1f} m"
    use = "excluded" if finding.excluded else "used"
    return MonitorTest(
        name=str(finding.satellite),
        outcome=Outcome.ACCUSES if finding.w > threshold else Outcome.PASS,
        reason=f"{use}, residual {finding.residual_m:.1f} m{bias}",
        statistic=finding.w,
        threshold=threshold,
        false_alarm_rate=rate,
    )


def _cooperative_tests(verdict: SatelliteVerdict | None) -> Iterator[MonitorTest]:
    """The test with neighbours as a whole, then each neighbour."""
    if verdict is None:
        return
    used = sum(not finding.excluded for finding in verdict.neighbours)
    with_help = f"with {used} neighbours"
    if verdict.reason:
        with_help = verdict.reason if verdict.outcome is Outcome.NOT_EVALUATED else f"{verdict.reason}; {with_help}"
    yield MonitorTest(
        name=COOPERATIVE, outcome=verdict.outcome, reason=with_help[:400],
        statistic=verdict.statistic, threshold=verdict.threshold,
        false_alarm_rate=verdict.false_alarm_rate if verdict.statistic is not None else None,
    )  # fmt: skip
    for finding in verdict.neighbours:
        use = "excluded" if finding.excluded else "used"
        yield MonitorTest(
            name=finding.name,
            outcome=Outcome.ACCUSES if finding.t > finding.threshold else Outcome.PASS,
            reason=f"{use}, innovation of its range-rate {finding.innovation_m_s:.1f} m/s",
            statistic=finding.t, threshold=finding.threshold,
        )  # fmt: skip


def _level_test(
    plain: SatelliteVerdict, cooperative: SatelliteVerdict | None, alert_limit_m: float
) -> Iterator[MonitorTest]:
    """Horizontal protection level against the alert limit: beyond it, a fault inside the limit may not be excluded."""
    levels = [verdict.hpl_m for verdict in (plain, cooperative) if verdict and verdict.hpl_m is not None]
    if not levels:
        return
    level = min(levels)
    enough = level <= alert_limit_m
    yield MonitorTest(
        name=LEVEL, unit="m", statistic=level, threshold=alert_limit_m,
        outcome=Outcome.PASS if enough else Outcome.NOT_EVALUATED,
        reason="faults that matter are excluded" if enough else "a fault that matters may not be excluded",
    )  # fmt: skip
