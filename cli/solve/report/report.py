"""The report: one self-contained HTML page with all figures."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from math import degrees

from ..metrics.gnss_alone import WORSE
from ..metrics.metrics import METRICS, Value
from ..smoothing import SMOOTHED_METRICS
from .plots import Figure

STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, sans-serif; color: #1d2129; background: #fff; max-width: 960px; margin: 2rem auto;
  padding: 0 1rem; }
h1 { font-size: 1.5rem; margin: 0; } h2 { font-size: 1.1rem; margin: 2rem 0 .3rem; }
.lead { font-size: 1.1rem; } .muted, figcaption, td.meaning { color: #565d68; }
table { border-collapse: collapse; width: 100%; } td, th { text-align: left; padding: .25rem .6rem .25rem 0;
  border-bottom: 1px solid #e3e6ea; vertical-align: top; } td.name, td.value { white-space: nowrap; }
  td.value {  font-variant-numeric: tabular-nums; } code { font-size: .9em; overflow-wrap: anywhere; }
figure { margin: 0; } svg { width: 100%; height: auto; }
"""


@dataclass(frozen=True)
class Heading:
    """Data of the report's header and summary."""

    name: str
    truth: str
    outage: str | None
    facts: Sequence[tuple[str, str]]  # of the recording: name and value
    integrity_risk: float | None = None  # integrity risk of the protection levels
    made: str = ""  # statement on computed instead of measured data


def page(heading: Heading, metrics: dict[str, Value], figures: Sequence[Figure]) -> str:
    """Create the report as HTML without external resources."""
    lead = " ".join(escape(sentence) for sentence in summary(heading, metrics))
    rows = "\n".join(
        f'<tr><td class="name"><code>{name}</code></td><td class="value">{_shown(name, metrics[name])}</td>'
        f'<td class="meaning">{escape(meaning)}</td></tr>'
        for name, meaning in (METRICS | SMOOTHED_METRICS).items()
        if metrics.get(name) is not None
    )
    drawn = "\n".join(
        f"<h2>{escape(f.title)}</h2>\n<figure>{f.svg}<figcaption>{escape(f.caption)}</figcaption></figure>"
        for f in figures
    )
    facts = "\n".join(f"<tr><td>{escape(k)}</td><td><code>{escape(v)}</code></td></tr>" for k, v in heading.facts)
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(heading.name)}: solved drive</title>
<style>{STYLE}</style>
</head>
<body>
<main>
<h1>{escape(heading.name)}</h1>
<p class="lead">{lead}</p>
{drawn}
<h2>Metrics</h2>
<table>
<tr><th>name</th><th>value</th><th>meaning</th></tr>
{rows}
</table>
<h2>Data sources</h2>
<table>
{facts}
</table>
</main>
</body>
</html>
"""


def summary(heading: Heading, metrics: dict[str, Value]) -> list[str]:
    """Summarise the results in a few sentences."""
    found = [f"{_number(metrics['duration_s'])} s of driving, {_number(metrics['distance_m'])} m."]
    if metrics["horizontal_rmse_m"] is not None:
        found.append(
            f"Position error: {_metres(metrics['horizontal_rmse_m'])} horizontal RMS (95th percentile "
            f"{_metres(metrics['horizontal_p95_m'])}), {_metres(metrics['vertical_rmse_m'])} vertical RMS."
        )
    found += against_gnss(metrics)
    if metrics["outage_count"]:
        gap_s, _, period_s = (heading.outage or "").partition("@")[0].partition("/")
        often = "once" if metrics["outage_count"] == 1 else f"{metrics['outage_count']} times"
        found.append(
            f"GNSS was removed {often}, for {gap_s} s of every {period_s} s; horizontal error at the end of an outage: "
            f"median {_metres(metrics['outage_end_error_median_m'])}, maximum "
            f"{_metres(metrics['outage_end_error_max_m'])}."
        )
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
    return found


def against_gnss(metrics: dict[str, Value]) -> list[str]:
    """Compare the solution with GNSS alone at the same times; state if it is worse. Empty without a comparison."""
    gnss, fused = (
        (metrics.get(f"{name}_horizontal_rmse_m"), metrics.get(f"{name}_vertical_rmse_m"))
        for name in ("gnss_alone", "at_fixes")
    )
    if gnss[0] is None or fused[0] is None:
        return []
    shown = ", ".join(
        f"{_metres(a)} {axis} RMS (fused {_metres(b)})"
        for axis, a, b in zip(("horizontal", "vertical"), gnss, fused, strict=True)
        if a is not None and b is not None
    )
    axes = [
        axis
        for axis, a, b in zip(("horizontally", "vertically"), gnss, fused, strict=True)
        if a is not None and b is not None and b > WORSE * a
    ]
    found = [f"GNSS alone at the same {metrics['gnss_alone_count']} fixes: {shown}."]
    if axes:
        found.append(
            f"Fusion is worse than GNSS alone {' and '.join(axes)}: check lever arm, axes and delays, or the settings "
            "of the GNSS error model."
        )
    return found


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


UNITS = (("_m_s", "m/s"), ("_m", "m"), ("_s", "s"))


def _shown(name: str, value: Value) -> str:
    if value is None:
        return "unknown"
    if isinstance(value, int):
        return str(value)
    if name.endswith("_rad"):
        return f"{value:.4g} rad ({degrees(value):.3g}°)"
    unit = next((unit for suffix, unit in UNITS if name.endswith(suffix)), "")
    return f"{value:.4g} {unit}".rstrip()
