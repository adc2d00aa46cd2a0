"""The summary of a run in words: one line a figure, with its unit; nothing for what is not known."""

from collections.abc import Callable, Mapping

from shared.words.words import words

Shown = Callable[[object], str]


def _metres(value: object) -> str:
    return f"{value} m"


def _milliseconds(value: object) -> str:
    return f"{value} ms"


def _seconds(value: object) -> str:
    return f"{value} s"


def _per_second(value: object) -> str:
    return f"{value} a second"


def _share(value: object) -> str:
    return f"{100.0 * float(str(value)):.0f} % of one processor core"


def _shares(value: object) -> str:
    assert isinstance(value, Mapping)
    busy = sorted(value.items(), key=lambda entry: -entry[1])
    return ", ".join(f"{name} {100.0 * share:.0f} %" for name, share in busy if share >= 0.005) or "less than 1 % each"


def _verdicts(value: object) -> str:
    """Seconds in each state; those that did not occur are left out."""
    assert isinstance(value, Mapping)
    said = [f"{words().name('state', state)} {seconds:g} s" for state, seconds in value.items() if seconds]
    return ", ".join(said) or "none was published"


def _yes(value: object) -> str:
    return "yes" if value else "no"


# Label and form of each field of `Summary` and `PlazaSummary`, in the order of the fields.
FIELDS: Mapping[str, tuple[str, Shown]] = {
    "healthy": ("healthy", _yes),
    "duration_s": ("driven", _seconds),
    "processes_alive": ("processes alive at the end", str),
    "processes_expected": ("processes of this unit", str),
    "restarts": ("restarts", str),
    "messages_per_second": ("messages", _per_second),
    "broken_messages": ("messages that could not be decoded", str),
    "gnss_position_rmse_m": ("error of the receiver only, 3-D RMS", _metres),
    "gnss_horizontal_rmse_m": ("error of the receiver only, horizontal RMS", _metres),
    "fusion_at_fixes_position_rmse_m": ("error of the solution at its fixes, 3-D RMS", _metres),
    "fusion_at_fixes_horizontal_rmse_m": ("error of the solution at its fixes, horizontal RMS", _metres),
    "fusion_worse_than_gnss": ("solution worse than the receiver only", _yes),
    "fusion_position_rmse_m": ("error of the solution, 3-D RMS", _metres),
    "fusion_horizontal_rmse_m": ("error of the solution, horizontal RMS", _metres),
    "protection_horizontal_median_m": ("horizontal protection level, median", _metres),
    "protection_vertical_median_m": ("vertical protection level, median", _metres),
    "misleading_horizontal": ("solutions with a horizontal error above the level", str),
    "misleading_vertical": ("solutions with a vertical error above the level", str),
    "fixes": ("GNSS fixes", str),
    "solutions": ("solutions", str),
    "end_to_end_latency_p50_ms": ("delay from the sensor to the solution, median", _milliseconds),
    "end_to_end_latency_p99_ms": ("delay from the sensor to the solution, 99 %", _milliseconds),
    "worst_topic": ("topic with the oldest data", str),
    "worst_topic_age_s": ("its age", _seconds),
    "without_fix_s": ("since the last GNSS fix with a position", _seconds),
    "trust": ("verdicts", _verdicts),
    "safe_above_alert_limit_s": ("SAFE with an error above the alert limit", _seconds),
    "checks_paused_s": ("checks paused, because the computer was too slow", _seconds),
    "passages": ("passages", str),
    "passages_equipped": ("of vehicles that send CAM", str),
    "passages_registered": ("of registered vehicles", str),
    "transactions": ("charges", str),
    "double_charges": ("charged twice", str),
    "wrong_charges": ("charged without a passage", str),
    "missed": ("registered passages that were missed", str),
    "undecided": ("passages without a decided lane", str),
    "suspect": ("passages with a suspected position", str),
    "void": ("passages that were void", str),
    "lane_decisions": ("decided lanes whose true lane is known", str),
    "lane_decisions_right": ("of these right", str),
    "receipts": ("receipts of the operator", str),
    "outbox": ("transactions that wait for a receipt", str),
    "detections": ("detector pulses", str),
    "detections_missed": ("pulses without a passage", str),
    "held": ("charges that wait for their detector pulse", str),
    "in_review": ("passages in review", str),
    "unconfirmed": ("charges not confirmed by a detector", str),
    "accounts_closed": ("accounts that are closed", str),
    "accounts_provisional": ("outcomes that may still change", str),
    "accounts_pending": ("outcomes that are awaited", str),
    "accounts_agree": ("accounts agree in every lane", _yes),
    "cams_per_second": ("CAM", _per_second),
    "cpu_share": ("load", _share),
    "cpu_share_by_process": ("load by process", _shares),
}


def lines(summary: Mapping[str, object]) -> list[str]:
    """Format the figures of a summary, one line each."""
    shown = [(FIELDS[name], value) for name, value in summary.items() if name in FIELDS]
    width = max(len(label) for (label, _), _ in shown)
    return [f"{label:{width}}  {'not known' if value is None else form(value)}" for (label, form), value in shown]
