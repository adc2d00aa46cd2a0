import math

import numpy as np

from cli.solve.track import NAMES
from tests.support.drives.tracks import START_NS, solution, track


def test_a_solution_is_a_row_with_standard_deviations() -> None:
    (row,) = track([solution(3.0, sd=0.25)]).values
    found = dict(zip(NAMES, row, strict=True))
    assert found["position_sd_east_m"] == 0.25
    assert found["velocity_sd_down_m_s"] == 0.1
    assert found["attitude_sd_north_rad"] == 0.01
    assert math.isclose(found["angular_rate_down_rad_s"], 0.2)
    assert found["stationary"] == 0.0 and found["gnss_age_s"] == 0.2


def test_rows_are_sorted_by_stamp_and_the_last_of_equal_stamps_is_kept() -> None:
    made = track([solution(1.0), solution(3.0), solution(2.0), solution(2.0, error_n=(5.0, 0.0, 0.0))])
    assert made.stamps_ns.tolist() == [START_NS + t * 1_000_000_000 for t in (1, 2, 3)]
    again = track([solution(2.0, error_n=(5.0, 0.0, 0.0))])
    np.testing.assert_array_equal(made.values[1], again.values[0])


def test_valid_keeps_navigating_and_coasting_only() -> None:
    words = ["waiting_for_heading", "navigating", "coasting", "waiting_for_gnss"]
    made = track(solution(float(k), phase=word) for k, word in enumerate(words))
    assert [phase.value for phase in made.valid().phases] == ["navigating", "coasting"]
    assert len(made.valid()) == 2


def test_a_track_without_solutions_is_empty() -> None:
    assert len(track([])) == 0
    assert len(track([]).valid()) == 0
