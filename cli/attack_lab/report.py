"""The report card: JSON, and one self-contained HTML page with plots."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from html import escape
from math import isfinite
from pathlib import Path

import numpy as np

from shared.messages.trust import TrustLevel

from ..solve.metrics.integrity import Protected
from ..solve.report.drawing import BLUE, GREEN, GREY, ORANGE, RED, Figure, inline_svg, stacked_axes
from ..solve.report.report import STYLE
from ..solve.report.stanford import stanford
from .score import (
    CONFIDENCE,
    RECOVERY_S,
    WARM_UP_S,
    Detection,
    FalseAlarms,
    Run,
    detections,
    false_alarms,
    harms,
    safe_share,
)

COLLUSION = (
    "A majority of colluding neighbours cannot be detected: the expected verdict is SAFE, with the neighbours used by "
    "the leave-one-out bank only."
)
COLOURS = {
    TrustLevel.SAFE: GREEN,
    TrustLevel.CAUTION: ORANGE,
    TrustLevel.UNSAFE: RED,
    TrustLevel.DEAD_RECKONING: BLUE,
}


def document(runs: Sequence[Run], *, planned: int | None = None) -> dict[str, object]:
    """Compute all rates; the same runs give the same document. `planned` is the number of runs without an interrupt."""
    return {
        "planned": len(runs) if planned is None else planned,
        "confidence": CONFIDENCE,
        "warm_up_s": WARM_UP_S,
        "recovery_s": RECOVERY_S,
        "runs": [_run_row(run) for run in runs],
        "safe_share_clean": safe_share(runs),
        "detection": [asdict(row) for row in detections(runs)],
        "false_alarms": [_finite(row) for row in false_alarms(runs)],
        "harm": [asdict(row) for row in harms(runs)],
        "remarks": [COLLUSION],
    }


def _run_row(run: Run) -> dict[str, object]:
    case, timeline = run
    begin_s, _ = case.interval_s
    seconds = {level.value: round(timeline.seconds_in([level], 0.0, timeline.duration_s), 1) for level in TrustLevel}
    return {
        "drive": Path(case.drive).name, "seed": case.seed, "attack": case.label,
        "started_s": begin_s if case.attack else None, "duration_s": round(timeline.duration_s, 1),
        "verdict_s": seconds,
    }  # fmt: skip


def _finite(row: FalseAlarms) -> dict[str, object]:
    """Replace an unbounded limit of an interval by None, which JSON has."""
    low, high = row.per_hour_interval
    return asdict(row) | {"per_hour_interval": (low, high if isfinite(high) else None)}


def write(folder: Path, card: dict[str, object], runs: Sequence[Run]) -> None:
    """Write report.json and report.html."""
    (folder / "report.json").write_text(json.dumps(card, indent=2), encoding="utf-8")
    (folder / "report.html").write_text(page(card, runs), encoding="utf-8")


def page(card: dict[str, object], runs: Sequence[Run]) -> str:
    """Create the page without external resources."""
    figures = "\n".join(
        f"<h2>{escape(one.title)}</h2>\n<figure>{one.svg}<figcaption>{escape(one.caption)}</figcaption></figure>"
        for one in _figures(runs)
    )
    share = card["safe_share_clean"]
    lead = "No clean drive was run."
    if isinstance(share, float):
        lead = f"Clean drives are SAFE for {100.0 * share:.1f} % of the time after the first {WARM_UP_S:.0f} s."
    count = (
        f"{len(runs)} runs." if len(runs) == card["planned"] else f"Interrupted: {len(runs)} of {card['planned']} runs."
    )
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Attack laboratory</title>
<style>{STYLE}
table {{ font-variant-numeric: tabular-nums; font-size: .92em; }} .wide {{ overflow-x: auto; }}</style>
</head>
<body>
<main>
<h1>Attack laboratory</h1>
<p class="lead">{escape(lead)} {count}</p>
<p>{escape(COLLUSION)}</p>
<h2>Detection</h2>
<p class="muted">Runs in which the monitor accuses, or the verdict withdraws the position (UNSAFE, DEAD RECKONING or NO
FIX), between the start and the end of the attack, of all runs; in brackets the median delay. The last three columns:
largest horizontal error of the fused position before the verdict withdraws it, time with the verdict SAFE although
an error is above the alert limit, and runs that end with SAFE, in brackets the longest time from the end of the
attack.</p>
<div class="wide">{_detection_table(runs)}</div>
<h2>False alarms</h2>
<p class="muted">Accusations that begin outside an attack and the {RECOVERY_S:.0f} s after it, overlapping windows as
one episode; {100 * CONFIDENCE:.0f} % intervals.</p>
<div class="wide">{_false_alarm_table(runs)}</div>
{figures}
</main>
</body>
</html>
"""


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    cells = "".join(f"<th>{escape(name)}</th>" for name in head)
    body = "\n".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{cells}</tr>\n{body}</table>"


def detection_rows(runs: Sequence[Run]) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the table of detections: one row an attack, one column a monitor."""
    by_attack: dict[str, list[Detection]] = {}
    for row in detections(runs):
        by_attack.setdefault(row.attack, []).append(row)
    monitors = [row.monitor for row in next(iter(by_attack.values()), [])]
    harm = {row.attack: row for row in harms(runs)}
    last = ("undetected error", "SAFE above limit", "SAFE again")
    head = ["attack", "runs", *(name.replace("_", " ") for name in monitors), *last]
    rows = []
    for attack, found in by_attack.items():
        worst, after_s = harm[attack].largest_undetected_error_m, harm[attack].safe_again_s
        again = f"{harm[attack].recovered}" + ("" if after_s is None else f" ({after_s:.0f} s)")
        rows.append([
            attack, str(found[0].runs), *(_shown(row) for row in found),
            "unknown" if worst is None else f"{worst:.1f} m", f"{harm[attack].hazardous_s:.0f} s", again,
        ])  # fmt: skip
    return head, rows


def _shown(row: Detection) -> str:
    delay = "" if row.delay_median_s is None else f" ({row.delay_median_s:.1f} s)"
    return f"{row.detected}{delay}"


def _detection_table(runs: Sequence[Run]) -> str:
    return _table(*detection_rows(runs))


def _false_alarm_table(runs: Sequence[Run]) -> str:
    rows = [
        [row.monitor.replace("_", " "), f"{row.hours:.2f} h", str(row.episodes),
         "unknown" if row.per_hour is None else f"{row.per_hour:.2f} "
         f"({row.per_hour_interval[0]:.2f} to {row.per_hour_interval[1]:.2f})"]
        for row in false_alarms(runs)
    ]  # fmt: skip
    return _table(["monitor", "evaluated", "episodes", "an hour"], rows)


def _figures(runs: Sequence[Run]) -> Iterator[Figure]:
    yield from _stanford(runs)
    for case, timeline in runs:
        if case.attack is None or case.seed > 1:
            continue
        drawn: list[str] = []
        title = f"{case.label} on {Path(case.drive).name}"
        with stacked_axes(1, 2.6, drawn.append, width=8.6) as (axes,):
            edges = np.r_[timeline.verdict_s, timeline.duration_s]
            for begin, end, level in zip(edges, edges[1:], timeline.verdicts, strict=False):
                axes.axvspan(begin, end, color=COLOURS.get(level, GREY), alpha=0.18, linewidth=0)
            if len(timeline.error_s):
                axes.plot(timeline.error_s, timeline.error_m[:, 0], color=RED, label="horizontal error")
                axes.plot(timeline.error_s, timeline.level_m[:, 0], color=BLUE, label="protection level")
            axes.axhline(timeline.alert_limits_m[0], color=GREY, linestyle="--", label="alert limit")
            for edge in case.interval_s:
                axes.axvline(edge, color="#1d2129", linestyle=":")
            axes.set(xlabel="time [s]", ylabel="[m]", yscale="log", xlim=(0.0, timeline.duration_s))
            axes.legend(loc="upper left", ncols=3)
        caption = "Background: verdict (green SAFE, orange CAUTION, red UNSAFE, blue DEAD RECKONING, grey others). " \
            "Dotted: start and end of the attack."  # fmt: skip
        yield Figure(title, caption, inline_svg(drawn[0], title))


def _stanford(runs: Sequence[Run]) -> Iterator[Figure]:
    """Error against protection level of all runs, after the warm-up."""
    limits = [timeline.alert_limits_m for _, timeline in runs if len(timeline.error_s)]
    if not limits:
        return
    kept = [
        (timeline.error_m[rows], timeline.level_m[rows])
        for _, timeline in runs
        if len(timeline.error_s)
        for rows in [(timeline.error_s >= WARM_UP_S) & np.isfinite(timeline.level_m).all(axis=1)]
    ]
    error, level = (np.concatenate([pair[k] for pair in kept]) for k in (0, 1))
    if not len(error):
        return
    for k, axis in enumerate(("horizontal", "vertical")):
        yield stanford(Protected(axis, error[:, k], level[:, k], limits[0][k]))
