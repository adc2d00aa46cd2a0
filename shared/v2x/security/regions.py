"""Regions of validity of a certificate (IEEE 1609.2, 6.4.17), judged on one place."""

from collections.abc import Collection, Sequence
from math import hypot, radians
from typing import Any

from ...maths.earth import Geodetic, ned_from_geodetic_difference

TENTH_MICRODEGREE = 1e7  # units of a degree
HALF_TURN, TURN = 1_800_000_000, 3_600_000_000


def holds(  # noqa: PLR0911 - a return for each kind of region
    region: Any, latitude_deg: float | None, longitude_deg: float | None, countries: Collection[int]
) -> bool:
    """Whether a place is in a region.

    Parameters
    ----------
    region : tuple or None
        GeographicRegion as the ASN.1 module decodes it; None: everywhere.
    latitude_deg, longitude_deg : float or None
        The place; an unknown one is in no region.
    countries : collection of int
        Codes of the countries and unions in which this unit is, by which regions named by code are judged: ISO 3166-1
        numeric. Parts of a country are not judged: the place is outside all of them.
    """
    if region is None:
        return True
    if latitude_deg is None or longitude_deg is None:
        return False
    kind, value = region
    place = round(latitude_deg * TENTH_MICRODEGREE), round(longitude_deg * TENTH_MICRODEGREE)
    match kind:
        case "identifiedRegion":
            return any(part[0] == "countryOnly" and part[1] in countries for part in value)
        case "circularRegion":
            return _distance_m(value["center"], latitude_deg, longitude_deg) <= int(value["radius"])
        case "rectangularRegion":
            return any(_in_rectangle(part, *place) for part in value)
        case "polygonalRegion":
            return _in_polygon([_corner(point) for point in value], *place)
    return False


def _distance_m(center: Any, latitude_deg: float, longitude_deg: float) -> float:
    """Horizontal distance [m] of a place from the centre of a circle, of which the radius is at most 65 km."""
    middle = Geodetic(
        radians(center["latitude"] / TENTH_MICRODEGREE), radians(center["longitude"] / TENTH_MICRODEGREE), 0.0
    )
    place = Geodetic(radians(latitude_deg), radians(longitude_deg), 0.0)
    return float(hypot(*ned_from_geodetic_difference(place, middle)[:2]))


def _in_rectangle(part: Any, latitude: int, longitude: int) -> bool:
    (north, west), (south, east) = (_corner(part[name]) for name in ("northWest", "southEast"))
    return south <= latitude <= north and (longitude - west) % TURN <= (east - west) % TURN


def _corner(point: Any) -> tuple[int, int]:
    return int(point["latitude"]), int(point["longitude"])


def _in_polygon(corners: Sequence[tuple[int, int]], latitude: int, longitude: int) -> bool:
    """Count the sides that a ray to the east of the place crosses, in a plane of latitude and longitude.

    Longitudes are relative to the first corner, from which the others are less than half a turn away.
    """
    first = corners[0][1]
    y, x = latitude, _wrapped(longitude - first)
    relative = [(corner_y - y, _wrapped(corner_x - first) - x) for corner_y, corner_x in corners]
    inside = False
    for (y_0, x_0), (y_1, x_1) in zip(relative, [*relative[1:], relative[0]], strict=True):
        if (y_0 > 0) != (y_1 > 0) and (x_0 * (y_1 - y_0) - y_0 * (x_1 - x_0) > 0) == (y_1 > y_0):
            inside = not inside
    return inside


def _wrapped(longitude: int) -> int:
    """Longitude in [-180, 180) degrees."""
    return (longitude + HALF_TURN) % TURN - HALF_TURN
