"""Ionosphere and troposphere against published values."""

from math import pi, radians

import pytest

from shared.maths.earth import Geodetic
from shared.maths.gnss_signals import (
    SPEED_OF_LIGHT,
    Klobuchar,
    klobuchar_delay_m,
    saastamoinen_zenith_m,
    troposphere_mapping,
)
from tests.support.cases import each

COEFFICIENTS = Klobuchar((0.2e-7, -0.8e-8, -0.5e-7, 0.1e-6), (0.2e6, 0.2e6, -0.1e6, -0.1e7))


@each(
    ("place", "azimuth", "elevation", "hour", "delay"),
    [(( 35, 140), 60, 75, 1, 6.73590532099438), ((-80, -170), 60, 75, 1, 3.56895382197387),
     ((10, 30), 60, 75, 1, 3.80716435655161), ((35, 140), 60, 75, 13, 5.21796954585452),
     ((35, 140), 60, 75, 22, 5.90190539264777), ((35, 140), 190, 3, 1, 21.6345415123632),
     ((35, 140), 350, 60, 1, 7.33844278822561), ((35, 140), 0, 90, 1, 6.58339711400694)],
)  # fmt: skip
def test_the_ionosphere_is_that_of_rtklibs_unit_test(
    place: tuple[float, float], azimuth: float, elevation: float, hour: int, delay: float
) -> None:
    at = Geodetic(radians(place[0]), radians(place[1]), 100.0)
    found = klobuchar_delay_m(
        COEFFICIENTS, at, elevation=radians(elevation), azimuth=radians(azimuth), second_of_day=3600.0 * hour
    )
    assert found == pytest.approx(delay, abs=1e-6)


def test_without_coefficients_the_night_delay_remains() -> None:
    found = klobuchar_delay_m(None, Geodetic(0.5, 0.1, 0.0), elevation=pi / 2, azimuth=0.0, second_of_day=50_000.0)
    assert found == pytest.approx(5e-9 * SPEED_OF_LIGHT, rel=0.01)


def test_the_troposphere_at_sea_level_is_that_of_the_literature_and_thins_with_height() -> None:
    """2.3 m dry (Davis et al. 1985: 0.0022768 m/hPa) and 0.1 to 0.2 m wet."""
    assert saastamoinen_zenith_m(radians(45.0), 0.0) == pytest.approx(0.0022768 * 1013.25 + 0.12, abs=0.05)
    heights = [saastamoinen_zenith_m(radians(45.0), height) for height in (0.0, 1000.0, 3000.0, 8000.0, 1e6)]
    assert heights == sorted(heights, reverse=True) and heights[-1] > 0.0


def test_the_mapping_is_one_at_the_zenith_and_ten_near_the_horizon() -> None:
    assert troposphere_mapping(pi / 2) == pytest.approx(1.0, abs=1e-5)
    assert troposphere_mapping(radians(30.0)) == pytest.approx(2.0, rel=0.01)
    assert troposphere_mapping(radians(5.0)) == pytest.approx(10.15, rel=0.02)
