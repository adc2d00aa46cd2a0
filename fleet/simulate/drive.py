"""Reports of simulated drives: a circle each, at a place of its own."""

import math

from shared.fleet.batch import Report

PERIOD_MS = 1000
BATCH = 10
RADIUS_M, SPEED_M_S = 400.0, 13.0
E7_PER_M = 1e7 / 111_320.0


def report(number: int, utc_ms: int) -> Report:
    """Report of a vehicle, by its number, at a time."""
    angle = utc_ms / 1000.0 * SPEED_M_S / RADIUS_M + number
    row, column = divmod(number, 100)
    latitude = 470_000_000 + row * 200_000 + RADIUS_M * math.sin(angle) * E7_PER_M
    longitude = 80_000_000 + column * 400_000 + RADIUS_M * math.cos(angle) * E7_PER_M / math.cos(math.radians(47))
    height = 45_000 + 300 * math.sin(angle / 3)
    north, east = SPEED_M_S * 100 * math.cos(angle), -SPEED_M_S * 100 * math.sin(angle)
    level = 35 + round(5 * math.sin(angle * 7))
    return Report(utc_ms, round(latitude), round(longitude), round(height), round(north), round(east), level, 0)


def reports(number: int, end_ms: int, count: int = BATCH) -> list[Report]:
    """The last reports before a time, one a second."""
    return [report(number, end_ms - PERIOD_MS * left) for left in reversed(range(count))]
