"""The verdict, the monitors and the events of `core.trust` as JSON for the page Trust."""

from shared.messages.trust import MonitorTest, TrustEvent, TrustMonitor, TrustState
from shared.trust.result import told

from .banner import MONITORS_MAXIMUM, details, ratio_of
from .plain_words import label_of, who

Json = dict[str, object]
TESTS_MAXIMUM = 64  # shown of one monitor


def verdict(state: TrustState, updated_ns: int | None) -> Json:
    """Show a verdict with its reasons, exclusions and limits; stamps instead of ages."""
    shown = state.model_dump(mode="json", exclude={"monitors", "reasons", "findings", "beliefs"})
    reasons, findings = details(state.reasons, state.reason_codes), details(state.findings, state.finding_codes)
    return {**shown, "updated_ns": updated_ns, "reasons": reasons, "findings": findings}


def monitors(state: TrustState) -> Json:
    """Show each monitor and its tests by name, with statistic over threshold where both are there."""
    return {statement.monitor: _monitor(statement) for statement in state.monitors[:MONITORS_MAXIMUM]}


def event(change: TrustEvent) -> Json:
    """Show a change of the verdict with the monitors that accused at that time."""
    return {
        "sampled_ns": change.sampled_ns,
        "before": change.before,
        "after": change.after,
        "reasons": details(change.reasons, change.reason_codes),
        "accusing": [
            {
                "monitor": label_of(m.monitor),
                "accused": who(m.accused),
                "statistic": m.statistic,
                "threshold": m.threshold,
            }
            for m in change.monitors[:MONITORS_MAXIMUM]
            if m.accused
        ],
    }


def _monitor(m: TrustMonitor) -> Json:
    shown = m.model_dump(mode="json", exclude={"tests", "monitor"})
    return {
        **shown,
        **_common(m, m.monitor),
        "accused": who(m.accused),
        "tests": {t.name: _test(t) for t in m.tests[:TESTS_MAXIMUM]},
    }


def _test(test: MonitorTest) -> Json:
    return {**test.model_dump(mode="json", exclude={"name"}), **_common(test, test.name)}


def _common(shown: TrustMonitor | MonitorTest, name: str) -> Json:
    ratio = ratio_of(shown.outcome, shown.statistic, shown.threshold)
    label = label_of(name) if isinstance(shown, TrustMonitor) else name.replace("_", " ")
    return {
        "label": label,
        "reason": told(shown),
        "ratio": None if ratio is None else round(ratio, 4),
    }
