"""Samples combined to increments have the effect of the samples."""

from itertools import pairwise
from math import inf

import numpy as np
import numpy.typing as npt
import pytest

from services.core.fusion.inertial.imu_faults import Sample
from services.core.fusion.inertial.increments import RawSamples, combined, group_starts
from services.core.fusion.inertial.propagation import ImuErrors, Intervals, State, initial_state, propagate
from services.core.fusion.inertial.standstill import CERTAIN_LIMITS
from services.core.fusion.timeline.log import Log
from services.sensors.simulator.drive import simulate
from shared.inertial.strapdown import InertialState
from shared.maths.earth import Geodetic
from shared.maths.rotation import ned_from_body, quaternion_from_matrix

FloatArray = npt.NDArray[np.float64]
ERRORS = ImuErrors((0.02, -0.03, 0.01), (2e-3, -1e-3, 3e-3))


def integrated(start: State, times_ns: npt.NDArray[np.int64], rows: FloatArray, errors: ImuErrors) -> State:
    made, taken, _ = propagate(
        start, times_ns.tolist(), rows.tolist(), 0, len(times_ns), errors, CERTAIN_LIMITS, Intervals(inf, gap_s=inf)
    )
    assert taken == len(times_ns)
    return made


def turned(one: State, other: State) -> float:
    """Angle between two attitudes [rad]."""
    return 2.0 * float(np.linalg.norm(np.subtract(one.quaternion, other.quaternion)))


def both(times_ns: npt.NDArray[np.int64], rows: FloatArray, start: State, errors: ImuErrors) -> tuple[State, State]:
    """States after all samples, by samples and by increments."""
    _, starts = group_starts(times_ns, np.array([start.time_ns]), np.empty(0, np.int64))
    made = combined(RawSamples(times_ns, rows, start.time_ns, rows[0]), starts)
    ends = np.append(starts[1:], len(times_ns)) - 1
    return integrated(start, times_ns, rows, errors), integrated(start, times_ns[ends], made, errors)


def test_a_minute_of_driving_gives_the_same_solution() -> None:
    """A free run of a minute is known to metres: a thousandth of that, and of the speed and the angles it reaches."""
    d = simulate("urban", 1, 70.0)
    k = int(np.searchsorted(d.t_ns, 8 * 10**9))
    quaternion = quaternion_from_matrix(ned_from_body(*d.attitude[k].tolist()))
    velocity = tuple(d.velocity_n[k].tolist())
    rows = np.hstack([d.force_b, d.rate_b])
    inertial = InertialState(int(d.t_ns[k]), quaternion, velocity, Geodetic(*d.position[k].tolist()))
    start = initial_state(inertial, (0.0,) * 3, (0.0,) * 3)
    raw, by_increments = both(d.t_ns[k + 1 :], rows[k + 1 :], start, ERRORS)
    apart = np.subtract(raw.position, by_increments.position) * (6.4e6, 4.5e6, 1.0)
    assert np.abs(apart).max() < 0.02
    assert np.abs(np.subtract(raw.velocity, by_increments.velocity)).max() < 1e-3
    assert turned(raw, by_increments) < 1e-5
    assert by_increments.rate_b == pytest.approx(raw.rate_b), "that of the last sample"
    assert by_increments.force_vibration_psd == pytest.approx(raw.force_vibration_psd, rel=0.1)


def test_coning_does_not_turn_the_attitude_away() -> None:
    """Without its correction a cone of 0.02 rad at 8 Hz drifts by a degree a minute."""
    n, hz, angle = 6000, 8.0, 0.02
    t = 0.005 * np.arange(1, n + 1)
    w = 2.0 * np.pi * hz
    rates = angle * w * np.column_stack([np.cos(w * t), np.sin(w * t), np.zeros(n)])
    times_ns = (t * 1e9).round().astype(np.int64)
    rows = np.hstack([np.tile([0.0, 0.0, -9.8], (n, 1)), rates])
    inertial = InertialState(0, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), Geodetic(0.8, 0.2, 100.0))
    raw, by_increments = both(times_ns, rows, initial_state(inertial, (0.0,) * 3, (0.0,) * 3), ImuErrors())
    drift = 0.5 * angle**2 * w * 0.5 * t[-1]
    assert turned(raw, by_increments) < 0.02 * drift
    assert drift > 0.01


def test_increments_do_not_depend_on_the_calls_that_ask_for_them() -> None:
    """Bit for bit: between marks and stamps alone."""
    d = simulate("urban", 1, 4.0)
    log = Log()
    for k, time_ns in enumerate(d.t_ns.tolist()):
        log.add(Sample(time_ns, tuple(d.force_b[k].tolist()), tuple(d.rate_b[k].tolist())))
        if k % 23 == 22:
            log.mark(time_ns)
    stamps = [int(d.t_ns[37]) + 1_000_000, int(d.t_ns[90])]
    end_ns = int(d.t_ns[22 + 23 * 12])

    def asked(ends_ns: list[int], most: int) -> list[list[float]]:
        begin_ns, found = int(d.t_ns[22]), []
        for until_ns in ends_ns:
            while begin_ns < until_ns:
                samples, _ = log.increments(begin_ns, until_ns, most, stamps)
                found += [[float(t), *map(float, row)] for t, row in zip(samples.times_ns, samples.rows, strict=True)]
                begin_ns = int(samples.times_ns[-1])
        return found

    at_once = asked([end_ns], 1000)
    assert asked([end_ns], 40) == at_once
    assert asked([int(d.t_ns[22 + 23 * k]) for k in range(1, 13)], 1000) == at_once
    assert max(b[0] - a[0] for a, b in pairwise(at_once)) <= 50_000_000
    assert int(d.t_ns[38]) in [row[0] for row in at_once] and stamps[1] in [row[0] for row in at_once]
