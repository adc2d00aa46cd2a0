from math import pi, radians

import numpy as np
import pytest

from services.core.fusion.aids.gnss.fix import GnssPosition
from services.core.fusion.codes import HeadingMethod
from services.core.fusion.settings import Settings
from services.core.fusion.start.heading import (
    SAVED_YAW_SD_LIMIT,
    Heading,
    Motion,
    Prior,
    heading_of_motion,
    parked_heading,
    saved_heading,
)
from services.core.fusion.start.levelling import Levelling
from shared.maths.earth import STANDARD_GRAVITY, Geodetic, geodetic_from_ned_difference
from shared.maths.rotation import Vector

STEP_S = 0.01
PLACE = Geodetic(0.74, 0.2, 100.0)
SD: Vector = (0.05, 0.05, 0.1)
STILL: Vector = (0.0, 0.0, 0.0)


def levelled(acceleration: float, *, rest_s: float = 5.0, drive_s: float = 3.0, rate: float = 0.0) -> Levelling:
    """Standstill, then a drive with an acceleration along the body and a turn to the right."""
    levelling = Levelling(Settings())
    for _ in range(round(rest_s / STEP_S)):
        levelling.advance((0.0, 0.0, -STANDARD_GRAVITY), STILL, STEP_S)
    for _ in range(round(drive_s / STEP_S)):
        levelling.advance((acceleration, 0.0, -STANDARD_GRAVITY), (0.0, 0.0, rate), STEP_S)
    return levelling


def fix_at(ned: Vector, time_s: float = 0.0, sd: float = 0.02) -> GnssPosition:
    position = geodetic_from_ned_difference(ned, PLACE)
    return GnssPosition(round(time_s * 1e9), 0, "", position, np.eye(3) * sd**2, 3, STILL, 0.0)


def heading(levelling: Levelling, velocity: Vector, swing: Vector = STILL) -> Heading:
    found = heading_of_motion(Motion(0, velocity, SD, swing), levelling, Settings())
    assert found is not None
    return found


def test_an_acceleration_forwards_to_the_east_gives_a_heading_of_east() -> None:
    found = heading(levelled(1.0), (0.0, 3.0, 0.0))
    assert found.method is HeadingMethod.VELOCITY
    assert found.turn == pytest.approx(pi / 2, abs=0.01)
    assert found.sd < radians(5.0)


def test_an_acceleration_backwards_to_the_east_gives_a_heading_of_west() -> None:
    found = heading(levelled(-1.0), (0.0, 3.0, 0.0))
    assert found.method is HeadingMethod.VELOCITY
    assert abs(found.turn) == pytest.approx(pi / 2, abs=0.01) and found.turn < 0.0


def test_without_a_standstill_the_heading_is_the_course_over_ground() -> None:
    found = heading(levelled(0.0, rest_s=0.0), (3.0, 0.0, 0.0))
    assert found.method is HeadingMethod.COURSE
    assert found.turn == pytest.approx(0.0, abs=1e-9)
    assert found.sd >= Settings().alignment.course_yaw_sd_rad


def test_the_velocity_of_the_lever_arm_is_removed_from_the_course() -> None:
    """The antenna has 1 m/s to the right from rotation, on a vehicle that drives north at 10 m/s."""
    found = heading(levelled(0.0, rest_s=0.0), (10.0, 1.0, 0.0), swing=(0.0, 1.0, 0.0))
    assert found.turn == pytest.approx(0.0, abs=1e-3)


def test_a_speed_below_2_m_s_gives_no_heading() -> None:
    assert heading_of_motion(Motion(0, (1.9, 0.0, 0.0), SD, STILL), levelled(1.0), Settings()) is None


def test_a_saved_heading_is_used_at_standstill_at_the_saved_position() -> None:
    saved = Prior(PLACE, (1.0, 1.0, 2.0), radians(70.0), radians(1.0))
    found = saved_heading(saved, levelled(0.0, drive_s=0.0), fix_at((3.0, 0.0, 0.0), sd=2.0))
    assert found is not None
    assert found.turn == pytest.approx(radians(70.0))
    assert found.sd == pytest.approx(radians(1.0), abs=1e-6)


def test_a_saved_heading_is_not_used_at_another_position_or_in_motion() -> None:
    saved = Prior(PLACE, (1.0, 1.0, 2.0), radians(70.0), radians(1.0))
    assert saved_heading(saved, levelled(0.0, drive_s=0.0), fix_at((300.0, 0.0, 0.0), sd=2.0)) is None
    assert saved_heading(saved, levelled(1.0, rest_s=0.0, rate=0.1), fix_at(STILL)) is None


@pytest.mark.parametrize(("yaw_sd", "parked", "used"), [
    (SAVED_YAW_SD_LIMIT, True, True), (1.001 * SAVED_YAW_SD_LIMIT, True, False), (0.01, False, False),
])  # fmt: skip
def test_a_saved_heading_of_a_parked_vehicle_counts_up_to_a_deviation_of_30_degrees(
    yaw_sd: float, parked: bool, used: bool
) -> None:
    found = parked_heading(Prior(PLACE, SD, 1.0, yaw_sd, parked=parked), levelled(0.0, drive_s=0.0))
    assert (found is not None) == used
    assert found is None or (found.turn == pytest.approx(1.0, abs=1e-6) and found.sd >= yaw_sd)
