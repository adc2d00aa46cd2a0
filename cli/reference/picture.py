"""Draws who talks to whom: processes by layer and the flows between them, as SVG for light and dark pages."""

from collections.abc import Iterator
from html import escape
from typing import NamedTuple

from shared.processes import LAYERS

from .flows import VERDICT_TOPIC, Boxes, Flow, boxes, flows

WIDTH, HEIGHT = 860, 520
BOX_W, BOX_H = 112, 30
LEFT = (16, 186, 372, 548, 730)  # of the boxes in each column
BAND = 12  # around the boxes of a layer
TOP, BOTTOM = 12, 508  # of the bands
CORE_BOTTOM = 352  # where the controller's band begins
ROW = 52  # from one device to the next, where there is room
DEVICES = 306  # height for all devices, and for what monitoring gives to others
FIRST = 84  # the uppermost boxes
GROUP_ROW = 24  # from one name in a group to the next
TITLES = {"simulated": "stand for devices", "observers": "read every topic"}
STYLE = """
  svg { --page: #ffffff; --band: #f3f5f8; --box: #ffffff; --line: #8593a3; --text: #1b2430; --faint: #5b6775;
        --flow: #2a66b8; --back: #b4540a; font: 13px system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
  @media (prefers-color-scheme: dark) {
    svg { --page: #0f141a; --band: #18202a; --box: #232d39; --line: #61707f; --text: #e8edf2; --faint: #a3b0bd;
          --flow: #74aef5; --back: #f0a05c; } }
  .page { fill: var(--page); } .band { fill: var(--band); }
  .box { fill: var(--box); stroke: var(--line); } .group { fill: none; stroke: var(--line); stroke-dasharray: 4 3; }
  .name { fill: var(--text); text-anchor: middle; } .layer { fill: var(--text); font-weight: 600; }
  .purpose { fill: var(--faint); font-size: 12px; }
  .flow { fill: none; stroke: var(--flow); stroke-width: 1.5; } .head { fill: var(--flow); }
  .flow.back { stroke: var(--back); stroke-dasharray: 5 3; } .head.back { fill: var(--back); }
"""


Point = tuple[float, float]


class Place(NamedTuple):
    """A box [px]: its left and upper edge, and its size."""

    x: float
    y: float
    width: float
    height: float


def picture() -> str:
    """Draw the processes, and the arrows between them."""
    arranged = boxes()
    places = places_of(arranged)
    found = flows(arranged)
    return "\n".join([
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" role="img"'
        ' aria-labelledby="title">',
        '<title id="title">Processes by layer, and who talks to whom</title>',
        f"<style>{STYLE}</style>",
        *_markers(),
        f'<rect class="page" width="{WIDTH}" height="{HEIGHT}"/>',
        *_bands(),
        *(line for flow in found for line in _arrow(flow, found, places)),
        *_boxes(arranged, places),
        "</svg>",
        "",
    ])  # fmt: skip


def places_of(arranged: Boxes) -> dict[str, Place]:
    """Place every box: devices a row each, corrections above the receiver that they are for."""
    places: dict[str, Place] = {}
    for column in (0, 1):
        devices = sorted(arranged.columns[column], key=lambda row: row.short != "corrections")
        step = min(ROW, DEVICES / len(devices))
        places |= {row.name: _box(column, FIRST + step * n) for n, row in enumerate(devices)}
    group = GROUP_ROW * (len(arranged.monitors) + 1) + 10
    places["monitors"] = Place(LEFT[2], FIRST, BOX_W, group)
    core = [row for row in arranged.columns[2] if row.layer == 4]
    controller = [row for row in arranged.columns[2] if row.layer == 3]
    places |= {row.name: _box(2, FIRST + group + 26 + ROW * n) for n, row in enumerate(core)}
    places |= {row.name: _box(2, CORE_BOTTOM + 70 + 34 * n) for n, row in enumerate(reversed(controller))}
    fusion = places["core.fusion"].y
    step = 144 / max(1, len(arranged.columns[3]) - 1)
    places |= {row.name: _box(3, fusion - 96 + step * n) for n, row in enumerate(arranged.columns[3])}
    outward = sorted(arranged.columns[4], key=lambda row: VERDICT_TOPIC not in row.consumes)
    step = min(76, (DEVICES - 36) / len(outward))
    places |= {row.name: _box(4, FIRST + 36 + step * n) for n, row in enumerate(outward)}
    for name, column, rows in (("simulated", 0, arranged.simulated), ("observers", 4, arranged.observers)):
        height = GROUP_ROW * (len(rows) + 1) + 10
        places[name] = Place(LEFT[column] - 2, BOTTOM - 10 - height, BOX_W + 4, height)
    return places


def _box(column: int, y: float) -> Place:
    return Place(LEFT[column], y, BOX_W, BOX_H)


def _markers() -> Iterator[str]:
    yield "<defs>"
    for kind in ("flow", "back"):
        yield (
            f'<marker id="{kind}" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="6" markerHeight="6" '
            f'orient="auto-start-reverse"><path class="head {kind}" d="M0 0 8 4 0 8z"/></marker>'
        )
    yield "</defs>"


def _bands() -> Iterator[str]:
    """The layers: one beside the other, the controller below the core."""
    right = LEFT[3] + BOX_W
    spans = (
        (LEFT[0], LEFT[0] + BOX_W, TOP, BOTTOM),
        (LEFT[1], LEFT[1] + BOX_W, TOP, BOTTOM),
        (LEFT[2], right, CORE_BOTTOM + 10, BOTTOM),
        (LEFT[2], right, TOP, CORE_BOTTOM),
        (LEFT[4], LEFT[4] + BOX_W, TOP, BOTTOM),
    )
    for number, ((layer, purpose), (left, end, top, bottom)) in enumerate(zip(LAYERS.items(), spans, strict=True), 1):
        size = f'x="{left - BAND}" y="{top}" width="{end - left + 2 * BAND}" height="{bottom - top}"'
        yield f'<rect class="band" {size} rx="8"/>'
        yield f'<text class="layer" x="{left}" y="{top + 20}">{number} {layer}</text>'
        for n, line in enumerate(_lines(purpose, 60 if layer == "core" else 19)):
            yield f'<text class="purpose" x="{left}" y="{top + 36 + 14 * n}">{escape(line)}</text>'


def _lines(text: str, columns: int) -> list[str]:
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) >= columns:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


def _boxes(arranged: Boxes, places: dict[str, Place]) -> Iterator[str]:
    for row in (row for column in arranged.columns for row in column):
        place = places[row.name]
        yield f'<rect class="box" {_size(place)} rx="5"><title>{escape(row.name)}: {escape(row.purpose)}</title></rect>'
        yield _text(place, 20, row.short)
    groups = {"monitors": arranged.monitors, "simulated": arranged.simulated, "observers": arranged.observers}
    for name, rows in groups.items():
        kind = "box" if name == "monitors" else "group"
        yield f'<rect class="{kind}" {_size(places[name])} rx="5"/>'
        title = TITLES.get(name, name)
        yield _text(places[name], 18, title, "purpose")
        for n, row in enumerate(rows, 1):
            yield _text(places[name], 20 + GROUP_ROW * n, row.short)


def _size(place: Place) -> str:
    return f'x="{place.x:g}" y="{place.y:g}" width="{place.width:g}" height="{place.height:g}"'


def _text(place: Place, below: float, text: str, kind: str = "") -> str:
    middle, classes = place.x + place.width / 2, f"name {kind}".strip()
    return f'<text class="{classes}" x="{middle:g}" y="{place.y + below:g}">{escape(text)}</text>'


def _arrow(flow: Flow, found: list[Flow], places: dict[str, Place]) -> Iterator[str]:
    source, target = places[flow.source], places[flow.target]
    back = target.x < source.x
    start, end = _port(flow, flow.source, found, places), _port(flow, flow.target, found, places)
    if source.x == target.x:
        path = _beside(source, target)
    elif target.x - source.x > LEFT[2] - LEFT[0] - 10:
        passage = _passage(flow, found, places)
        inner = (LEFT[2] - 14, passage), (LEFT[2] + BOX_W + 14, passage)
        path = f"M{_curve(start, inner[0])}L{_curve(inner[1], end)}"
    else:
        path = f"M{_curve(start, end)}"
    kind = "back" if back else "flow"
    heads = f'marker-end="url(#{kind})"' + (f' marker-start="url(#{kind})"' if flow.mutual else "")
    title = f"{flow.source} to {flow.target}: {', '.join(flow.topics)}"
    yield f'<path class="flow{" back" if back else ""}" d="{path}" {heads}><title>{escape(title)}</title></path>'


def _beside(source: Place, target: Place) -> str:
    """An arrow within a column: straight between neighbours, around what lies between others."""
    down = target.y > source.y
    start = source.y + (source.height if down else 0)
    end = target.y + (0 if down else target.height)
    if abs(end - start) <= ROW:
        x = source.x + source.width / 2
        return f"M{x:g} {start:g}L{x:g} {end:g}"
    side = -1 if source.x == LEFT[1] else 1  # the one with fewer arrows
    x = source.x + (source.width if side > 0 else 0)
    begin, finish = source.y + 0.7 * source.height, target.y + target.height / 2
    bulge = x + side * (10 + 0.08 * abs(finish - begin))
    return f"M{x:g} {begin:g}C{bulge:g} {begin:g} {bulge:g} {finish:g} {x:g} {finish:g}"


def _curve(start: Point, end: Point) -> str:
    """Begin and end level."""
    middle = (start[0] + end[0]) / 2
    return f"{_at(start)}C{middle:g} {start[1]:g} {middle:g} {end[1]:g} {_at(end)}"


def _at(point: Point) -> str:
    return f"{point[0]:g} {point[1]:g}"


def _passage(flow: Flow, found: list[Flow], places: dict[str, Place]) -> float:
    """Height at which an arrow passes below the boxes of the core."""
    same = [other for other in found if other.target == flow.target and places[other.source].x == places[flow.source].x]
    fusion = places["core.fusion"]
    return fusion.y + fusion.height + 20 + 12 * same.index(flow)


def _port(flow: Flow, box: str, found: list[Flow], places: dict[str, Place]) -> tuple[float, float]:
    """Where an arrow meets a box: those of a side are spread over it, in the order of their other ends."""
    place = places[box]
    right = places[_other(flow, box)].x > place.x
    side = [
        other
        for other in found
        if box in (other.source, other.target)
        and places[_other(other, box)].x != place.x
        and (places[_other(other, box)].x > place.x) is right
    ]
    side.sort(key=lambda other: (places[_other(other, box)].y, other.source))
    share = (side.index(flow) + 1) / (len(side) + 1) if flow in side else 0.5
    return place.x + (place.width if right else 0), place.y + share * place.height


def _other(flow: Flow, box: str) -> str:
    return flow.target if flow.source == box else flow.source
