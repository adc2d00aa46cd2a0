"""Random faults: the same seed gives the same drive, every kind is drawn, and rows count drives."""

import pytest

from benchmarks.integrity.faults import DURATION_S, KINDS, Faulty, faults_of, page, rows_of


def test_faults_repeat_with_their_seed_end_in_time_and_cover_every_kind() -> None:
    drawn = [faults_of(seed) for seed in range(80)]
    assert drawn[:3] == [faults_of(seed) for seed in range(3)]
    assert {kind for kind, _ in drawn} == set(KINDS)
    assert all(len(faults) == (2 if kind == "two" else 1) for kind, faults in drawn)
    assert all(fault.start_s < DURATION_S and fault.duration_s for _, faults in drawn for fault in faults)


def test_a_drive_counts_once_and_the_product_with_the_prior_has_its_upper_end() -> None:
    drives = [Faulty("imu", "x", "urban", k, 3.0 if k == 0 else 0.0, 0.0, 1.4 if k == 0 else 0.5) for k in range(25)]
    (row,) = rows_of(drives)
    assert (row.drives, row.above, row.safe_above) == (25, 1, 0)
    assert row.interval[1] == pytest.approx(0.2035, abs=1e-3), "Clopper-Pearson, 95 %, 1 of 25"
    assert row.product == pytest.approx(row.prior / 25) and row.at_most == pytest.approx(row.prior * row.interval[1])
    assert any("| urban, 0 | x | 3.0 | 0.0 | 1.40 |" in line for line in page(drives, "today"))
