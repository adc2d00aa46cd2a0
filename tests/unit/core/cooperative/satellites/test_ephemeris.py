"""Orbits and clocks from broadcast elements: derivatives, the two-body problem, limits of age."""

from dataclasses import replace
from math import cos, pi, sin

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from services.core.cooperative.broadcast.ephemeris import (
    MU,
    Ephemeris,
    eccentric_anomaly,
    satellite_state,
)
from services.core.cooperative.broadcast.store import EphemerisStore
from services.core.cooperative.measurements import WEEK_NS, Constellation, SatelliteId
from shared.maths.gnss_signals import EARTH_RATE
from tests.support.cases import each
from tests.support.gnss.constellation import NOW_NS, TOE_NS, constellation, ephemeris

GPS, GALILEO = SatelliteId(Constellation.GPS, 5), SatelliteId(Constellation.GALILEO, 11)
DAY_NS = 86_400 * 1_000_000_000


@pytest.mark.parametrize("eccentricity", [0.0, 0.01, 0.2, 0.7, 0.95])
def test_the_eccentric_anomaly_solves_keplers_equation(eccentricity: float) -> None:
    for mean in np.linspace(-3.1, 3.1, 23):
        E = eccentric_anomaly(float(mean), eccentricity)
        assert E - eccentricity * sin(E) == pytest.approx(mean, abs=1e-13)


def test_an_eccentricity_that_is_no_ellipses_is_an_error() -> None:
    with pytest.raises(ValueError, match="eccentricity"):
        eccentric_anomaly(1.0, 1.0)


@each("one", constellation()[::5])
def test_the_velocity_and_the_clock_drift_are_the_derivatives_of_position_and_clock(one: Ephemeris) -> None:
    before, after = (satellite_state(one, NOW_NS, delay) for delay in (0.5, -0.5))
    state = satellite_state(one, NOW_NS)
    difference = np.array(after.position_e) - np.array(before.position_e)
    assert np.abs(difference - state.velocity_e).max() < 1e-5, "[m/s]; an acceleration that changes gives 1e-6"
    assert after.clock_s - before.clock_s == pytest.approx(state.clock_drift, abs=1e-17 + 1e-6 * abs(state.clock_drift))


@pytest.mark.parametrize("satellite", [GPS, GALILEO])
def test_without_corrections_an_orbit_is_that_of_two_bodies(satellite: SatelliteId) -> None:
    """The oracle integrates gravity in inertial axes; only the Earth's turn is applied by hand."""
    one = replace(
        ephemeris(satellite, 1.0, 0.5), mean_motion_difference=0.0, node_rate=0.0, inclination_rate=0.0,
        cuc=0.0, cus=0.0, crc=0.0, crs=0.0, cic=0.0, cis=0.0, eccentricity=0.02,
    )  # fmt: skip
    mu = MU[satellite.constellation]

    def inertial(seconds: float) -> tuple[np.ndarray, np.ndarray]:
        state = satellite_state(one, TOE_NS, -seconds)
        turn = EARTH_RATE * seconds
        R = np.array([[cos(turn), -sin(turn), 0.0], [sin(turn), cos(turn), 0.0], [0.0, 0.0, 1.0]])
        position = R @ np.array(state.position_e)
        return position, R @ np.array(state.velocity_e) + np.cross([0.0, 0.0, EARTH_RATE], position)

    start = np.concatenate(inertial(0.0))
    path = solve_ivp(
        lambda _, y: np.concatenate([y[3:], -mu * y[:3] / np.linalg.norm(y[:3]) ** 3]),
        (0.0, 7200.0), start, rtol=1e-12, atol=1e-6,
    )  # fmt: skip
    position, velocity = inertial(7200.0)
    assert np.abs(position - path.y[:3, -1]).max() < 0.01
    assert np.abs(velocity - path.y[3:, -1]).max() < 1e-5


def test_the_relativistic_correction_is_largest_a_quarter_of_an_orbit_from_perigee() -> None:
    one = replace(ephemeris(GPS, 0.0, pi / 2), eccentricity=0.02, clock=(0.0, 0.0, 0.0), group_delay_s=0.0)
    expected = -4.442807633e-10 * 0.02 * one.sqrt_a  # F of IS-GPS-200, 20.3.3.3.3.1
    assert satellite_state(one, TOE_NS).clock_s == pytest.approx(expected, rel=1e-3)


def test_the_group_delay_makes_the_clock_of_a_single_frequency_user_late() -> None:
    one = ephemeris(GPS, 0.0, 0.0)
    without = replace(one, group_delay_s=0.0)
    assert satellite_state(one, NOW_NS).clock_s - satellite_state(without, NOW_NS).clock_s == pytest.approx(8e-9)


def test_an_orbit_goes_on_right_across_the_end_of_the_week() -> None:
    one = replace(ephemeris(GPS, 1.0, 2.0), toe_ns=2301 * WEEK_NS, toc_ns=2301 * WEEK_NS)
    end = 2301 * WEEK_NS
    before, after = satellite_state(one, end - 1_000_000), satellite_state(one, end + 1_000_000)
    step = np.array(after.position_e) - np.array(before.position_e)
    assert np.linalg.norm(step - 0.002 * np.array(before.velocity_e)) < 1e-4


def test_ephemerides_are_selected_by_age_and_old_ones_are_refused_with_a_reason() -> None:
    store = EphemerisStore()
    assert store.select(GPS, NOW_NS) == "no_ephemeris"
    first, second = ephemeris(GPS, 1.0, 0.0), replace(ephemeris(GPS, 1.0, 0.0), toe_ns=TOE_NS + 7200 * 10**9, issue=58)
    store.add(first)
    store.add(second)
    assert store.select(GPS, TOE_NS + 3000 * 10**9) == first
    assert store.select(GPS, TOE_NS + 4000 * 10**9) == second
    assert store.select(GPS, TOE_NS + 2 * DAY_NS) == "old_ephemeris"
    store.add(replace(second, healthy=False))
    assert store.select(GPS, TOE_NS + 7200 * 10**9) == "unhealthy_satellite"


@pytest.mark.parametrize("change", [{"sqrt_a": 0.0}, {"eccentricity": 0.9}, {"clock": (0.3, 0.0, 0.0)}])
def test_impossible_orbits_are_counted_and_not_kept(change: dict[str, float]) -> None:
    store = EphemerisStore()
    assert store.add(replace(ephemeris(GPS, 1.0, 0.0), **change)) is None  # type: ignore[arg-type]
    assert store.rejected == {"implausible_ephemeris": 1} and store.select(GPS, NOW_NS) == "no_ephemeris"


def test_a_store_keeps_a_few_ephemerides_of_each_satellite() -> None:
    store = EphemerisStore(kept=2)
    for k in range(50):
        store.add(replace(ephemeris(GPS, 1.0, 0.0), toe_ns=TOE_NS + k * 7200 * 10**9))
    assert store.select(GPS, TOE_NS) == "old_ephemeris"
    assert len(store._ephemerides[GPS]) == 2
