"""The report: one self-contained HTML page with all figures."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from math import degrees

from shared.messages.explanation import Explanation, explain
from shared.words.words import reason, words

from ..codes import Code
from ..metrics.gnss_alone import WORSE_RATIO
from ..metrics.metrics import METRICS, Value, as_objects
from ..metrics.trust import WORDS
from ..smoothing import SMOOTHED_METRICS
from .drawing import Figure

STYLE = """
:root { color-scheme: light dark; --page: #fff; --ink: #1d2129; --muted: #565d68; --grid: #e3e6ea; --tile: #f4f6f8; }
@media (prefers-color-scheme: dark) { :root { --page: #14171c; --ink: #e6e9ee; --muted: #a3abb6; --grid: #2c323b;
  --tile: #1d2229; --blue: #6cb0f5; --orange: #f0934a; --green: #6cc282; --red: #f2777f; --grey: #7d8590;
  --nominal: #18231b; --nominal-line: #34483a; --unavailable: #20242b; --unavailable-line: #434b57;
  --misleading: #2b2820; --misleading-line: #6d6754; --unavailable-misleading: #332d1e;
  --unavailable-misleading-line: #7d7150; --hazardous: #38241f; --hazardous-line: #a37f72; } }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--page); max-width: 1200px;
  margin: 0 auto; padding: 1rem; }
h1 { font-size: 1.1rem; margin: 0; color: var(--muted); font-weight: 600; overflow-wrap: anywhere; }
h2 { font-size: 1.05rem; margin: 0 0 .3rem; }
.verdict { font-size: 1.3rem; line-height: 1.35; margin: .3rem 0 1rem; } .verdict.worse { color: var(--red, #b3141f); }
.numbers { display: grid; grid-template-columns: repeat(3, 1fr); gap: .6rem; margin: 0; }
.numbers div { background: var(--tile); border-radius: .5rem; padding: .6rem .7rem; }
dt { font-size: .8rem; line-height: 1.3; color: var(--muted); } dd { margin: .2rem 0 0; font-size: 1.2rem;
  font-weight: 600; white-space: nowrap; font-variant-numeric: tabular-nums; }
.first, .figures { display: grid; grid-template-columns: minmax(0, 1fr); gap: 1.2rem; }
@media (min-width: 800px) { .first, .figures { grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 1.2rem 2rem; }
  .first { grid-template-rows: auto 1fr; } .track { grid-area: 1 / 2 / 3 / 3; } }
.said { padding-left: 1.1rem; margin: 0; } figcaption, td.meaning { color: var(--muted); font-size: .9rem; }
details { border-top: 1px solid var(--grid); margin-top: 1.2rem; padding: .6rem 0; }
summary { cursor: pointer; font-weight: 600; padding: .3rem 0; }
.wide { overflow-x: auto; } table { border-collapse: collapse; width: 100%; }
td, th { text-align: left; padding: .3rem .6rem .3rem 0; border-bottom: 1px solid var(--grid); vertical-align: top; }
td.value { white-space: nowrap; font-variant-numeric: tabular-nums; }
code { font-size: .85em; overflow-wrap: anywhere; }
@media (max-width: 600px) { .metrics tr { display: block; padding: .4rem 0; border-bottom: 1px solid var(--grid); }
  .metrics td, .metrics th { display: block; border: 0; padding: 0; } .metrics tr:first-child { display: none; } }
figure { margin: 0; } svg { width: 100%; height: auto; display: block; } svg text { fill: var(--ink); }
"""

MIN_USED_SHARE = (
    0.5  # fraction of the fixes below which a solution is not sound; a receiver that is told twice counts once
)
FEW_RESETS, RESET_PERIOD_S = 2, 300.0  # resets that a sound drive may have: this many, or one in this time


@dataclass(frozen=True)
class Heading:
    """Data of the report's header and summary."""

    name: str
    truth: str
    outage: str | None
    facts: Sequence[tuple[str, str]]  # of the recording: name and value
    integrity_risk: float | None = None  # integrity risk of the protection levels
    made: str = ""  # statement on computed instead of measured data
    set_up: Sequence[str] = ()  # findings of the checks of the set-up
    clocks: Sequence[str] = ()  # what the comparison of the clocks says, where fixes were hardly used


def page(heading: Heading, metrics: dict[str, Value], figures: Sequence[Figure]) -> str:
    """Create the report as HTML without external resources; the first figure is the map of the track."""
    said = "\n".join(f"<li>{escape(sentence)}</li>" for sentence in summary(heading, metrics))
    rows = "\n".join(
        f'<tr><td class="name"><code>{name}</code></td><td class="value">{_shown(name, metrics[name])}</td>'
        f'<td class="meaning">{escape(meaning)}</td></tr>'
        for name, meaning in (METRICS | SMOOTHED_METRICS).items()
        if metrics.get(name) is not None
    )
    track, *others = [
        f"<figure><h2>{escape(f.title)}</h2>{f.svg}<figcaption>{escape(f.caption)}</figcaption></figure>"
        for f in figures
    ]
    drawn = "\n".join(others)
    facts = "\n".join(f"<tr><td>{escape(k)}</td><td><code>{escape(v)}</code></td></tr>" for k, v in heading.facts)
    tiles = "\n".join(f"<div><dt>{escape(what)}</dt><dd>{escape(value)}</dd></div>" for what, value in numbers(metrics))
    judged = re.sub(r"(\d) (m)\b", "\\1\u00a0\\2", verdict(metrics, heading.clocks))  # a number stays with its unit
    worse = " worse" if worse_axes(metrics) or is_hardly_used(metrics) else ""
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{escape(heading.name)}: solved drive</title>
<style>{STYLE}</style>
</head>
<body>
<main>
<h1>{escape(heading.name)}</h1>
<p class="verdict{worse}">{escape(judged)}</p>
<div class="first">
<dl class="numbers">
{tiles}
</dl>
<div class="track">{track}</div>
<ul class="said">
{said}
</ul>
</div>
<details open>
<summary>Figures</summary>
<div class="figures">
{drawn}
</div>
</details>
<details>
<summary>Metrics</summary>
<table class="metrics">
<tr><th>name</th><th>value</th><th>meaning</th></tr>
{rows}
</table>
</details>
<details>
<summary>Data sources and settings</summary>
<div class="wide"><table>
{facts}
</table></div>
</details>
</main>
</body>
</html>
"""


def document(heading: Heading, metrics: dict[str, Value]) -> dict[str, object]:
    """What metrics.json holds: the verdict in a sentence and as codes, then every metric."""
    codes = [explanation.model_dump(mode="json", exclude_none=True) for explanation in judgement(metrics)]
    return {"verdict": verdict(metrics, heading.clocks), "verdict_codes": codes, **as_objects(metrics)}


def verdict(metrics: dict[str, Value], clocks: Sequence[str] = ()) -> str:
    """Judge the drive in sentences: those of the codes, and what the comparison of the clocks says."""
    codes = judgement(metrics)
    if clocks and codes[0].code == Code.UNSOUND:
        return " ".join([reason(codes[0]), *clocks, *(reason(code) for code in codes[2:])])
    return " ".join(reason(code) for code in codes)


def judgement(metrics: dict[str, Value]) -> list[Explanation]:
    """Judge the drive, and say if parts of it have no solution.

    Where the filter used few of the fixes, or was reset often, no other number says anything of the drive: then the
    first code is that, and the second one what to try.
    """
    missing_s = metrics.get("without_solution_s")
    judged = _unsound(metrics) if is_hardly_used(metrics) else _judged(metrics)
    return [*judged, *([explain(Code.MISSING, missing_s=missing_s)] if missing_s else [])]


def is_hardly_used(metrics: dict[str, Value]) -> bool:
    """Whether the filter used less than half of the fixes, or was reset again and again."""
    share, resets = metrics.get("fixes_used_fraction"), metrics.get("filter_resets") or 0
    often = resets > max(FEW_RESETS, (metrics.get("duration_s") or 0.0) / RESET_PERIOD_S)
    return often or (share is not None and share < MIN_USED_SHARE)


def _unsound(metrics: dict[str, Value]) -> list[Explanation]:
    excluded = bool(metrics.get("gnss_excluded_s"))
    found = explain(
        Code.UNSOUND, used_count=metrics["fixes_used"], offered_count=metrics.get("fixes_offered") or 0,
        reset_count=metrics.get("filter_resets") or 0,
    )  # fmt: skip
    return [found, explain(Code.UNSOUND_EXCLUDED if excluded else Code.UNSOUND_UNEXPLAINED)]


def _use(metrics: dict[str, Value]) -> str:
    share, resets = metrics.get("fixes_used_fraction"), metrics.get("filter_resets")
    used = f"{metrics['fixes_used']} of {metrics.get('fixes_offered')} fixes since the alignment were used"
    percent = "" if share is None else f" ({100.0 * share:.3g} %)"
    times = "never" if not resets else "once" if resets == 1 else f"{resets} times"
    return f"{used}{percent}, and the filter was reset {times}"


def _judged(metrics: dict[str, Value]) -> list[Explanation]:
    ours, gnss = metrics["at_fixes_horizontal_rmse_m"], metrics["gnss_alone_horizontal_rmse_m"]
    if ours is not None and gnss is not None and _same_input(metrics):
        axes = worse_axes(metrics)
        code = Code.WORSE if axes else Code.BETTER if ours < gnss / WORSE_RATIO else Code.AS_GOOD
        up, gnss_up = metrics["at_fixes_vertical_rmse_m"], metrics["gnss_alone_vertical_rmse_m"]
        vertical = [explain(Code.VERTICAL, position_m=up, receiver_m=gnss_up)] if None not in (up, gnss_up) else []
        return [explain(code, axes=axes or None, position_m=ours, receiver_m=gnss), *vertical]
    if metrics["horizontal_rmse_m"] is not None:
        horizontal_m, vertical_m = metrics["horizontal_rmse_m"], metrics["vertical_rmse_m"]
        return [explain(Code.TRUTH, horizontal_m=horizontal_m, vertical_m=vertical_m)]
    if metrics["innovation_horizontal_rms_m"] is not None:
        return [explain(Code.INNOVATION, innovation_m=metrics["innovation_horizontal_rms_m"])]
    return [explain(Code.NOTHING)]


def numbers(metrics: dict[str, Value]) -> list[tuple[str, str]]:
    """Three numbers for the first screen: errors if the truth is known, otherwise how well the fixes fit."""
    if metrics["horizontal_rmse_m"] is None:
        return [
            ("Horizontal innovation, RMS", _metres(metrics["innovation_horizontal_rms_m"])),
            ("Fixes rejected", f"{metrics['fixes_rejected']} of {metrics['fixes_recorded']}"),
            ("Distance", f"{_number(metrics['distance_m'])} m"),
        ]
    share = metrics.get("protection_horizontal_misleading_fraction")
    return [
        ("Horizontal error, RMS", _metres(metrics["horizontal_rmse_m"])),
        ("End of an outage, median", _metres(metrics["outage_end_error_median_m"]))
        if metrics["outage_count"]
        else ("Vertical error, RMS", _metres(metrics["vertical_rmse_m"])),
        ("Errors above protection level", "unknown" if share is None else f"{100.0 * share:.3g} %"),
    ]


def _missing(metrics: dict[str, Value]) -> list[str]:
    """Say for how long there was no solution, or one of GNSS alone."""
    found = []
    if metrics.get("without_solution_s"):
        missing = _seconds(metrics["without_solution_s"])
        found.append(f"Without a solution for {missing} s after the first one; these are in none of the errors.")
    if metrics.get("gnss_only_s"):
        alone = _seconds(metrics["gnss_only_s"])
        found.append(f"For {alone} s inertial samples were missing: there the solution is each fix alone.")
    return found


def summary(heading: Heading, metrics: dict[str, Value]) -> list[str]:
    """Summarise the results in a few sentences, the first of which says if they are of no use."""
    driven = f"{_number(metrics['duration_s'])} s of driving, {_number(metrics['distance_m'])} m."
    found = [verdict(metrics, heading.clocks), driven] if is_hardly_used(metrics) else [driven, f"{_use(metrics)}."]
    if metrics["horizontal_rmse_m"] is not None:
        found.append(
            f"Position error: {_metres(metrics['horizontal_rmse_m'])} horizontal RMS (95th percentile "
            f"{_metres(metrics['horizontal_p95_m'])}), {_metres(metrics['vertical_rmse_m'])} vertical RMS."
        )
    found += against_gnss(metrics)
    found += by_verdict(metrics)
    found += _missing(metrics)
    if metrics["outage_count"]:
        gap_s, _, period_s = (heading.outage or "").partition("@")[0].partition("/")
        often = "once" if metrics["outage_count"] == 1 else f"{metrics['outage_count']} times"
        found.append(
            f"GNSS was removed {often}, for {gap_s} s of every {period_s} s; horizontal error at the end of an outage: "
            f"median {_metres(metrics['outage_end_error_median_m'])}, maximum "
            f"{_metres(metrics['outage_end_error_max_m'])}."
        )
    elif metrics["outage_count"] == 0:
        found.append(f"No outage of --outage {heading.outage} could be evaluated: there was no solution within.")
    elif heading.outage:
        found.append(f"No complete outage of --outage {heading.outage} lies within the drive.")
    if metrics.get("smoothed_horizontal_rmse_m") is not None:
        found.append(f"Smoothed: {_metres(metrics['smoothed_horizontal_rmse_m'])} horizontal RMS.")
    if metrics.get("smoothed_outage_inside_max_m") is not None:
        found.append(
            f"Within the outages the smoothed error is {_metres(metrics['smoothed_outage_inside_median_m'])} (median; "
            f"maximum {_metres(metrics['smoothed_outage_inside_max_m'])}), that of the filter "
            f"{_metres(metrics['outage_inside_median_m'])} (maximum {_metres(metrics['outage_inside_max_m'])})."
        )
    found += _protection(heading.integrity_risk, metrics)
    if metrics["innovation_horizontal_rms_m"] is not None:
        predicted = _metres(metrics["innovation_horizontal_rms_m"])
        found.append(f"Horizontal innovation of used GNSS positions: {predicted} RMS.")
    found.append(f"Truth: {heading.truth}.")
    if heading.made:
        found.append(heading.made)
    found += heading.set_up
    return found


def against_gnss(metrics: dict[str, Value]) -> list[str]:
    """Compare the solution with the receiver only, at the same times; state if it is worse. Empty without one."""
    gnss, fused = _errors("gnss_alone", metrics), _errors("at_fixes", metrics)
    shown = ", ".join(
        f"{_metres(a)} {axis} RMS (fused {_metres(b)})"
        for axis, a, b in zip(("horizontal", "vertical"), gnss, fused, strict=True)
        if a is not None and b is not None
    )
    if not shown:
        return []
    found = [f"Receiver only, at the same {metrics['gnss_alone_count']} fixes: {shown}."]
    if axes := worse_axes(metrics):
        said = " and ".join(words().name("adverb", axis) for axis in axes)
        found.append(
            f"Fusion is worse than the receiver {said}: check lever arm, axes and delays, or the "
            "settings of the GNSS error model."
        )
    return found


def worse_axes(metrics: dict[str, Value]) -> list[str]:
    """How the solution is worse than the receiver: horizontally, vertically, both or not at all.

    Fixes at the end of an outage are compared with a solution without GNSS, which says nothing of a fault: then it is
    not said. Where the receiver's own fixes are the truth, there is no such comparison.
    """
    if not _same_input(metrics):
        return []
    gnss, fused = _errors("gnss_alone", metrics), _errors("at_fixes", metrics)
    return [
        axis
        for axis, a, b in zip(("horizontal", "vertical"), gnss, fused, strict=True)
        if a is not None and b is not None and b > WORSE_RATIO * a
    ]


def _same_input(metrics: dict[str, Value]) -> bool:
    """Whether the solution had the fixes it is compared with: no outage has removed some."""
    return not metrics.get("fixes_removed")


def by_verdict(metrics: dict[str, Value]) -> list[str]:
    """State the seconds of each verdict, how long GNSS was excluded, and the harm of it; empty without core.trust."""
    seconds = {word: metrics.get(f"trust_seconds.{level}") for level, word in WORDS.items()}
    excluded_s, harm = metrics.get("gnss_excluded_s"), metrics.get("harm_ratio")
    if excluded_s is None:
        return []
    shown = ", ".join(f"{word} {_seconds(value)} s" for word, value in seconds.items() if value)
    found = [f"Verdict of core.trust: {shown}. GNSS was excluded for {_seconds(excluded_s)} s."]
    if harm is not None and harm != 1.0:
        found.append(
            f"With core.trust the horizontal error is {harm:.3g} times that without it, at the same times; where the "
            "solution is missing, the last one is held."
        )
    return found


def _seconds(value: Value) -> str:
    """A duration, to a tenth of a second where it is short."""
    return "unknown" if value is None else f"{value:.0f}" if value >= 10.0 else f"{value:.1f}"


def _errors(whose: str, metrics: dict[str, Value]) -> tuple[Value, Value]:
    """Horizontal and vertical root mean square errors."""
    return metrics.get(f"{whose}_horizontal_rmse_m"), metrics.get(f"{whose}_vertical_rmse_m")


def _protection(risk: float | None, metrics: dict[str, Value]) -> list[str]:
    """State how many errors exceeded their protection levels; empty without truth or protection levels."""
    shares = []
    for axis in ("horizontal", "vertical"):
        above, share, total = (
            metrics.get(f"protection_{axis}_{name}")
            for name in ("misleading_count", "misleading_fraction", "judged_count")
        )
        if above is None or share is None:
            return []
        shares.append(f"{above} of {total} {axis} errors ({100.0 * share:.3g} %)")
    allowed = "" if risk is None else f"; the integrity risk allows {100.0 * risk:.3g} %"
    return [f"Above the protection level: {' and '.join(shares)}{allowed}."]


def _metres(value: Value) -> str:
    return "unknown" if value is None else f"{value:.3g} m"


def _number(value: Value) -> str:
    return "unknown" if value is None else f"{value:.0f}"


UNITS = (("_m_s", "m/s"), ("_m", "m"), ("_s", "s"), ("_seconds", "s"), ("_seconds_after_60s", "s"))


def _shown(name: str, value: Value) -> str:
    if value is None:
        return "unknown"
    if isinstance(value, int):
        return str(value)
    if name.endswith("_rad"):
        return f"{value:.4g} rad ({degrees(value):.3g}°)"
    unit = next((unit for suffix, unit in UNITS if name.partition(".")[0].endswith(suffix)), "")
    return f"{value:.4g} {unit}".rstrip()
