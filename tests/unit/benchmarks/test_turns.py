"""The simulation of `make turns`: a turn is found sooner the faster it is, none is found without one."""

from math import radians

import pytest

from benchmarks.turns import DRIVES, WITHIN_S, found_s, jobs_of, prepared, table
from services.core.spoofing.grade import Grade

DRIVE = next(iter(DRIVES.values()))
# [deg/s] The bias of a low-cost gyroscope in motion may be another one than at standstill by 0.09 deg/s.
FOUND = {grade: (2.0, 0.8) if grade is Grade.CONSUMER else (1.0, 0.3) for grade in Grade}


@pytest.mark.parametrize("grade", list(Grade))
def test_a_turn_is_found_sooner_the_faster_it_is_and_nothing_is_found_without_one(grade: Grade) -> None:
    vehicle, monitor = prepared(grade, DRIVE, 1)
    assert found_s(vehicle, monitor, DRIVE, 0.0, 60) is None
    fast, slow = (found_s(vehicle, monitor, DRIVE, radians(rate), 60) for rate in FOUND[grade])
    assert fast is not None and slow is not None and fast <= slow


def test_every_cell_of_the_table_has_runs() -> None:
    names = {job.name for job in jobs_of(1, WITHIN_S)}
    assert len(names) == len(DRIVES) * len(Grade) * len(WITHIN_S)
    assert all("-" not in row[2:] for row in table(dict.fromkeys(names, 0.1), WITHIN_S).rows)
