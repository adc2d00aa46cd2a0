"""The report: one page that stands alone, with every figure inside it."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from math import degrees

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
    """What stands above the figures."""

    name: str
    truth: str
    outage: str | None
    facts: Sequence[tuple[str, str]]  # of the recording: what, and how it is
    integrity_risk: float | None = None  # for which protection levels are made
    made: str = ""  # what of the recording no sensor has measured


def page(heading: Heading, metrics: dict[str, Value], figures: Sequence[Figure]) -> str:
    """Make the report as HTML that loads nothing from anywhere."""
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
<h2>Where the data come from</h2>
<table>
{facts}
</table>
</main>
</body>
</html>
"""


def summary(heading: Heading, metrics: dict[str, Value]) -> list[str]:
    """Say in a few sentences what came out."""
    found = [f"{_number(metrics['duration_s'])} s of driving, {_number(metrics['distance_m'])} m."]
    if metrics["horizontal_rmse_m"] is not None:
        found.append(
            f"Against the truth the horizontal position is off by {_metres(metrics['horizontal_rmse_m'])} (root mean "
            f"square; 95 % below {_metres(metrics['horizontal_p95_m'])}), the height by "
            f"{_metres(metrics['vertical_rmse_m'])}."
        )
    if metrics["outage_count"]:
        gap_s, _, period_s = (heading.outage or "").partition("@")[0].partition("/")
        often = "once" if metrics["outage_count"] == 1 else f"{metrics['outage_count']} times"
        found.append(
            f"GNSS was taken away {often}, for {gap_s} s of every {period_s} s; at the end of an outage the horizontal "
            f"position is off by {_metres(metrics['outage_end_error_median_m'])} (median; worst "
            f"{_metres(metrics['outage_end_error_max_m'])})."
        )
    elif heading.outage:
        found.append(f"No whole outage of --outage {heading.outage} lies within the drive.")
    if metrics.get("smoothed_horizontal_rmse_m") is not None:
        found.append(f"Smoothed, the position is off by {_metres(metrics['smoothed_horizontal_rmse_m'])}.")
    if metrics.get("smoothed_outage_inside_max_m") is not None:
        found.append(
            f"Within the outages it is off by {_metres(metrics['smoothed_outage_inside_median_m'])} (median; worst "
            f"{_metres(metrics['smoothed_outage_inside_max_m'])}), where the filter is off by "
            f"{_metres(metrics['outage_inside_median_m'])} (worst {_metres(metrics['outage_inside_max_m'])})."
        )
    found += _protection(heading.integrity_risk, metrics)
    if metrics["innovation_horizontal_rms_m"] is not None:
        predicted = _metres(metrics["innovation_horizontal_rms_m"])
        found.append(f"Just before a fix is used, the solution is {predicted} away from it (root mean square).")
    found.append(f"The truth is: {heading.truth}.")
    if heading.made:
        found.append(heading.made)
    return found


def _protection(risk: float | None, metrics: dict[str, Value]) -> list[str]:
    """Say how many errors were above their protection levels; nothing where there is no truth or no level."""
    shares = []
    for axis in ("horizontal", "vertical"):
        above, share, judged = (
            metrics.get(f"protection_{axis}_{name}")
            for name in ("misleading_count", "misleading_fraction", "judged_count")
        )
        if above is None or share is None:
            return []
        shares.append(f"{above} of {judged} {axis} errors ({100.0 * share:.3g} %)")
    promised = "" if risk is None else f", which may happen to {100.0 * risk:.3g} % (integrity risk {risk:g})"
    return [f"Above their protection levels were {' and '.join(shares)}{promised}."]


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
