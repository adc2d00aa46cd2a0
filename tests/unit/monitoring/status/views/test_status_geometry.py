from math import atan2, cos, degrees, pi, radians, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.monitoring.status.views.geometry import (
    CHI_SQUARE_95_TWO,
    ellipse_95,
    horizontal_sd,
    offset_m,
    vertical_sd,
)
from tests.support.dashboard.status_world import START_NS, fix, solution


def test_the_ellipse_of_equal_variances_is_a_circle_of_2_4477_sigma() -> None:
    ellipse = ellipse_95((4.0, 0.0, 0.0, 4.0, 0.0, 1.0))
    assert ellipse.semi_major_m == pytest.approx(2 * 2.4477, rel=1e-4)
    assert ellipse.semi_minor_m == pytest.approx(ellipse.semi_major_m)


@given(st.floats(0.1, 50.0), st.floats(0.1, 50.0), st.floats(-1.5, 1.5))
def test_the_axes_are_those_of_an_eigenvalue_decomposition(major: float, minor: float, azimuth: float) -> None:
    turn = np.array([[cos(azimuth), -sin(azimuth)], [sin(azimuth), cos(azimuth)]])
    covariance = turn @ np.diag([major, minor]) @ turn.T
    ellipse = ellipse_95((covariance[0, 0], covariance[0, 1], 0.0, covariance[1, 1], 0.0, 1.0))
    values, vectors = np.linalg.eigh(covariance)
    expected = np.sqrt(CHI_SQUARE_95_TWO * values)
    assert ellipse.semi_major_m == pytest.approx(expected[1], rel=1e-9)
    assert ellipse.semi_minor_m == pytest.approx(expected[0], rel=1e-6, abs=1e-6)
    if values[1] > 1.001 * values[0]:
        north, east = vectors[:, 1]
        difference = (ellipse.orientation_rad - atan2(east, north) + pi / 2) % pi - pi / 2
        assert difference == pytest.approx(0.0, abs=1e-6)


def test_95_of_100_draws_fall_into_the_ellipse() -> None:
    covariance = np.array([[3.0, 1.2], [1.2, 1.0]])
    ellipse = ellipse_95((3.0, 1.2, 0.0, 1.0, 0.0, 1.0))
    draws = np.random.default_rng(7).multivariate_normal([0, 0], covariance, 20_000)
    c, s = cos(ellipse.orientation_rad), sin(ellipse.orientation_rad)
    along, across = draws @ [c, s], draws @ [-s, c]
    inside = (along / ellipse.semi_major_m) ** 2 + (across / ellipse.semi_minor_m) ** 2 <= 1.0
    assert inside.mean() == pytest.approx(0.95, abs=4 * (0.95 * 0.05 / 20_000) ** 0.5)


def test_a_covariance_that_rounding_made_negative_gives_no_width() -> None:
    ellipse = ellipse_95((1.0, 1.0000001, 0.0, 1.0, 0.0, 1.0))
    assert ellipse.semi_minor_m == 0.0


def test_a_diagonal_covariance_with_more_variance_east_points_east() -> None:
    assert degrees(ellipse_95((1.0, 0.0, 0.0, 9.0, 0.0, 1.0)).orientation_rad) == pytest.approx(90.0)


def test_plain_deviations_are_roots_of_the_diagonal() -> None:
    covariance = (9.0, 1.0, 1.0, 16.0, 1.0, 4.0)
    assert horizontal_sd(covariance) == 5.0
    assert vertical_sd(covariance) == 2.0


def test_an_offset_is_in_metres_on_the_ellipsoid() -> None:
    there = solution(START_NS, latitude_deg=48.001, longitude_deg=11.001, velocity_ned_m_s=(0.0, 0.0, 0.0))
    offset = offset_m(there, fix(START_NS, velocity_ned_m_s=(0.0, 0.0, 0.0)))
    assert offset is not None
    # Lengths of 0.001 degree at 48 N: 111.20 m along the meridian, 74.63 m along the parallel (NGA's calculator).
    assert offset[0] == pytest.approx(111.20, abs=0.02)
    assert offset[1] == pytest.approx(radians(0.001) * 6388836.7 * cos(radians(48.0)), abs=0.02)


def test_a_reference_of_another_moment_is_moved_by_its_velocity() -> None:
    later = solution(START_NS + 500_000_000)
    offset = offset_m(later, fix(START_NS))
    assert offset == pytest.approx((-1.5, -2.0))


def test_a_fix_without_a_position_has_no_offset() -> None:
    assert offset_m(solution(START_NS), fix(START_NS, latitude_deg=None)) is None
