from math import degrees, pi, radians

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.maths import earth, ellipsoid
from shared.maths.earth import Geodetic

LATITUDES = st.floats(-pi / 2, pi / 2)
LONGITUDES = st.floats(-pi, pi)
HEIGHTS = st.floats(-500.0, 20000.0)


def test_radii_at_the_reference_latitude() -> None:
    meridian, transverse = ellipsoid.curvature_radii(radians(42.37))
    assert meridian == pytest.approx(6364442.31, rel=1e-6)
    assert transverse == pytest.approx(6387855.00, rel=1e-6)


def test_radii_at_the_equator_and_at_the_poles() -> None:
    polar = ellipsoid.SEMI_MAJOR_AXIS**2 / ellipsoid.SEMI_MINOR_AXIS
    assert ellipsoid.curvature_radii(0.0) == pytest.approx((6335439.327, 6378137.0), rel=1e-9)
    for pole in (-pi / 2, pi / 2):
        assert ellipsoid.curvature_radii(pole) == pytest.approx((polar, polar), rel=1e-12)


def test_gravity_at_the_reference_point() -> None:
    assert earth.gravity(radians(42.37), 700.0) == pytest.approx(9.8017, abs=5e-5)


def test_gravity_at_the_equator_and_at_the_poles_is_that_of_wgs84() -> None:
    assert earth.gravity(0.0, 0.0) == pytest.approx(9.7803253359, abs=1e-10)
    assert earth.gravity(pi / 2, 0.0) == pytest.approx(9.8321849378, abs=1e-9)
    assert earth.gravity(-pi / 2, 0.0) == earth.gravity(pi / 2, 0.0)


def test_gravity_decreases_by_the_free_air_gradient() -> None:
    per_metre = (earth.gravity(radians(45.0), 1000.0) - earth.gravity(radians(45.0), 0.0)) / 1000.0
    assert per_metre == pytest.approx(-3.086e-6, rel=2e-3)


def test_earth_rate_points_north_at_the_equator_and_up_at_the_north_pole() -> None:
    assert earth.earth_rate_n(0.0) == pytest.approx((earth.EARTH_RATE, 0.0, 0.0))
    assert earth.earth_rate_n(pi / 2) == pytest.approx((0.0, 0.0, -earth.EARTH_RATE), abs=1e-19)


@given(LATITUDES.filter(lambda x: abs(x) < radians(89.0)), LONGITUDES, HEIGHTS)
def test_transport_rate_is_the_rate_of_the_ned_frame(latitude: float, longitude: float, height: float) -> None:
    velocity = (30.0, -20.0, 3.0)
    step = 1.0
    origin = Geodetic(latitude, longitude, height)
    moved = earth.geodetic_from_ned_difference((30.0 * step, -20.0 * step, 0.0), origin)
    before = earth.ned_from_ecef(latitude, longitude)
    after = earth.ned_from_ecef(moved.latitude, moved.longitude)
    change = after @ before.T  # I - sk(w) dt
    rate = np.array([change[1, 2], change[2, 0], change[0, 1]]) / step
    expected = np.array(earth.transport_rate_n(latitude, height, velocity))
    assert rate == pytest.approx(expected, abs=1e-9, rel=1e-3)


@pytest.mark.parametrize(
    ("geodetic_deg", "ecef_m"),
    [
        ((0.0, 0.0, 0.0), (ellipsoid.SEMI_MAJOR_AXIS, 0.0, 0.0)),
        ((0.0, 90.0, 100.0), (0.0, ellipsoid.SEMI_MAJOR_AXIS + 100.0, 0.0)),
        ((0.0, 180.0, -1.0), (-ellipsoid.SEMI_MAJOR_AXIS + 1.0, 0.0, 0.0)),
        ((90.0, 0.0, 50.0), (0.0, 0.0, ellipsoid.SEMI_MINOR_AXIS + 50.0)),
        ((-90.0, 0.0, 0.0), (0.0, 0.0, -ellipsoid.SEMI_MINOR_AXIS)),
    ],
)
def test_ecef_conversion_on_the_axes(geodetic_deg: tuple[float, ...], ecef_m: tuple[float, float, float]) -> None:
    point = Geodetic(radians(geodetic_deg[0]), radians(geodetic_deg[1]), geodetic_deg[2])
    assert earth.ecef_from_geodetic(point) == pytest.approx(ecef_m, abs=1e-8)
    back = earth.geodetic_from_ecef(ecef_m)
    assert degrees(back.latitude) == pytest.approx(geodetic_deg[0], abs=1e-12)
    assert back.height == pytest.approx(geodetic_deg[2], abs=1e-8)


@given(LATITUDES, LONGITUDES, HEIGHTS)
def test_ecef_conversion_is_invertible(latitude: float, longitude: float, height: float) -> None:
    point = Geodetic(latitude, longitude, height)
    ecef = earth.ecef_from_geodetic(point)
    again = earth.ecef_from_geodetic(earth.geodetic_from_ecef(ecef))
    assert again == pytest.approx(ecef, abs=1e-7)
    assert earth.geodetic_from_ecef(ecef).height == pytest.approx(height, abs=1e-7)


@given(LATITUDES.filter(lambda x: abs(x) < radians(80.0)), LONGITUDES, HEIGHTS)
def test_a_ned_difference_agrees_with_the_tangent_plane(latitude: float, longitude: float, height: float) -> None:
    origin = Geodetic(latitude, longitude, height)
    ned = (60.0, -70.0, 10.0)
    point = earth.geodetic_from_ned_difference(ned, origin)
    flat = earth.ned_track(np.array([point]), origin)[0]
    two_centimetres = 0.02  # the curvature at latitude 80 deg, where meridians converge fast
    assert flat == pytest.approx(np.array(ned), abs=two_centimetres)
    assert earth.ned_from_geodetic_difference(point, origin) == pytest.approx(ned, abs=1e-8)


def test_a_ned_difference_across_the_antimeridian_is_continuous() -> None:
    west = Geodetic(radians(-17.0), radians(179.9999), 0.0)
    east = Geodetic(radians(-17.0), radians(-179.9999), 0.0)
    north, eastward, _ = earth.ned_from_geodetic_difference(east, west)
    assert north == 0.0
    assert eastward == pytest.approx(21.29, abs=0.05)
    back = earth.geodetic_from_ned_difference((0.0, eastward, 0.0), west)
    assert degrees(back.longitude) == pytest.approx(-179.9999, abs=1e-9)


@given(st.floats(-1e4, 1e4))
def test_a_wrapped_angle_has_the_same_direction(angle: float) -> None:
    wrapped = earth.wrap_angle(angle)
    assert -pi < wrapped <= pi
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angle), abs=1e-9)
