"""What a track learns from the innovations of its vehicle."""

from dataclasses import replace

import numpy as np
import pytest

from services.core.toll.settings import Settings
from services.core.toll.tracks import MOST_INFLATION, TrackTable
from tests.support.v2x.toll import Vehicle, example_plaza

PLAZA = example_plaza()
CAR = Vehicle(7, "n2", stated_sd=0.3)


def learned(sd_m: float, seed: int = 3) -> tuple[float, float]:
    """The factor after 10 s of positions that err by white noise, and the standard deviation of the track."""
    table, rng = TrackTable(Settings(), PLAZA), np.random.default_rng(seed)
    for k in range(100):
        north, east = (sd_m * rng.standard_normal(2)).tolist()
        list(table.use([replace(CAR, error=(north, east)).cam(PLAZA, 0.1 * k)]))
    (track,) = table.tracks
    return track.inflation, float(np.sqrt(table.estimates([track]).cov[0, 0, 0]))


@pytest.mark.parametrize("seed", range(4))
def test_a_vehicle_that_errs_as_it_states_keeps_its_accuracy(seed: int) -> None:
    assert learned(0.3, seed)[0] == pytest.approx(1.0, abs=0.1)


def test_a_vehicle_that_errs_by_more_than_it_states_is_believed_less_and_one_that_errs_by_less_not_more() -> None:
    honest, bold, modest = learned(0.3), learned(1.2), learned(0.05)
    assert 2.0 < bold[0] <= MOST_INFLATION and bold[1] > 1.5 * honest[1]
    assert modest[0] == 1.0


def test_the_factor_is_bounded_whatever_a_station_sends() -> None:
    assert learned(2.5)[0] <= MOST_INFLATION
