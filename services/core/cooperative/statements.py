"""The statement `satellites` of the verdict on one raw epoch."""

from dataclasses import dataclass

from shared.messages.trust import MonitorOutcome, MonitorTest, TrustMonitor

from .detection import local_threshold
from .measurements import Outcome, RawEpoch, SatelliteFinding, SatelliteVerdict

MONITOR, GNSS = "satellites", "gnss"
UNRESOLVED_NS = 60_000_000_000
MAX_TESTS = 64  # one a satellite: GPS and Galileo have 68 numbers
MAX_ACCUSED = 16  # more satellites at once are a fault of GNSS as a whole
WITHOUT_EPHEMERIS = ("no_ephemeris", "old_ephemeris")


@dataclass(frozen=True)
class Since:
    """The outcome of the statement before, when it was reached, and when the satellites agreed last."""

    outcome: MonitorOutcome | None = None
    since_ns: int | None = None
    passed_ns: int | None = None


def not_evaluated(reason: str, time_ns: int, since: Since) -> TrustMonitor:
    """Give the statement of a monitor that has nothing to test."""
    return TrustMonitor(
        sampled_ns=time_ns, monitor=MONITOR, outcome=MonitorOutcome.NOT_EVALUATED, reason=reason[:400],
        since_ns=_since_ns(MonitorOutcome.NOT_EVALUATED, time_ns, since),
    )  # fmt: skip


def silent(reason: str, time_ns: int, epoch_ns: int | None, since: Since) -> TrustMonitor:
    """Give the statement without raw measurements.

    Where a satellite was excluded in the last epoch, the receiver's own position contains it and nothing replaces that:
    GNSS is accused as a whole, for a minute.
    """
    if since.outcome is not MonitorOutcome.ACCUSES or epoch_ns is None or time_ns - epoch_ns > UNRESOLVED_NS:
        return not_evaluated(reason, time_ns, since)
    return TrustMonitor(
        sampled_ns=time_ns, monitor=MONITOR, outcome=MonitorOutcome.ACCUSES, accused=(GNSS,),
        reason=f"{reason}, and a satellite was excluded before", since_ns=since.since_ns, suspect_since_ns=epoch_ns,
    )  # fmt: skip


def statement(verdict: SatelliteVerdict, epoch: RawEpoch, time_ns: int, since: Since) -> TrustMonitor:
    """Give the statement of a verdict.

    Parameters
    ----------
    verdict : SatelliteVerdict
        Of the epoch.
    epoch : RawEpoch
        The measurements that were tested.
    time_ns : int
        [ns, OBU time line] Of the epoch.
    since : Since
        Of the statement before.

    Returns
    -------
    TrustMonitor
        An accusation names the excluded satellites if the others agree without them, and GNSS as a whole if the fault
        cannot be attributed. It is suspect since the last epoch in which all agreed.
    """
    if verdict.outcome is Outcome.NOT_EVALUATED:
        return not_evaluated(_why_not(verdict, epoch), time_ns, since)
    outcome = MonitorOutcome(verdict.outcome.value)
    accuses = outcome is MonitorOutcome.ACCUSES
    named = verdict.fault_free and len(verdict.excluded) <= MAX_ACCUSED
    accused = tuple(str(satellite) for satellite in verdict.excluded) if named else (GNSS,)
    return TrustMonitor(
        sampled_ns=time_ns, monitor=MONITOR, outcome=outcome, reason=_reason(verdict)[:400],
        accused=accused if accuses else (),
        suspect_since_ns=(time_ns if since.passed_ns is None else since.passed_ns) if accuses else None,
        since_ns=_since_ns(outcome, time_ns, since),
        statistic=verdict.statistic, threshold=verdict.threshold, false_alarm_rate=verdict.false_alarm_rate,
        tests=_tests(verdict),
    )  # fmt: skip


def after(published: TrustMonitor, since: Since) -> Since:
    """Remember what a statement says for the next one."""
    passed_ns = published.sampled_ns if published.outcome is MonitorOutcome.PASS else since.passed_ns
    return Since(published.outcome, published.since_ns, passed_ns)


def _since_ns(outcome: MonitorOutcome, time_ns: int, since: Since) -> int:
    return since.since_ns if since.outcome is outcome and since.since_ns is not None else time_ns


def _why_not(verdict: SatelliteVerdict, epoch: RawEpoch) -> str:
    n = len(epoch.measurements)
    if n == 0:
        return "no raw measurements of GPS L1 or Galileo E1 in this epoch"
    reasons = []
    if missing := sum(verdict.rejected.get(reason, 0) for reason in WITHOUT_EPHEMERIS):
        reasons.append(f"ephemerides of {n - missing} of {n} satellites")
    if verdict.reason:
        reasons.append(verdict.reason)
    return "; ".join(reasons)


def _reason(verdict: SatelliteVerdict) -> str:
    used = sum(not finding.excluded for finding in verdict.findings)
    level = "unbounded" if verdict.hpl_m is None else f"{verdict.hpl_m:.1f} m"
    agree = f"{used} satellites, redundancy {verdict.dof}, horizontal protection level {level}"
    return f"{verdict.reason}; {agree}" if verdict.reason else agree


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
        outcome=MonitorOutcome.ACCUSES if finding.w > threshold else MonitorOutcome.PASS,
        reason=f"{use}, residual {finding.residual_m:.1f} m{bias}",
        statistic=finding.w,
        threshold=threshold,
        false_alarm_rate=rate,
    )
