"""Neighbours that publish no offset of their oscillators: learned by the frequency of their messages, and used."""

from dataclasses import replace

import numpy as np
import pytest

from services.core.cooperative.measurements import SatelliteVerdict
from services.core.cooperative.v2x.monitor import CooperativeMonitor, CooperativeSettings
from services.core.cooperative.v2x.neighbours import NeighbourReport
from services.core.cooperative.v2x.oscillators import LEARNED_S, MAX_SENDERS, WALK_M_S, SenderOscillators
from shared.maths.frequency_offset import CARRIER_FREQUENCY, cfo_from_range_rate
from shared.maths.gnss_signals import SPEED_OF_LIGHT
from shared.messages.trust import Outcome
from tests.support.gnss.constellation import pushed
from tests.unit.core.cooperative.test_cooperative_monitor import ROAD_E, STORE, epoch, neighbours, start

S = 1_000_000_000
PPM = 1e-6


def test_20_ppm_are_118_khz_and_a_metre_a_second_is_20_hz() -> None:
    assert cfo_from_range_rate(0.0, 20.0 * PPM, 0.0) == pytest.approx(118_000.0, rel=1e-3)
    assert cfo_from_range_rate(-1.0, 0.0, 0.0) == pytest.approx(19.7, abs=0.05)


def test_the_offset_is_the_mean_of_a_walk_with_its_variance() -> None:
    rng, squares = np.random.default_rng(1), []
    for _ in range(200):
        learned, true = SenderOscillators(), 6000.0 * rng.standard_normal()
        for k in range(20):
            true += WALK_M_S * rng.standard_normal()
            if (known := learned.known("a", k * S)) is not None:
                assert k >= LEARNED_S
                squares.append((known.value - true) ** 2 / known.variance)
            learned.learn("a", k * S, true + 1.0 * rng.standard_normal(), 1.0, 0.2)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.2)


def test_another_radio_is_learned_from_its_beginning_and_a_silent_one_forgotten() -> None:
    learned = SenderOscillators()
    for k in range(15):
        learned.learn("a", k * S, 100.0, 1.0, 0.2)
    assert learned.known("a", 15 * S) is not None
    learned.learn("a", 15 * S, -4000.0, 1.0, 0.2)
    assert learned.known("a", 16 * S) is None
    for k in range(16, 40):
        learned.learn("a", k * S, -4000.0, 1.0, 0.2)
    assert learned.known("a", 100 * S) is None
    for number in range(2 * MAX_SENDERS):
        learned.learn(f"{number}", 40 * S, 0.0, 1.0, 0.2)
    assert len(learned._senders) == MAX_SENDERS


def unpublished(k: int, rng: np.random.Generator) -> tuple[NeighbourReport, ...]:
    """Neighbours with oscillators of up to 20 ppm, of which they say nothing."""
    found = []
    for report, ppm in zip(neighbours(k, rng), (17.0, -19.0, 6.0), strict=True):
        assert report.cfo_hz is not None
        found.append(replace(report, cfo_hz=report.cfo_hz + ppm * PPM * CARRIER_FREQUENCY, oscillator_offset=None))
    return tuple(found)


def driven(seconds: int, *, learn: bool) -> list[SatelliteVerdict]:
    rng, monitor = np.random.default_rng(2), CooperativeMonitor(CooperativeSettings(learn_oscillators=learn))
    return [
        monitor.evaluate(epoch(k, rng), STORE, unpublished(k, rng), road_e=ROAD_E, start=start() if k == 0 else None)
        for k in range(seconds)
    ]


def test_neighbours_without_an_offset_are_used_once_theirs_is_learned() -> None:
    without, learned = driven(40, learn=False), driven(40, learn=True)
    assert all(verdict.rejected.get("neighbour_without_oscillator_offset") == 3 for verdict in without[1:])
    assert not any(verdict.neighbours for verdict in without)
    assert all(verdict.rejected.get("neighbour_without_oscillator_offset") == 3 for verdict in learned[1:9])
    assert all(len(verdict.neighbours) == 3 and not verdict.rejected for verdict in learned[15:])
    assert {verdict.outcome for verdict in learned} == {Outcome.PASS}


def test_the_noise_of_a_frame_is_at_the_lower_end_of_the_papers() -> None:
    """The paper's deviations of a range-rate are 6.5 m/s and less, down to a fifth of it; 20 Hz are 1 m/s."""
    innovations = [one.innovation_m_s for verdict in driven(60, learn=True)[20:] for one in verdict.neighbours]
    assert len(innovations) == 120 and not any(one.excluded for one in driven(60, learn=True)[-1].neighbours)
    assert 0.7 * 20.0 * SPEED_OF_LIGHT / CARRIER_FREQUENCY < np.std(innovations) < 2.5


def test_a_step_of_a_satellite_is_found_with_learned_oscillators() -> None:
    rng, monitor = np.random.default_rng(4), CooperativeMonitor(CooperativeSettings(learn_oscillators=True))
    satellite = epoch(0).measurements[2].satellite
    excluded = []
    for k in range(40):
        one = pushed(epoch(k, rng), satellite, 100.0 if k >= 25 else 0.0)
        verdict = monitor.evaluate(one, STORE, unpublished(k, rng), road_e=ROAD_E, start=start() if k == 0 else None)
        excluded.append(satellite in verdict.excluded)
    assert not any(excluded[:25]) and all(excluded[30:])
