"""Heading and velocity from positions alone: a flat world, a turned frame, and an antenna beside the IMU."""

from cmath import rect
from math import radians, sqrt

import numpy as np
import pytest

from services.core.fusion.aids.gnss.fix import GnssPosition
from services.core.fusion.codes import HeadingMethod
from services.core.fusion.settings import Settings
from services.core.fusion.start.heading import Heading, Motion
from services.core.fusion.start.levelling import Levelling
from services.core.fusion.start.track_matching import Point, moved_m_s, track
from shared.maths.earth import STANDARD_GRAVITY, Geodetic, geodetic_from_ned_difference, wrap_angle
from shared.maths.rotation import Vector

STEP_S, YAW = 0.01, radians(100.0)
PLACE = Geodetic(0.74, 0.2, 100.0)
STILL: Vector = (0.0, 0.0, 0.0)
ARM = 2.0 - 0.5j  # [m] forward + i right


def fix_at(place: complex, time_s: float, sd: float) -> GnssPosition:
    position = geodetic_from_ned_difference((place.real, place.imag, 0.0), PLACE)
    return GnssPosition(round(time_s * 1e9), 0, "", position, np.eye(3) * sd**2, 3, STILL, 0.0)


def found(
    *,
    rest_s: float = 0.0,
    drive_s: float = 5.0,
    speed: float = 0.0,
    acceleration: float = 0.0,
    rate: float = 0.0,
    noise: float = 0.0,
    sd: float = 0.3,
    seed: float = 1,
) -> tuple[tuple[Motion, Heading] | None, Levelling, complex, float]:
    """Match fixes of the last five seconds of a drive after a standstill; give also the true velocity and rotation."""
    rng, levelling = np.random.default_rng(int(seed)), Levelling(Settings())
    place, yaw, points = 0j, YAW, []
    for k in range(1, round((rest_s + drive_s) / STEP_S) + 1):
        moving = k * STEP_S > rest_s
        a, w, v = (acceleration, rate, speed) if moving else (0.0, 0.0, 0.0)
        levelling.use_speed(abs(v))
        levelling.advance((a, v * w, -STANDARD_GRAVITY), (0.0, 0.0, w), STEP_S)
        place += rect(v + 0.5 * a * STEP_S, yaw + 0.5 * w * STEP_S) * STEP_S
        speed, yaw = speed + a * STEP_S, yaw + w * STEP_S
        if k % 100 == 0:
            antenna = place + ARM * rect(1.0, yaw) + noise * complex(*rng.standard_normal(2))
            arm = ARM * rect(1.0, levelling.yaw)
            points.append(
                Point(fix_at(antenna, k * STEP_S, sd), levelling.heading_integral, levelling.displacement, arm)
            )
    result = track(points[-6:], levelling, Settings())
    return result, levelling, rect(speed, yaw), wrap_angle(yaw - levelling.yaw)


@pytest.mark.parametrize("rate", [0.0, 0.3], ids=["straight", "bend"])
def test_without_a_standstill_positions_give_the_course_over_ground(rate: float) -> None:
    result, _, velocity, turn = found(speed=8.0, rate=rate)
    assert result is not None
    motion, heading = result
    assert heading.method is HeadingMethod.COURSE
    # Levelling in motion attributes a part of the centripetal acceleration to tilt.
    assert wrap_angle(heading.turn - turn) == pytest.approx(0.0, abs=radians(0.01 if rate == 0.0 else 2.0))
    assert abs(complex(*motion.velocity[:2]) - velocity) < (1e-3 if rate == 0.0 else 0.3)


@pytest.mark.parametrize("acceleration", [1.5, -1.5], ids=["forwards", "backwards"])
@pytest.mark.parametrize("rate", [0.0, 0.2], ids=["straight", "bend"])
def test_after_a_standstill_positions_are_matched_with_the_integrated_track_forwards_and_backwards(
    acceleration: float, rate: float
) -> None:
    result, _, velocity, turn = found(rest_s=4.0, acceleration=acceleration, rate=rate)
    assert result is not None
    motion, heading = result
    assert heading.method is HeadingMethod.POSITIONS
    assert wrap_angle(heading.turn - turn) == pytest.approx(0.0, abs=2e-3)
    assert abs(complex(*motion.velocity[:2]) - velocity) < 0.02


def test_the_standard_deviation_of_the_matched_heading_is_that_of_its_errors() -> None:
    """Noise of 0.5 m as stated, at 8 m/s; the sideslip that the settings allow for is not simulated."""
    errors, ratios = [], []
    for seed in range(100):
        result, _, _, turn = found(speed=8.0, noise=0.5, sd=0.5, seed=seed)
        assert result is not None
        errors.append(wrap_angle(result[1].turn - turn))
        ratios.append(errors[-1] / sqrt(result[1].sd ** 2 - Settings().alignment.course_yaw_sd_rad ** 2))
    # Large residuals of five positions increase it at times; it is never below that of the stated accuracy.
    assert 0.65 < np.sqrt(np.mean(np.square(ratios))) < 1.1
    # Five positions 8 m apart: the sum of squares about their mean is 10 times 64 m².
    assert np.std(errors) == pytest.approx(0.5 / (8.0 * sqrt(10.0)), rel=0.2)


def test_noise_above_the_stated_accuracy_increases_the_standard_deviation() -> None:
    sds = [result[1].sd for seed in range(20) if (result := found(speed=8.0, noise=1.5, sd=0.1, seed=seed)[0])]
    assert np.median(sds) > Settings().alignment.course_yaw_sd_rad * 1.15


@pytest.mark.parametrize(
    "poor", [{"speed": 1.5}, {"speed": 3.0, "noise": 3.0, "sd": 3.0}, {"speed": 8.0, "drive_s": 1.0}],
    ids=["slow", "noisy", "one fix"],
)  # fmt: skip
def test_a_short_slow_or_noisy_track_gives_no_heading(poor: dict[str, float]) -> None:
    assert found(**poor)[0] is None


def test_scattered_positions_at_standstill_have_zero_velocity() -> None:
    rng = np.random.default_rng(2)
    still = [Point(fix_at(complex(*rng.standard_normal(2)), float(k), 1.0), complex(k), 0j, 0j) for k in range(6)]
    assert moved_m_s(still) == 0.0 and moved_m_s(still[:1]) == 0.0
    assert moved_m_s([still[0], Point(fix_at(50j, 5.0, 1.0), 5.0, 0j, 0j)]) == pytest.approx(10.0, abs=0.5)


def test_a_track_needs_positions_at_two_instants() -> None:
    point = Point(fix_at(0j, 1.0, 0.01), 1.0, 0j, 0j)
    assert track([point, Point(fix_at(30j, 1.0, 0.01), 1.0, 0j, 0j)], Levelling(Settings()), Settings()) is None
