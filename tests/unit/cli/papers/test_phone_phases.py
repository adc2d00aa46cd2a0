"""The paper's own input: velocities by carrier phases, of simulated drives and of recorded phones at rest."""

from dataclasses import replace

import numpy as np
import pytest

from cli.papers.spoofing.campaign import Mode, learn, measure
from cli.papers.spoofing.phone import CARRIER_NOISE_M_S, DURATION_S, carrier_velocity
from cli.papers.spoofing.phone_phases import PHONES, PUBLISHED_M_S, RECORDING, phone_velocities, read
from services.core.spoofing.windows.metrics import Metric
from services.sensors.simulator.drive import simulate
from tests.support.data import recording


def test_the_noise_of_a_displacement_at_rest_is_that_of_the_paper() -> None:
    drive = simulate("urban", 1, float(DURATION_S))
    at_rest = replace(drive, velocity_n=np.zeros_like(drive.velocity_n))
    means = carrier_velocity(at_rest, np.random.default_rng(1))
    # The mean of two successive displacements has the noise of its outer epochs, half as large.
    assert np.sqrt(np.mean(np.sum(means**2, axis=1))) == pytest.approx(0.5 * CARRIER_NOISE_M_S, rel=0.05)


def test_a_velocity_by_carrier_is_that_of_its_second() -> None:
    drive = simulate("urban", 1, float(DURATION_S))
    velocity = carrier_velocity(drive, np.random.default_rng(1))
    true = np.vstack([np.zeros(3), drive.velocity_n[99::100][:-1]])
    assert np.sqrt(np.mean((velocity - true) ** 2)) < 0.15, "smoothed by a second at both sides"


def test_up_has_the_threshold_that_gains_most_by_carrier() -> None:
    drives = [measure(1)]
    receiver, carrier = (learn(given, Mode.PAPER_RAW) for given in (drives, [one.by_carrier for one in drives]))
    up, east = Metric.ACCELERATION_UP, Metric.ACCELERATION_EAST
    assert carrier[up][0] < 0.6 * receiver[up][0], "0.08 m/s of the receiver's noise"
    assert carrier[east][0] > 0.8 * receiver[east][0], "the vehicle's own acceleration, as of the paper's mode"


def test_recorded_phones_at_rest_have_centimetres_a_second() -> None:
    folder = recording(RECORDING)
    found = phone_velocities(folder)
    assert set(found) == set(PHONES) and all(one.intervals >= 4 for one in found.values())
    for one in found.values():
        assert PUBLISHED_M_S < one.carrier_m_s < 0.03 < one.doppler_m_s
    assert all(len(satellites) >= 8 for file in PHONES.values() for satellites in read(folder / file).values())
