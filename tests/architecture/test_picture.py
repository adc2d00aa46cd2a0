"""The picture of the architecture shows every process once, and who talks to whom as the table of processes says."""

import itertools
import xml.etree.ElementTree as ET

from cli.reference.flows import Boxes, boxes, flows
from cli.reference.picture import HEIGHT, WIDTH, picture, places_of
from shared.processes import PROCESSES

SVG = "{http://www.w3.org/2000/svg}"


def names(arranged: Boxes) -> list[str]:
    rows = [*itertools.chain(*arranged.columns), *arranged.monitors, *arranged.simulated, *arranged.observers]
    return [row.name for row in rows]


def test_every_process_is_drawn_once() -> None:
    assert sorted(names(boxes())) == sorted(row.name for row in PROCESSES)
    texts = [node.text for node in ET.fromstring(picture()).iter(f"{SVG}text")]
    assert {row.short for row in PROCESSES} <= set(texts)


def test_no_box_covers_another_one_or_leaves_the_picture() -> None:
    places = places_of(boxes())
    for place in places.values():
        assert 0 <= place.x <= WIDTH - place.width and 0 <= place.y <= HEIGHT - place.height
    for (a, first), (b, second) in itertools.combinations(places.items(), 2):
        beside = first.x + first.width <= second.x or second.x + second.width <= first.x
        assert beside or first.y + first.height <= second.y or second.y + second.height <= first.y, (a, b)


def test_an_arrow_stands_for_topics_of_the_table_and_none_is_drawn_twice() -> None:
    found = flows(boxes())
    pairs = [frozenset((flow.source, flow.target)) for flow in found]
    assert len(pairs) == len(set(pairs))
    by_name = {row.name: row for row in PROCESSES}
    for flow in found:
        if flow.source in by_name and flow.target in by_name:
            shared = set(by_name[flow.source].produces) & set(by_name[flow.target].consumes)
            assert set(flow.topics) <= shared and flow.topics
    drawn = {(flow.source, flow.target): flow for flow in found}
    assert "gnss/raw" in drawn["sensors.gnss", "parsers.gnss"].topics
    assert drawn["core.fusion", "core.trust"].mutual, "the filter follows the verdict"
    assert ("parsers.imu", "controller.mode") not in drawn, "fusion leads there already"
