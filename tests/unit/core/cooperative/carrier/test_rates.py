"""Velocity by carrier phases at 1, 5 and 10 epochs a second, through bends and a braking to rest."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from services.core.cooperative.carrier.displacement import carrier_displacement
from services.core.cooperative.measurements import RawEpoch
from services.core.cooperative.satellites.model import WAVELENGTH
from tests.support.cases import each
from tests.unit.core.cooperative.carrier.test_displacement import HERE, STORE, TO_NED, epoch_at

FloatArray = npt.NDArray[np.float64]

STEP_S = 0.01
THERMAL_M, MULTIPATH_M, MULTIPATH_S = 0.0007, 0.003, 5.0  # loop of 15 Hz at 44 dBHz; a moving antenna's surroundings


def path() -> tuple[FloatArray, FloatArray]:
    """Places [m, NED] and velocities [m/s, NED] each 10 ms: bends at 14 m/s, and braking at 4 m/s² to rest."""
    t = np.arange(0.0, 12.0, STEP_S)
    braking = 4.0 * np.clip(t - 7.0, 0.0, 1.0) * np.clip(11.5 - t, 0.0, 1.0)  # jerk of 4 m/s³ at both ends
    speed = 14.0 - np.cumsum(braking) * STEP_S
    course = 0.3 * np.sin(2.0 * np.pi * t / 6.0)  # 4.4 m/s² sideways
    velocity = np.stack([speed * np.cos(course), speed * np.sin(course), 0.02 * speed], axis=1)
    places = np.vstack([np.zeros(3), np.cumsum(0.5 * STEP_S * (velocity[1:] + velocity[:-1]), axis=0)])
    return places, velocity


def disturbed(epochs: list[RawEpoch], interval_s: float, rng: np.random.Generator) -> list[RawEpoch]:
    """With noise of phases that the tests draw themselves: white of each epoch, and a Gauss-Markov process."""
    left = np.exp(-interval_s / MULTIPATH_S)
    slow = MULTIPATH_M * rng.standard_normal(len(epochs[0].measurements))
    found = []
    for epoch in epochs:
        slow = left * slow + MULTIPATH_M * np.sqrt(1.0 - left**2) * rng.standard_normal(len(slow))
        off = (slow + THERMAL_M * rng.standard_normal(len(slow))) / WAVELENGTH
        measured = []
        for one, cycles in zip(epoch.measurements, off.tolist(), strict=True):
            assert one.carrier_cycles is not None
            measured.append(replace(one, carrier_cycles=one.carrier_cycles + cycles))
        found.append(replace(epoch, measurements=tuple(measured)))
    return found


@each(("rate_hz", "limit_m_s"), [(1, 0.03), (5, 0.03), (10, 0.045)])
def test_bends_and_braking_are_followed_without_a_lag(rate_hz: int, limit_m_s: float) -> None:
    places, velocity = path()
    stride = round(1.0 / rate_hz / STEP_S)
    clean = [
        epoch_at(places[k], k * STEP_S, velocity_n=velocity[k], clock_m=45.0 + 0.3 * k * STEP_S)
        for k in range(0, len(places), stride)
    ]
    epochs = disturbed(clean, 1.0 / rate_hz, np.random.default_rng(rate_hz))
    errors, accelerations = [], []
    for i in range(1, len(epochs)):
        here, before = places[i * stride], places[(i - 1) * stride]
        found = carrier_displacement(epochs[i - 1], epochs[i], STORE, HERE + TO_NED.T @ before)
        assert found is not None and found.checked and not found.slipped
        errors.append((found.displacement_n - (here - before)) * rate_hz)
        accelerations.append((velocity[i * stride] - velocity[(i - 1) * stride]) * rate_hz)
    e, a = np.array(errors), np.array(accelerations)
    assert np.abs(a).max() > 3.5
    assert np.quantile(np.linalg.norm(e, axis=1), 0.95) < limit_m_s
    assert abs(np.sum(e * a) / np.sum(a * a)) < 0.005, "[s] lag of the velocity"
