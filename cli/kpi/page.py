"""The indicators as a table on a page of their own."""

from collections.abc import Mapping
from html import escape

from .indicators import INDICATORS, Value

STYLE = (
    ":root{color-scheme:light dark}body{font-family:sans-serif;max-width:60rem;margin:1rem auto;padding:0 1rem}"
    "table{border-collapse:collapse;width:100%}td{padding:.15rem .6rem;border-top:1px solid #8a8f9855}"
    "td.value{text-align:right;white-space:nowrap;font-variant-numeric:tabular-nums}h2{margin-bottom:.2rem}"
)


def shown(value: Value, unit: str) -> str:
    """Write a value with its unit; shares as a percentage."""
    if value is None:
        return "-"
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return f"{text} {unit}".rstrip()


def as_shown(name: str, value: Value, unit: str) -> str:
    """Write the value of an indicator."""
    if name.endswith("_share") and value is not None:
        return f"{100.0 * value:.5g} %"
    return shown(value, unit)


def page(name: str, truth: str, source: str, values: Mapping[str, Value]) -> str:
    """Create the page as HTML without external resources."""
    parts = []
    for group in dict.fromkeys(row.group for row in INDICATORS):
        rows = "\n".join(
            f"<tr><td><code>{row.name}</code></td>"
            f'<td class="value">{as_shown(row.name, values[row.name], row.unit)}</td>'
            f"<td>{escape(row.meaning)}</td></tr>"
            for row in INDICATORS
            if row.group == group
        )
        parts.append(f"<h2>{group.capitalize()}</h2>\n<table>\n{rows}\n</table>")
    body = "\n".join(parts)
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(name)}: indicators</title><style>{STYLE}</style></head>
<body><h1>{escape(name)}</h1>
<p>Solution: {escape(source)}. Truth: {escape(truth)}. A dash: not known from this recording.</p>
{body}
</body></html>
"""
