"""A known place: recognised by a vehicle that had left it and stands there again, and by no other one."""

import pytest

from services.core.fusion.integrity.known_place import AWAY_M, MIN_STANDSTILL_S, KnownPlace, known_well
from shared.maths.earth import Geodetic, geodetic_from_ned_difference

HOME = Geodetic(0.9, 0.2, 300.0)
SECOND_NS = 1_000_000_000


@pytest.mark.parametrize(
    ("drove_m", "beside_m", "stands", "expected"),
    [(2 * AWAY_M, 2.0, True, True), (0.5 * AWAY_M, 2.0, True, False), (2 * AWAY_M, 15.0, True, False),
     (2 * AWAY_M, 2.0, False, False)],
    ids=["back", "never left", "beside it", "drives past"],
)  # fmt: skip
def test_a_place_is_recognised_by_a_vehicle_that_stands_there_again(
    drove_m: float, beside_m: float, stands: bool, expected: bool
) -> None:
    place, found = KnownPlace(HOME, (1.0, 2.0)), False
    away = geodetic_from_ned_difference((drove_m, 0.0, 0.0), HOME)
    assert not place.recognised(0, away, (1.0, 1.0), stationary=True)
    back = geodetic_from_ned_difference((0.0, beside_m, 0.0), HOME)
    place.recognised(SECOND_NS, back, (1.0, 1.0), stationary=False)
    for second in range(2, 4 + int(MIN_STANDSTILL_S)):
        found |= place.recognised(second * SECOND_NS, back, (1.0, 1.0), stationary=stands)
    assert found is expected


def test_a_place_that_was_in_doubt_is_none() -> None:
    assert known_well(2.0) and not known_well(60.0) and not known_well(None)
