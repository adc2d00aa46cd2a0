"""Reference numbers of the paper's method, class E: closed forms and deterministic inputs."""

from math import atan, degrees, pi, radians, sin, tan

import numpy as np
import pytest

from cli.papers.spoofing.campaign import alarms
from cli.papers.spoofing.method import high_pass
from services.core.spoofing.inertial.compass import (
    barometric_height,
    barometric_pressure,
    device_from_enu,
    magnetic_heading,
    roll_pitch,
)
from services.core.spoofing.windows.metrics import Metric
from shared.maths.earth import wrap_angle
from shared.maths.rotation import ned_from_body

DIP = radians(66.0)
G = 9.81


@pytest.mark.parametrize(("pressure_hpa", "height_m"), [(1013.25, 0.0), (900.0, 988.501), (850.0, 1457.300)])
def test_height_of_pressure(pressure_hpa: float, height_m: float) -> None:
    assert barometric_height(pressure_hpa * 100.0) == pytest.approx(height_m, abs=5e-4)


def test_pressure_of_height_is_the_inverse() -> None:
    assert barometric_pressure(1000.0) == pytest.approx(89_874.57, abs=5e-3)
    assert barometric_height(barometric_pressure(1234.5)) == pytest.approx(1234.5, rel=1e-9)


def test_slope_of_the_height_at_840_hpa() -> None:
    slope = (barometric_height(84_001.0) - barometric_height(83_999.0)) / 0.02
    assert slope == pytest.approx(-9.689, abs=5e-4), "m/hPa"


def test_the_compass_recovers_roll_pitch_and_yaw() -> None:
    rng = np.random.default_rng(1)
    for roll, pitch, yaw, dip in rng.uniform([-pi, -1.4, -pi, -1.4], [pi, 1.4, pi, 1.4], (500, 4)):
        b_from_n = ned_from_body(roll, pitch, yaw).T
        gravity = tuple((b_from_n @ [0.0, 0.0, G]).tolist())
        field = tuple((b_from_n @ [np.cos(dip), 0.0, np.sin(dip)]).tolist())
        found_roll, found_pitch = roll_pitch(gravity)
        assert wrap_angle(found_roll - roll) == pytest.approx(0.0, abs=1e-6)
        assert found_pitch == pytest.approx(pitch, abs=1e-6)
        assert wrap_angle(magnetic_heading(gravity, field) - yaw) == pytest.approx(0.0, abs=1e-6)


def test_the_pitch_as_printed_reads_12_96_degrees_where_there_are_10() -> None:
    b_from_n = ned_from_body(radians(20.0), radians(10.0), 0.0).T
    gx, gy, gz = (b_from_n @ [0.0, 0.0, G]).tolist()
    roll, pitch = roll_pitch((gx, gy, gz))
    assert degrees(pitch) == pytest.approx(10.0, abs=1e-9)
    assert degrees(atan(-gx / (-gy * sin(roll) + gz * np.cos(roll)))) == pytest.approx(12.96, abs=5e-3)


def test_vectors_give_the_axes_of_a_phone_in_any_attitude() -> None:
    rng = np.random.default_rng(2)
    enu_from_device = ned_from_body(*rng.uniform(-1.0, 1.0, 3))
    force = enu_from_device.T @ [0.0, 0.0, G]
    field = enu_from_device.T @ [0.0, np.cos(DIP), -np.sin(DIP)]
    found = device_from_enu(force[None], field[None])[0]
    np.testing.assert_allclose(found, enu_from_device.T, atol=1e-12)


@pytest.mark.parametrize(("acceleration", "error_deg"), [(0.5, 6.5), (1.0, 12.8), (2.0, 24.2)])
def test_acceleration_across_the_field_turns_the_compass(acceleration: float, error_deg: float) -> None:
    apparent_gravity = (0.0, -acceleration, G)  # the vehicle heads north and accelerates to the right
    heading = magnetic_heading(apparent_gravity, (np.cos(DIP), 0.0, np.sin(DIP)))
    assert abs(degrees(heading)) == pytest.approx(error_deg, abs=0.1)
    assert abs(heading) == pytest.approx(atan(sin(atan(acceleration / G)) * tan(DIP)), rel=1e-9)


@pytest.mark.parametrize(
    ("rate_hz", "b0", "a1", "a2"),
    [(10.0, 0.948080785, -1.893464146, 0.898858994), (100.0, 0.994682727, -1.989337181, 0.989393728)],
)
def test_coefficients_of_the_high_pass(rate_hz: float, b0: float, a1: float, a2: float) -> None:
    impulse = np.r_[0.0, 1.0, np.zeros(3)]  # the first sample sets the steady state
    response = high_pass(impulse, rate_hz)
    second = -2.0 * b0 - a1 * b0
    third = b0 - a1 * second - a2 * b0
    np.testing.assert_allclose(response[1:5], [b0, second, third, -a1 * third - a2 * second], atol=1e-8)


@pytest.mark.parametrize(
    ("frequency_hz", "gain"), [(0.01, 0.0069), (0.03, 0.0624), (0.06, 0.2425), (0.12, 0.7071), (0.24, 0.9701)]
)
def test_gain_of_the_high_pass(frequency_hz: float, gain: float) -> None:
    rate_hz = 20.0
    times = np.arange(0.0, 400.0, 1.0 / rate_hz)
    settled = times >= 200.0  # two whole periods of the slowest
    phase = 2.0 * pi * frequency_hz * times
    response = high_pass(np.sin(phase), rate_hz)[settled]
    found = 2.0 * np.hypot((response * np.sin(phase[settled])).mean(), (response * np.cos(phase[settled])).mean())
    assert found == pytest.approx(gain, abs=3e-4), "to that of another sampling rate"


def test_step_response_of_the_high_pass() -> None:
    rate_hz = 2000.0
    step = np.r_[0.0, np.ones(round(5.0 * rate_hz))]
    response = high_pass(step, rate_hz)[1:]
    times = (np.arange(len(response)) + 0.5) / rate_hz
    assert times[np.argmax(response < 0.0)] == pytest.approx(1.473, abs=1e-3)
    assert response.min() == pytest.approx(-0.2079, abs=1e-4)
    assert times[np.argmin(response)] == pytest.approx(2.946, abs=2e-3)
    for duration_s, mean in ((5.0, 0.0120), (1.0, 0.559), (2.0, 0.283)):
        assert response[: round(duration_s * rate_hz)].mean() == pytest.approx(mean, abs=5e-4)


def test_gravity_is_no_transient_of_the_high_pass() -> None:
    assert np.abs(high_pass(np.full((1000, 3), G), 100.0)).max() < 1e-9


def test_three_sigma_is_exceeded_in_0_27_percent_of_a_normal_distribution() -> None:
    """Windows of the campaign: an alarm needs two successive epochs, which independent ones have by the square."""
    rng = np.random.default_rng(8)
    count = 1_000_000
    values = {metric: np.abs(rng.standard_normal(count)) for metric in Metric}
    for k, share in ((3.0, 0.0026998), (2.0, 0.0455003)):
        (first,) = [alarms(values, k, used=(metric,)).mean() for metric in list(Metric)[:1]]
        assert first == pytest.approx(share**2, abs=4.0 * share / count**0.5)
        assert (values[Metric.HEADING_RATE] > k).mean() == pytest.approx(share, abs=4.0 * (share / count) ** 0.5)
    share = 0.0455003**2
    assert alarms(values, 2.0).mean() == pytest.approx(1.0 - (1.0 - share) ** 6, abs=4.0 * (6.0 * share / count) ** 0.5)
