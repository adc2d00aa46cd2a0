"""The report card: JSON, and one self-contained HTML page with plots."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from html import escape
from math import isfinite
from pathlib import Path

import numpy as np

from shared.messages.trust import TrustLevel

from ..solve.metrics.integrity import AxisProtection
from ..solve.report.drawing import BLUE, GREEN, GREY, ORANGE, RED, Figure, inline_svg, stacked_axes
from ..solve.report.report import STYLE
from ..solve.report.stanford import stanford
from .cases import ATTACKS, Case, labels
from .outcome import TRACK_EVERY_S, Answer, answers, outcome
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

FULL_RUNS = 6 * (len(ATTACKS) + 1)  # three seeds of two drives
COLLUSION = (
    "A majority of colluding neighbours cannot be detected: the expected verdict is SAFE, with the neighbours used by "
    "the leave-one-out bank only."
)
TABLES = """
table { font-variant-numeric: tabular-nums; font-size: .92em; }
@media (max-width: 800px) { .cards, .cards tbody, .cards tr, .cards td { display: block; }
  .cards tr:first-child { display: none; } .cards tr { border-bottom: 1px solid var(--grid); padding: .5rem 0; }
  .cards td { display: grid; grid-template-columns: 11rem minmax(0, 1fr); gap: .6rem; border: 0; padding: .1rem 0; }
  .cards td::before { content: attr(data-column); color: var(--muted); }
  .cards td:first-child { display: block; font-weight: 600; } .cards td:first-child::before { content: none; } }
"""
COLOURS = {
    TrustLevel.SAFE: GREEN,
    TrustLevel.CAUTION: ORANGE,
    TrustLevel.UNSAFE: RED,
    TrustLevel.DEAD_RECKONING: BLUE,
}


def document(runs: Sequence[Run], *, planned: Sequence[Case] | None = None) -> dict[str, object]:
    """Compute all rates; the same runs give the same document. `planned` are the cases without an interrupt."""
    finished = [case for case, _ in runs]
    cases = finished if planned is None else planned
    return {
        "planned": len(cases),
        "unfinished": [
            f"{case.label} on {Path(case.drive).name}, seed {case.seed}" for case in cases if case not in finished
        ],
        "attacks_not_run": not_run(finished),
        "confidence": CONFIDENCE,
        "warm_up_s": WARM_UP_S,
        "recovery_s": RECOVERY_S,
        "track_every_s": TRACK_EVERY_S,
        "runs": [_run_row(run) for run in runs],
        "safe_share_clean": safe_share(runs),
        "answers": [asdict(row) for row in answers(runs)],
        "detection": [asdict(row) for row in detections(runs)],
        "false_alarms": [_finite(row) for row in false_alarms(runs)],
        "harm": [asdict(row) for row in harms(runs)],
        "remarks": [COLLUSION],
    }


def not_run(cases: Sequence[Case]) -> list[str]:
    """List attacks of the default campaign of which no case is finished."""
    done = {case.label for case in cases}
    return [label for label in labels(ATTACKS) if label not in done]


def _run_row(run: Run) -> dict[str, object]:
    case, timeline = run
    begin_s, _ = case.interval_s
    seconds = {level.value: round(timeline.seconds_in([level], 0.0, timeline.duration_s), 1) for level in TrustLevel}
    return {
        "drive": Path(case.drive).name, "seed": case.seed, "attack": case.label,
        "started_s": begin_s if case.attack else None, "duration_s": round(timeline.duration_s, 1),
        "verdict_s": seconds, "outcome": asdict(outcome(case, timeline)) if case.attack else None,
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
        f"<h2>{escape(figure.title)}</h2>\n<figure>{figure.svg}<figcaption>{escape(figure.caption)}</figcaption></figure>"
        for figure in _figures(runs)
    )
    share = card["safe_share_clean"]
    lead = "No clean drive was run."
    if isinstance(share, float):
        lead = f"Clean drives are SAFE for {100.0 * share:.1f} % of the time after the first {WARM_UP_S:.0f} s."
    count = (
        f"{len(runs)} runs." if len(runs) == card["planned"] else f"Interrupted: {len(runs)} of {card['planned']} runs."
    )
    if len(runs) < FULL_RUNS:
        count += f" A full campaign (make attack-lab FULL=1) has {FULL_RUNS}; the intervals are wider accordingly."
    interval = f"{100 * CONFIDENCE:.0f} %"
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Attack laboratory</title>
<style>{STYLE}{TABLES}</style>
</head>
<body>
<main>
<h1>Attack laboratory</h1>
<p class="lead">{escape(lead)} {count} After an attack a drive went on for {_after_text(runs)}.</p>
<p>{escape(COLLUSION)}</p>
{_not_run_text(card)}
<h2>Answers to the attacks</h2>
<p class="muted">Scored against the truth at every time from the start of an attack to the end of its run. "Detected":
runs in which a monitor suspects a source, or the verdict withdraws the position (UNSAFE, DEAD RECKONING or NO FIX),
between the start and the end of the attack. "Suspected rightly": runs in which a source at fault is suspected
meanwhile, and no healthy one is excluded until the end of the run. In brackets the {interval} interval of the rate,
of Clopper and Pearson. "SAFE above level" and "above limit": time, over all runs, that is SAFE although the
horizontal or vertical error is above the published protection level, or above the alert limit. "Errors above level":
the share of all times, SAFE or not. The other columns are those of the worst run: the largest error while SAFE,
horizontal and vertical; how long a healthy source is excluded, and how long the attacked one after the end of the
attack; the time from the start until the verdict is not SAFE, and from the end until it stays SAFE or CAUTION;
horizontal error and level at the end of the run.</p>
{_table(*answer_rows(runs))}
<h2>Detection by monitor</h2>
<p class="muted">Runs in which the monitor suspects a source, or the verdict withdraws the position, between the start
and the end of the attack, with the {interval} Clopper-Pearson interval of the rate and the median delay. The last
three columns: largest horizontal error of the fused position before the verdict withdraws it, time that is SAFE
although an error is above the alert limit, and runs that end with SAFE, in brackets the longest time from the end of
the attack.</p>
{_table(*detection_rows(runs))}
<h2>False alarms</h2>
<p class="muted">Suspicions that begin outside an attack and the {RECOVERY_S:.0f} s after it, overlapping windows as
one episode; {interval} intervals, exact for a Poisson rate.</p>
{_false_alarm_table(runs)}
{figures}
</main>
</body>
</html>
"""


def _after_text(runs: Sequence[Run]) -> str:
    lasting = {round(timeline.duration_s - case.interval_s[1]) for case, timeline in runs if case.attack}
    if not lasting:
        return "no time: there was none"
    return f"{min(lasting)} s" if len(lasting) == 1 else f"{min(lasting)} to {max(lasting)} s"


def _not_run_text(card: dict[str, object]) -> str:
    """Say which attacks and which planned cases have no run."""
    parts = []
    for title, names in (
        ("Attacks of the default campaign that were not run", card["attacks_not_run"]),
        ("Planned runs that were not finished", card["unfinished"]),
    ):
        if isinstance(names, list) and names:
            listed = "; ".join(escape(str(name)) for name in names)
            parts.append(f"<details><summary>{title}: {len(names)}</summary><p>{listed}</p></details>")
    return "\n".join(parts) or "<p>Every attack of the default campaign was run.</p>"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Make a table that a narrow screen shows as one card a row, each cell below the name of its column."""
    cells = "".join(f"<th>{escape(name)}</th>" for name in head)
    body = "\n".join(
        "<tr>"
        + "".join(f'<td data-column="{escape(name)}">{escape(cell)}</td>' for name, cell in zip(head, row, strict=True))
        + "</tr>"
        for row in rows
    )
    return f'<div class="wide"><table class="cards"><tr>{cells}</tr>\n{body}</table></div>'


def answer_rows(runs: Sequence[Run]) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the table of answers: one row an attack."""
    head = [
        "attack", "runs", "detected", "suspected rightly", "should be suspected", "suspected",
        "suspected after the end",
        "SAFE above level", "SAFE above limit", "errors above level", "largest error while SAFE",
        "healthy source excluded", "attacked source excluded after", "not SAFE after", "usable again after",
        "error at the end", "level at the end",
    ]  # fmt: skip
    return head, [_answer_row(row) for row in answers(runs)]


def _answer_row(row: Answer) -> list[str]:
    excluded = "none"
    if row.healthy_excluded:
        excluded = f"{', '.join(row.healthy_excluded)}, {row.healthy_excluded_s:.0f} s"
    known = row.end_error_m[0] is not None
    return [
        row.attack, str(row.runs), rate_text(row.detected, row.runs, row.detected_interval),
        rate_text(row.right, row.runs, row.right_interval), row.expected, ", ".join(row.accused) or "nobody",
        ", ".join(row.accused_after) or "nobody",
        f"{row.safe_above_level_s:.0f} s" if known else "unknown",
        f"{row.safe_above_limit_s:.0f} s" if known else "unknown",
        "unknown" if row.above_level_fraction is None else f"{100.0 * row.above_level_fraction:.1f} %",
        _metres_text(row.safe_error_m) if row.safe_s else "never SAFE", excluded, f"{row.excluded_after_s:.0f} s",
        "SAFE to the end" if row.not_safe_after_s is None else
        f"{row.not_safe_after_s:.0f} s ({row.not_safe} of {row.runs})",
        "not" if row.usable_again_s is None else f"{row.usable_again_s:.0f} s ({row.usable_again} of {row.runs})",
        _metres_text(row.end_error_m[:1]), _metres_text(row.end_level_m[:1]),
    ]  # fmt: skip


def rate_text(count: int, runs: int, interval: tuple[float, float]) -> str:
    """A rate with its interval: `2 of 3 (9 to 99 %)`."""
    low, high = interval
    return f"{count} of {runs} ({100.0 * low:.0f} to {100.0 * high:.0f} %)"


def _metres_text(values: Sequence[float | None]) -> str:
    shown = ["unknown" if value is None else f"{value:.1f} m" for value in values]
    return "unknown" if set(shown) == {"unknown"} else ", ".join(shown)


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
    for attack, item in by_attack.items():
        worst, after_s = harm[attack].largest_undetected_error_m, harm[attack].safe_again_s
        again = f"{harm[attack].recovered}" + ("" if after_s is None else f" ({after_s:.0f} s)")
        rows.append([
            attack, str(item[0].runs), *(_shown(row) for row in item),
            "unknown" if worst is None else f"{worst:.1f} m", f"{harm[attack].hazardous_s:.0f} s", again,
        ])  # fmt: skip
    return head, rows


def _shown(row: Detection) -> str:
    delay = "" if row.delay_median_s is None else f", {row.delay_median_s:.1f} s"
    return f"{rate_text(row.detected, row.runs, row.rate_interval)}{delay}"


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
        yield stanford(AxisProtection(axis, error[:, k], level[:, k], limits[0][k]))
