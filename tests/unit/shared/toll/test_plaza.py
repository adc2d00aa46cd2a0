"""The plaza's file: geometry in the tangent plane, and the errors for an invalid file."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shared.errors import ConfigError
from shared.maths.earth import Geodetic, ned_track
from shared.toll.plaza import along, load_plaza, parse_plaza
from tests.support.cases import each

EXAMPLE = Path(__file__).parents[4] / "deploy" / "plazas" / "example.geojson"
PLAZA = load_plaza(EXAMPLE)
Document = dict[str, Any]


def changed(change: Callable[[Document], object]) -> bytes:
    document = json.loads(EXAMPLE.read_text())
    change(document)
    return json.dumps(document).encode()


def test_the_example_has_its_lines_where_they_were_drawn() -> None:
    for lane in PLAZA.lanes:
        approach, gate, leaving = (along(lane.centre, line) for line in (lane.approach, lane.gate, lane.exit))
        assert (approach, gate, leaving) == pytest.approx((300.0, 500.0, 530.0), abs=0.02)  # 8 digits of a degree: 1 mm


def test_neighbouring_lanes_are_a_lane_width_apart() -> None:
    first, second = PLAZA.lanes[0].centre, PLAZA.lanes[1].centre
    assert np.hypot(*(second - first).T) == pytest.approx([3.5] * 3, abs=0.01)


def test_the_plane_agrees_with_the_exact_transformation_through_ecef() -> None:
    position = PLAZA.position(-400.0, 250.0)
    point = np.array(
        [[math.radians(position.latitude_deg), math.radians(position.longitude_deg), PLAZA.antenna.height]]
    )
    exact = ned_track(point, Geodetic(*PLAZA.antenna))[0, :2]
    assert PLAZA.plane(position.latitude_deg, position.longitude_deg) == pytest.approx((-400.0, 250.0), abs=1e-6)
    assert exact == pytest.approx([-400.0, 250.0], abs=0.02)


def test_a_line_beside_the_centre_line_is_not_crossed() -> None:
    centre = np.array([[0.0, 0.0], [10.0, 0.0]])
    assert along(centre, np.array([[5.0, 1.0], [5.0, 2.0]])) is None
    assert along(centre, np.array([[2.0, 1.0], [8.0, 1.0]])) is None  # parallel
    assert along(centre, np.array([[4.0, -1.0], [6.0, 1.0]])) == pytest.approx(5.0)


def test_the_description_is_the_plaza() -> None:
    description = PLAZA.description(7)
    assert [lane.lane for lane in description.lanes] == ["n1", "n2", "n3", "s1", "s2", "s3"]
    assert description.plaza_digest == PLAZA.digest
    assert description.antenna.latitude_deg == pytest.approx(49.44)


@each(
    ("change", "text"),
    [
        (lambda d: d["features"].pop(0), "exactly one feature of kind 'antenna'"),
        (lambda d: d["features"].pop(1), "direction 'north' needs exactly one line of kind 'approach'"),
        (lambda d: d["features"][4]["properties"].update(lane="n2"), "each with a name of its own"),
        (lambda d: d["features"][4]["properties"].update(width_m=-1.0), "width_m: Input should be greater than 1"),
        (lambda d: d["features"][4]["geometry"]["coordinates"].reverse(), "'n1' does not cross its approach, gate"),
        (lambda d: d["features"][4]["geometry"]["coordinates"].append([49.44, 1.1]), "longitude is first"),
        (lambda d: d["tariff"]["classes"].update(car=-5), "tariff.classes.car"),
        (lambda d: d.pop("plaza"), "plaza: Field required"),
    ],
)
def test_an_invalid_file_is_an_error_that_names_the_fault(change: Callable[[Document], object], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        parse_plaza(changed(change), "plaza.geojson")


@pytest.mark.parametrize("data", [b"", b"{", b"\xff\xfe", b"[" * 5000, b"null"])
def test_a_file_without_a_json_object_is_an_error_that_names_the_example(data: bytes) -> None:
    with pytest.raises(ConfigError, match=r"example\.geojson"):
        parse_plaza(data)


def test_a_missing_file_is_named() -> None:
    with pytest.raises(ConfigError, match=r"gone\.geojson"):
        load_plaza(Path("gone.geojson"))


def test_a_plaza_that_no_message_holds_is_refused_with_what_to_change(tmp_path: Path) -> None:
    def lengthen(document: Document) -> None:
        for feature in document["features"]:
            if feature["properties"]["kind"] == "lane":
                first, second, *rest = feature["geometry"]["coordinates"]
                steps = np.linspace(0.0, 1.0, 490, endpoint=False)[:, None]
                points = (np.array(first) + steps * (np.array(second) - np.array(first))).tolist()
                feature["geometry"]["coordinates"] = [*points, second, *rest]
                beside = {
                    **feature,
                    "properties": {**feature["properties"], "lane": feature["properties"]["lane"] + "b"},
                }
                document["features"] = [*document["features"], beside]

    path = tmp_path / "plaza.geojson"
    path.write_bytes(changed(lengthen))
    with pytest.raises(ConfigError, match="leave out points of the centre lines"):
        load_plaza(path)
    assert parse_plaza(path.read_bytes()).name, "evidence of an earlier version is still read"
