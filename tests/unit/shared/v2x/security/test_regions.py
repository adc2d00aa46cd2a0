"""Regions of certificates on places at and beside their borders."""

from collections.abc import Sequence

import pytest

from shared.v2x.security.regions import holds


def corner(latitude_deg: float, longitude_deg: float) -> dict[str, int]:
    return {"latitude": round(latitude_deg * 1e7), "longitude": round(longitude_deg * 1e7)}


def polygon(*corners: tuple[float, float]) -> tuple[str, list[dict[str, int]]]:
    return "polygonalRegion", [corner(*place) for place in corners]


def rectangle(north: float, west: float, south: float, east: float) -> tuple[str, list[dict[str, dict[str, int]]]]:
    return "rectangularRegion", [{"northWest": corner(north, west), "southEast": corner(south, east)}]


CONCAVE = polygon((0.0, 0.0), (4.0, 0.0), (1.0, 2.0), (4.0, 4.0), (0.0, 4.0))  # a notch from the north, down to 1
FIJI = polygon((-20.0, 177.0), (-15.0, 177.0), (-15.0, -178.0), (-20.0, -178.0))
CIRCLE = ("circularRegion", {"center": corner(49.0, 1.0), "radius": 1000})


@pytest.mark.parametrize(
    ("region", "inside", "outside"),
    [
        (CONCAVE, [(0.5, 2.0), (3.0, 0.2), (3.0, 3.8)], [(3.0, 2.0), (-0.1, 2.0), (0.5, 4.1), (0.5, -0.1), (4.1, 0.1)]),
        (polygon((0.0, 0.0), (0.0, 4.0), (4.0, 4.0), (4.0, 0.0)), [(2.0, 2.0)], [(2.0, 4.1), (2.0, -0.1)]),
        (FIJI, [(-17.0, 179.0), (-17.0, -179.5)], [(-17.0, 176.0), (-17.0, -177.0), (-17.0, 0.0)]),
        (rectangle(-15.0, 177.0, -20.0, -178.0), [(-17.0, 179.0), (-17.0, -179.5)], [(-17.0, 0.0), (-14.0, 179.0)]),
        (CIRCLE, [(49.0, 1.0), (49.0089, 1.0), (49.0, 1.0136)], [(49.0091, 1.0), (49.0, 1.0138)]),
    ],
)
def test_a_place_is_in_a_region_or_outside(
    region: object, inside: Sequence[tuple[float, float]], outside: Sequence[tuple[float, float]]
) -> None:
    assert [holds(region, *place, ()) for place in inside] == [True] * len(inside)
    assert [holds(region, *place, ()) for place in outside] == [False] * len(outside)
    assert not holds(region, None, None, ())


def test_countries_are_judged_by_where_the_unit_is_and_their_parts_are_not() -> None:
    region = ("identifiedRegion", [("countryOnly", 250), ("countryAndRegions", {"countryOnly": 276, "regions": [1]})])
    assert holds(region, 49.0, 1.0, (250,))
    assert not holds(region, 49.0, 1.0, (276,))
    assert not holds(region, 49.0, 1.0, ())
    assert not holds((None, b"behind the extension mark"), 49.0, 1.0, (250,))
    assert holds(None, None, None, ())
