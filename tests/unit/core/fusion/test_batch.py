"""A log solved as one batch equals its samples processed one by one, compiled or not."""

import os
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from math import radians
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from services.core.fusion.aids.base import Measurement
from services.core.fusion.aids.odometer.aid import WheelSpeed
from services.core.fusion.batch import solve
from services.core.fusion.inertial.imu_faults import Repeats, faults
from services.core.fusion.inertial.propagation import samples_of
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.solution import Solution
from services.core.fusion.start.heading import Prior
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic, ned_track
from shared.messages.navigation import NavigationPhase

FloatArray = npt.NDArray[np.float64]
TENTH_NS = 100_000_000


class Collector(Navigator):
    """Keeps measurements instead of using them."""

    collected: list[Measurement]

    def measure(self, measurement: Measurement) -> None:
        self.collected.append(measurement)


@cache
def drive() -> Drive:
    """Two minutes in a town, with stops; GNSS is missing from 60 s to 75 s."""
    return simulate("urban", seed=4, duration_s=120.0)


def settings(**changes: object) -> Settings:
    return Settings().with_values(
        {"vehicle.gnss.lever_arm_body_m": drive().lever_arm_b, "alignment.levelling_s": 2.0, **changes}
    )


def fresh(**changes: object) -> Navigator:
    d = drive()
    navigator = Navigator(settings(**changes))
    navigator.use_prior(
        Prior(Geodetic(*d.position[0].tolist()), (1.0, 1.0, 2.0), float(d.attitude[0, 2]), radians(1.0))
    )
    return navigator


@cache
def measurements() -> list[Measurement]:
    """Fixes with stamps between the samples, and wheel speeds."""
    d, collector = drive(), Collector(settings())
    collector.collected = []
    for k in np.flatnonzero(d.fix_valid & ~((d.fix_ns > 60e9) & (d.fix_ns < 75e9))).tolist():
        north, east, down = d.fix_velocity_n[k].tolist()
        collector.fix(
            int(d.fix_ns[k]) - 3_300_000,
            position=Geodetic(*d.fix_position[k].tolist()),
            velocity=(north, east, down),
            position_sd=tuple(d.fix_position_sd_n[k].tolist()),
            velocity_sd=tuple(d.fix_velocity_sd_n[k].tolist()),
        )
    for stamp, speed in zip(d.odometer_ns.tolist(), d.odometer.tolist(), strict=True):
        collector.speed(stamp, speed)
    return collector.collected


def log() -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Samples of the drive, of which some are missing, doubled, swapped, not finite or impossible."""
    d = drive()
    stamps, samples = d.t_ns.copy(), np.column_stack([d.force_b, d.rate_b])
    keep = np.ones(len(stamps), dtype=bool)
    keep[4000:4020] = keep[8000:8003] = False
    stamps[5000] = stamps[4999]
    stamps[[6000, 6001]] = stamps[[6001, 6000]]
    samples[7000, 2], samples[7010, 4] = np.nan, 1e200
    return stamps[keep], samples[keep]


@cache
def at_once(**changes: object) -> tuple[Navigator, list[Solution]]:
    navigator = fresh(**changes)
    return navigator, list(solve(navigator, *log(), measurements(), every_ns=TENTH_NS))


def numbers() -> FloatArray:
    """Position [m], velocity, yaw and standard deviations of the solutions of the drive, one row each."""
    solutions = at_once()[1]
    place = ned_track(np.array([s.position for s in solutions]), solutions[0].position)
    motion = [[*s.velocity, s.yaw] for s in solutions]
    variances = [[*s.position_cov.diagonal(), *s.velocity_cov.diagonal()] for s in solutions]
    return np.hstack([place, motion, np.sqrt(variances)])


def one_by_one(**changes: object) -> tuple[Navigator, list[Solution]]:
    """Each sample alone, with the measurements since the last one; a solution at the first sample of each 0.1 s."""
    navigator, solutions, place, tenth = fresh(**changes), [], 0, 0
    pending = sorted(measurements(), key=lambda m: (m.time_ns, m.received_ns, m.source))
    newest = -1
    for stamp, row in zip(log()[0].tolist(), log()[1].tolist(), strict=True):
        if stamp <= newest or not np.isfinite(row).all() or abs(row[4]) > 100.0:
            navigator.samples_rejected += 1
            continue
        due: Sequence[Measurement] = []
        while place < len(pending) and pending[place].time_ns <= stamp:
            due = [*due, pending[place]]
            place += 1
        navigator.engine.process(samples_of([stamp], [row], {}), due)
        if newest >= 0 and stamp // TENTH_NS != tenth and (solution := navigator.solution()):
            solutions.append(solution)
        newest, tenth = stamp, stamp // TENTH_NS
    return navigator, solutions


@pytest.mark.parametrize("aided", [True, False])
def test_a_batch_equals_single_samples_to_the_last_bit(aided: bool) -> None:
    """With stops, turns, an outage, a gap and rejected samples."""
    switches = {"standstill.enabled": aided, "non_holonomic.enabled": aided}
    whole, solutions = at_once(**switches)
    single, expected = one_by_one(**switches)
    assert len(solutions) > 1100
    assert {NavigationPhase.NAVIGATING, NavigationPhase.COASTING} <= {solution.phase for solution in solutions}
    assert {True, False} == {solution.stationary for solution in solutions}
    for ours, theirs in zip(solutions, expected, strict=True):
        for name in ("time_ns", "phase", "position", "velocity", "yaw", "rate", "stationary", "gnss_age_s"):
            assert getattr(ours, name) == getattr(theirs, name), (name, ours.time_ns)
        assert np.array_equal(ours.position_cov, theirs.position_cov)
    assert whole.counts == single.counts and whole.counts.imu_gaps == 1
    assert whole.samples_rejected == single.samples_rejected == 4


def received_one_by_one(
    given: list[Measurement], late_ns: int = 0, **changes: object
) -> tuple[Navigator, list[Solution]]:
    """Each sample alone, with measurements that are received `late_ns` after their stamps; a solution each 0.1 s."""
    navigator, solutions, place, newest = fresh(merge_delay_s=0.0, **changes), [], 0, -1
    pending = sorted(given, key=lambda m: (m.time_ns, m.received_ns, m.source))
    for stamp, row in zip(log()[0].tolist(), log()[1].tolist(), strict=True):
        while place < len(pending) and pending[place].time_ns + late_ns <= stamp:
            navigator.measure(pending[place])
            place += 1
        navigator.imu(stamp, row[:3], row[3:])
        if stamp // TENTH_NS > newest // TENTH_NS:
            navigator.finish()
        if newest >= 0 and stamp // TENTH_NS > newest // TENTH_NS and (solution := navigator.solution()):
            solutions.append(solution)
        newest = max(newest, stamp)
    return navigator, solutions


def test_compiled_and_plain_python_agree_to_a_billionth_of_each_standard_deviation(tmp_path: Path) -> None:
    """In a process of its own without Numba: positions, velocities and their deviations over the whole drive."""
    pytest.importorskip("numba", reason="Numba is not installed: `make setup`")
    path = tmp_path / "plain.npy"
    code = f"import numpy; from {__name__} import numbers; numpy.save({str(path)!r}, numbers())"
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
    plain, ours = np.load(path), numbers()
    sd = plain[:, 7:]
    assert (np.abs(ours - plain)[:, :6] < 1e-9 * sd + 1e-12).all()
    assert ours == pytest.approx(plain, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("aided", [True, False])
def test_received_samples_and_measurements_equal_a_batch_to_the_last_bit(aided: bool) -> None:
    """Through the interface of the navigator, polled every 0.1 s."""
    switches = {"standstill.enabled": aided, "non_holonomic.enabled": aided}
    whole, expected = at_once(**switches)
    single, solutions = received_one_by_one(measurements(), **switches)
    assert len(solutions) == len(expected) > 1100
    for ours, theirs in zip(solutions, expected, strict=True):
        for name in ("time_ns", "phase", "position", "velocity", "yaw", "rate", "stationary", "gnss_age_s"):
            assert getattr(ours, name) == getattr(theirs, name), (name, ours.time_ns)
        assert np.array_equal(ours.position_cov, theirs.position_cov)
    assert whole.counts == single.counts
    assert (single.samples_used, single.samples_rejected) == (whole.samples_used, whole.samples_rejected)


def test_solutions_after_a_late_fix_equal_those_after_a_fix_in_time_to_the_last_bit() -> None:
    """Fixes at 1 Hz, 0.31 s late; compared wherever all of them were received."""
    late_ns = 310_000_000
    fixes = [measurement for measurement in measurements() if not isinstance(measurement, WheelSpeed)]
    in_time, late = (
        {solution.time_ns: solution for solution in received_one_by_one(fixes, ns)[1]} for ns in (0, late_ns)
    )
    waiting = np.array([fix.time_ns for fix in fixes])
    arrived = [
        stamp for stamp in in_time.keys() & late.keys() if not ((stamp - late_ns < waiting) & (waiting <= stamp)).any()
    ]
    assert len(arrived) > 500
    for stamp in arrived:
        assert in_time[stamp].position == late[stamp].position
        assert np.array_equal(in_time[stamp].position_cov, late[stamp].position_cov)


def test_faults_found_in_a_batch_are_those_found_sample_by_sample() -> None:
    """Each axis repeats its value for times around the limits; one axis is constant."""
    rng = np.random.default_rng(1)
    samples = rng.standard_normal((20_000, 6))
    for begin in range(0, 19_800, 200):
        axis, count = rng.integers(0, 6), rng.integers(2, 140)
        samples[begin : begin + count, axis] = samples[begin, axis] * 3.0
    samples[:, 4] = 2.0
    stamps = np.cumsum(rng.integers(4_000_000, 6_000_000, 20_000))
    first = stamps[0], tuple(samples[0])
    repeats = Repeats(int(first[0]), first[1])
    single = [repeats.fault(int(stamp), tuple(row)) for stamp, row in zip(stamps, samples, strict=True)]
    assert faults(stamps, samples) == {place: fault for place, fault in enumerate(single) if fault}
    assert {None, "accelerometer stuck", "gyroscope saturated"} == set(single)


def test_an_empty_log_has_no_solution() -> None:
    assert list(solve(fresh(), np.zeros(0, dtype=np.int64), np.zeros((0, 6)), [], every_ns=TENTH_NS)) == []
