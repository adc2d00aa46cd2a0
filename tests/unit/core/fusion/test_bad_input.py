"""Faulty input in a car park, one test a row of the table in `docs/explanation/navigation.md`."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache
from math import hypot, radians
from typing import Any

import numpy as np
import pytest

from services.core.fusion.aids.base import Outcome
from services.core.fusion.aids.gnss.fix import Reading, Stamp, gnss_measurements
from services.core.fusion.aids.gnss.settings import GnssSettings
from services.core.fusion.codes import Code
from services.core.fusion.inertial.imu_faults import Repeats
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import AlignmentSettings, Settings
from services.core.fusion.solution import Solution
from services.core.fusion.start.heading import Prior
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference
from shared.messages.navigation import AidingKind, NavigationPhase
from shared.runtime.config import GnssAntenna, Vehicle
from tests.support.cases import each

SECOND_NS = 1_000_000_000
FAULT_S, END_S = 30.0, 52.0
SHARED_S = 28.0  # [s] of fault-free input, processed once for all runs that are faulty later
Vector = tuple[float, float, float]
Change = Callable[[float, Vector, Vector], tuple[Vector, Vector]]


@cache
def drive() -> Drive:
    return simulate("parking_lot", seed=2, duration_s=END_S, epoch_s=0.2)


@dataclass
class Run:
    navigator: Navigator
    outcomes: list[Outcome] = field(default_factory=list)
    solutions: list[tuple[int, Solution]] = field(default_factory=list)

    def error_m(self, time_s: float | None = None) -> float:
        """Horizontal error of the last solution, or of the one at a time."""
        wanted = [(i, s) for i, s in self.solutions if time_s is None or i * 0.01 <= time_s]
        i, solution = wanted[-1]
        truth = Geodetic(*drive().position[i].tolist())
        return hypot(*ned_from_geodetic_difference(solution.position, truth)[:2])

    def worst_m(self, begin_s: float, end_s: float) -> float:
        times = np.arange(begin_s, end_s, 0.5)
        return max(self.error_m(float(t)) for t in times)

    def within_sds(self, begin_s: float, end_s: float) -> bool:
        """Whether each axis was within four standard deviations."""
        for i, solution in self.solutions:
            if begin_s <= i * 0.01 < end_s:
                truth = Geodetic(*drive().position[i].tolist())
                error = np.abs(ned_from_geodetic_difference(solution.position, truth))
                if (error > 4.0 * np.sqrt(solution.position_cov.diagonal())).any():
                    return False
        return True


def unchanged(_: float, force: Vector, rate: Vector) -> tuple[Vector, Vector]:
    return force, rate


def new_run() -> Run:
    d = drive()
    made = Navigator(
        Settings().with_values({"vehicle.gnss.lever_arm_body_m": d.lever_arm_b, "alignment.levelling_s": 2.0})
    )
    made.use_prior(Prior(Geodetic(*d.position[0].tolist()), (1.0, 1.0, 2.0), float(d.attitude[0, 2]), radians(1.0)))
    return Run(made)


@cache
def fault_free_until(end_s: float) -> Run:
    return process(new_run(), 0.0, end_s)


def run(change: Change = unchanged, *, begin_s: float = SHARED_S, **faults: Any) -> Run:
    """Process the drive with faults, see `process`, that begin no earlier than `begin_s`."""
    before = fault_free_until(begin_s) if begin_s else new_run()
    begun = Run(deepcopy(before.navigator), list(before.outcomes), list(before.solutions))
    return process(begun, begin_s, END_S, change, **faults)


def process(
    found: Run,
    begin_s: float,
    end_s: float,
    change: Change = unchanged,
    *,
    imu_offset_s: Callable[[float], float | None] = lambda t: 0.0,
    gnss_offset_s: Callable[[float], float] = lambda t: 0.0,
    arrival_offset_s: Callable[[float], float] = lambda t: 0.0,
    again: Callable[[float], int] = lambda t: 0,
    saturated: Callable[[float], bool] = lambda t: False,
    sd: float | None = None,
) -> Run:
    """Process a part of the drive; keep ten solutions a second.

    An offset of None drops a sample; `again` is the number of preceding samples that are received once more.
    `arrival_offset_s` holds for samples and fixes.
    """
    d, made = drive(), found.navigator
    k = int(np.searchsorted(d.fix_ns, begin_s * 1e9, side="right"))
    for i in range(round(begin_s * 100), round(end_s * 100)):
        time_ns = int(d.t_ns[i])
        time_s = time_ns * 1e-9
        if k < len(d.fix_ns) and d.fix_ns[k] <= time_ns:
            give_fix(made, k, int(gnss_offset_s(time_s) * 1e9), sd, int(arrival_offset_s(time_s) * 1e9))
            k += 1
        offset_s = imu_offset_s(time_s)
        if offset_s is None:
            continue
        x, y, z = d.force_b[i].tolist()
        a, b, c = d.rate_b[i].tolist()
        force, rate = change(time_s, (x, y, z), (a, b, c))
        stamp_ns = time_ns + int(offset_s * 1e9)
        arrival_ns = time_ns + int(arrival_offset_s(time_s) * 1e9) + 2_000_000
        made.advance(stamp_ns, force, rate, arrival_ns, saturated=saturated(time_s))
        found.outcomes += made.release(arrival_ns)
        for j in range(i + 1 - again(time_s), i + 1):
            made.imu(int(d.t_ns[j]), d.force_b[j].tolist(), d.rate_b[j].tolist(), arrival_ns)
        solution = made.solution() if i % 10 == 9 else None
        if solution and solution.time_ns == stamp_ns:
            found.solutions.append((i, solution))
    return found


def give_fix(made: Navigator, k: int, offset_ns: int, sd: float | None, arrival_offset_ns: int = 0) -> None:
    d = drive()
    north, east, down = d.fix_velocity_n[k].tolist()
    made.fix(
        int(d.fix_ns[k]) + offset_ns,
        position=Geodetic(*d.fix_position[k].tolist()),
        velocity=(north, east, down),
        position_sd=d.fix_position_sd_n[k].tolist() if sd is None else (sd, sd, sd),
        velocity_sd=d.fix_velocity_sd_n[k].tolist() if sd is None else (sd, sd, sd),
        received_ns=int(d.fix_ns[k]) + arrival_offset_ns,
    )


def test_a_gap_of_four_samples_is_integrated_over_and_not_counted_as_a_gap() -> None:
    """Each second four samples are missing, and the fifth is used for 50 ms."""
    whole, cut = (
        fault_free_until(END_S),
        run(imu_offset_s=lambda t: None if t > FAULT_S and 0.205 < t % 1.0 < 0.245 else 0.0),
    )
    assert cut.navigator.counts.imu_gaps == 0 and not cut.navigator.rejects
    assert cut.within_sds(FAULT_S, END_S) and cut.worst_m(FAULT_S, END_S) < whole.worst_m(FAULT_S, END_S) + 0.1


@pytest.mark.parametrize("gap_s", [0.06, 0.5, 0.9])
def test_a_gap_of_less_than_a_second_is_bridged(gap_s: float) -> None:
    found = run(imu_offset_s=lambda t: None if FAULT_S <= t < FAULT_S + gap_s else 0.0)
    assert found.navigator.counts.imu_gaps == 1 and found.navigator.counts.resets == 0
    assert found.within_sds(FAULT_S, END_S) and found.worst_m(FAULT_S + 5.0, END_S) < 0.6


@pytest.mark.parametrize(("gap_s", "limit_m"), [(1.1, 1.0), (4.9, 4.0)])
def test_a_gap_of_more_than_a_second_ends_the_solution_and_the_next_fix_starts_a_new_one(
    gap_s: float, limit_m: float
) -> None:
    found = run(imu_offset_s=lambda t: None if FAULT_S <= t < FAULT_S + gap_s else 0.0)
    assert found.navigator.phase is NavigationPhase.NAVIGATING
    assert not [i for i, _ in found.solutions if FAULT_S < i * 0.01 < FAULT_S + gap_s]
    assert found.navigator.why[-1].code in (Code.GAP, Code.HEADING_WRONG)
    assert found.worst_m(FAULT_S + gap_s + 8.0, END_S) < limit_m


def test_a_reported_saturation_of_the_gyroscope_reduces_the_position_error() -> None:
    """Clipped at 0.2 rad/s in bends, with and without the saturation flag of the sensor."""

    def clipped(t: float, force: Vector, rate: Vector) -> tuple[Vector, Vector]:
        x, y, z = rate
        return force, (x, y, max(-0.2, min(0.2, z))) if 28.0 < t < 50.0 else rate

    flagged = run(clipped, saturated=lambda t: 28.0 < t < 50.0 and abs(drive().rate_b[round(t * 100) - 1, 2]) > 0.2)
    unflagged = run(clipped)
    assert flagged.navigator.rejects["gyroscope saturated"] > 100
    assert flagged.worst_m(28.0, END_S) < 0.7 * unflagged.worst_m(28.0, END_S)


def test_repeated_large_rates_are_detected_as_a_saturated_gyroscope() -> None:
    repeats: Repeats | None = None
    found = []
    for k in range(60):
        rate = min(2.0, 0.1 * k)
        readings = (0.01 * k, 0.0, -9.8 + 0.003 * (k % 3), 0.001 * k, 0.0, rate)
        repeats = repeats or Repeats(k * 10**7, readings)
        found.append(repeats.fault(k * 10**7, readings))
    assert found[:22] == [None] * 22 and found[25:] == ["gyroscope saturated"] * 35


@pytest.mark.parametrize("axes", [(0, 1, 2), (0,)], ids=["all", "one"])
def test_a_stuck_accelerometer_is_detected_and_the_position_error_stays_below_two_metres(axes: tuple[int, ...]) -> None:
    """From 30 to 45 s the accelerometer, or its forward axis, repeats its last reading."""
    held: list[Vector] = []

    def stuck(t: float, force: Vector, rate: Vector) -> tuple[Vector, Vector]:
        if not FAULT_S <= t < 45.0:
            return force, rate
        held.append(force)
        x, y, z = (held[0][axis] if axis in axes else force[axis] for axis in range(3))
        return (x, y, z), rate

    found = run(stuck)
    assert 1400 <= found.navigator.rejects["accelerometer stuck"] <= 1460
    assert found.worst_m(FAULT_S, 45.0) < 2.0, "five fixes a second"
    assert found.worst_m(48.0, END_S) < 0.6
    assert found.navigator.counts.resets == 0


def test_no_sensor_is_reported_stuck_in_a_fault_free_drive_with_two_constant_axes() -> None:
    """A gyroscope that measures the yaw rate only, and reports zero for the other axes."""
    found = run(lambda t, force, rate: (force, (0.0, 0.0, rate[2])), begin_s=0.0)
    assert not found.navigator.rejects["accelerometer stuck"] and not found.navigator.rejects["gyroscope saturated"]


def test_a_stated_accuracy_of_zero_is_replaced_by_the_default() -> None:
    found = run(sd=0.0, begin_s=0.0)
    first = next(o for o in found.outcomes if o.kind is AidingKind.GNSS_POSITION)
    assert first.innovation_sd[0] > 1.0, "the default of a receiver that states none, not the minimum of 1 cm"
    assert found.within_sds(20.0, END_S)


@each("odd", [0.0, -1.0, 1e-300, 5e-324])
@each("axis", range(3))
def test_an_axis_without_a_stated_variance_has_the_default(axis: int, odd: float) -> None:
    settings, stated = Settings(gnss=GnssSettings(position_sd_factor=2.0)), np.full((3, 3), 0.1) + 0.9 * np.eye(3)
    stated[axis, axis] = odd
    place, stamp = Geodetic(*drive().position[0].tolist()), Stamp(0, 0, "gnss")
    reading = Reading((0.0, 0.0, 0.0), stated)
    velocity, position = (m.cov for m in gnss_measurements(settings, stamp, place, reading, reading))  # type: ignore[attr-defined]
    for cov, default, factor in (
        (position, settings.gnss.position_sd_ned_m, 2.0),
        (velocity, settings.gnss.velocity_sd_ned_m_s, 1.0),
    ):
        others = [place for place in range(3) if place != axis]
        assert cov[axis, axis] == pytest.approx(default[axis] ** 2) and not cov[axis, others].any()
        assert cov[np.ix_(others, others)] == pytest.approx(factor**2 * np.array([[1.0, 0.1], [0.1, 1.0]]))


def test_a_stated_variance_of_1e12_leaves_the_covariance_finite_and_resets_nothing() -> None:
    found = run(sd=1e6, begin_s=0.0)
    assert np.isfinite(found.solutions[-1][1].position_cov).all()
    assert found.navigator.counts.resets == 0


def all_clocks_step(step_s: float) -> Run:
    def step(t: float) -> float:
        return step_s if t > FAULT_S else 0.0

    return run(imu_offset_s=step, gnss_offset_s=step, arrival_offset_s=step)


@pytest.mark.parametrize("step_s", [3600.0, 1.5])
def test_clocks_that_step_ahead_together_are_a_gap_of_the_imu(step_s: float) -> None:
    """IMU, GNSS and arrival stamps step together, as with a step of the host's clock."""
    found = all_clocks_step(step_s)
    assert found.navigator.counts.imu_gaps == 1
    assert found.navigator.why[-1].code == Code.GAP
    assert found.navigator.why[-1].values["gap_s"] == pytest.approx(step_s, abs=0.05)


def test_an_imu_clock_that_steps_back_by_an_hour_resets_the_filter() -> None:
    found = run(imu_offset_s=lambda t: -3600.0 if t > FAULT_S else 0.0)
    assert found.navigator.counts.resets == 1
    assert found.navigator.why[-1].code == Code.CLOCK_BACK
    assert found.navigator.rejects["sample doubled or out of order"] == 101


@pytest.mark.parametrize("step_s", [-0.3, -0.9])
def test_the_time_lost_when_all_clocks_are_set_back_is_added_to_the_covariance(step_s: float) -> None:
    """Samples with stamps below the newest one are rejected while the vehicle drives on."""
    found = all_clocks_step(step_s)
    rejects = found.navigator.rejects
    assert rejects["time lost as the inertial clock went back"] == 1 and found.navigator.counts.resets == 0
    assert rejects["sample doubled or out of order"] == pytest.approx(-100.0 * step_s, abs=1.0)
    resumed_s = FAULT_S - step_s + 0.02  # the first sample with a newer stamp
    assert found.within_sds(resumed_s, END_S) and found.worst_m(FAULT_S + 8.0, END_S) < 0.6


@pytest.mark.parametrize("count", [1, 20])
def test_repeated_samples_are_counted_and_change_nothing(count: int) -> None:
    """One sample, or a message of twenty, is received twice."""
    whole, found = (
        fault_free_until(END_S),
        run(again=lambda t: count if t > FAULT_S and round(t * 100) % 50 == 0 else 0),
    )
    assert found.navigator.rejects["sample doubled or out of order"] > 40 * count - 1
    assert len(found.navigator.rejects) == 1
    assert found.solutions[-1][1].position == whole.solutions[-1][1].position
    assert (found.solutions[-1][1].position_cov == whole.solutions[-1][1].position_cov).all()


def test_single_old_samples_are_not_a_clock_that_was_set_back() -> None:
    """Two swapped neighbours, and one sample with a stamp of an hour ago."""
    found = run(
        imu_offset_s=lambda t: -3600.0 if round(t * 100) % 100 == 50 else -0.05 if round(t * 100) % 100 == 51 else 0
    )
    assert set(found.navigator.rejects) == {"sample doubled or out of order"}


def test_samples_within_a_bridged_gap_are_rejected_and_no_time_is_lost() -> None:
    """One sample is stamped half a second ahead: a gap, and the samples within it are out of order."""
    found = run(imu_offset_s=lambda t: 0.5 if round(t * 100) == 3100 else 0.0)
    assert found.navigator.rejects["sample doubled or out of order"] >= 48
    assert not found.navigator.rejects["time lost as the inertial clock went back"]


def test_a_sample_from_the_future_is_rejected_and_changes_nothing() -> None:
    found = run(imu_offset_s=lambda t: 10.0 if round(t * 100) in (3100, 3101, 3500) else 0.0)
    assert found.navigator.rejects == {"sample from the future": 3}
    assert found.navigator.counts.resets == 0 and found.navigator.phase is NavigationPhase.NAVIGATING
    assert found.within_sds(FAULT_S, END_S) and found.worst_m(FAULT_S, END_S) < 0.6


def test_an_imu_clock_that_stays_ahead_is_accepted_after_a_hundred_samples() -> None:
    found = run(imu_offset_s=lambda t: 10.0 if t > FAULT_S else 0.0)
    assert found.navigator.rejects["sample from the future"] == 100
    assert found.navigator.why[-1].code == Code.GAP
    assert found.navigator.why[-1].values["gap_s"] == pytest.approx(11.0, abs=0.05)


@pytest.mark.parametrize(
    ("step_s", "reject"),
    [
        (3600.0, "measurement from the future"),
        (-3600.0, "measurement older than the memory"),
        (-1024 * 7 * 86_400.0, "measurement older than the memory"),
    ],
    ids=["ahead", "behind", "week number rolled over"],
)
def test_fixes_of_a_receiver_whose_clock_steps_by_an_hour_are_rejected(step_s: float, reject: str) -> None:
    found = run(gnss_offset_s=lambda t: step_s if t > FAULT_S else 0.0)
    assert found.navigator.rejects[reject] > 200
    assert found.navigator.phase is NavigationPhase.COASTING
    assert found.within_sds(FAULT_S, END_S)


@pytest.mark.parametrize("north_m", [15.0, 200.0])
def test_of_two_receivers_the_one_with_a_step_of_position_is_rejected(north_m: float) -> None:
    """Both have five fixes a second; from 30 s on the second has a constant position error."""
    d = drive()
    made = Navigator(
        Settings(
            vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=d.lever_arm_b)),
            alignment=AlignmentSettings(levelling_s=2.0),
        )
    )
    made.use_prior(Prior(Geodetic(*d.position[0].tolist()), (1.0, 1.0, 2.0), float(d.attitude[0, 2]), radians(1.0)))
    found = Run(made)
    for i, time_ns in enumerate(d.t_ns.tolist()):
        if i % 20 == 19:
            give_fix(made, i // 20, 0, None)
            shift = (north_m if time_ns >= FAULT_S * 1e9 else 0.0, 0.0, 0.0)
            made.fix(
                time_ns,
                position=geodetic_from_ned_difference(shift, Geodetic(*d.fix_position[i // 20].tolist())),
                position_sd=d.fix_position_sd_n[i // 20].tolist(),
                source="second",
            )
        found.outcomes += made.imu(time_ns, d.force_b[i].tolist(), d.rate_b[i].tolist())
        if i % 10 == 9 and (solution := made.solution()):
            found.solutions.append((i, solution))
    late = [o for o in found.outcomes if o.time_ns > FAULT_S * 1e9 and o.kind is AidingKind.GNSS_POSITION]
    assert not any(o.used for o in late if o.source == "second")
    assert sum(o.used for o in late if o.source == "gnss") > 0.95 * sum(o.source == "gnss" for o in late)
    assert made.counts.resets == 0 and found.worst_m(FAULT_S, END_S) < 0.6


@pytest.mark.parametrize("broken", [float("nan"), float("inf")])
def test_a_fix_that_is_not_finite_is_counted_and_rejected(broken: float) -> None:
    """JSON carries no such numbers; a caller of the navigator may have them."""
    made, place = Navigator(), Geodetic(*drive().position[0].tolist())
    good = (0.0, 0.0, 0.0)
    for odd in (place._replace(latitude=broken), place._replace(longitude=broken), place._replace(height=broken)):
        made.fix(SECOND_NS, position=odd, velocity=(broken, 0.0, 0.0), position_sd=(broken, 1.0, 1.0))
    made.fix(SECOND_NS, position=place, velocity=good, position_sd=(broken, 1.0, 1.0))
    expected = {"position not finite": 3, "implausible velocity": 3}
    assert made.rejects == expected, "finite ones wait for their sample"


@pytest.mark.parametrize("step_s", [1.0, -1.0])
def test_fixes_of_a_receiver_whose_clock_steps_by_a_second_are_rejected_in_motion(step_s: float) -> None:
    found = run(gnss_offset_s=lambda t: step_s if t > FAULT_S else 0.0)
    rejected = [o for o in found.outcomes if o.time_ns > (FAULT_S + 2.0) * 1e9 and o.reason]
    assert len(rejected) > 20, "while the vehicle accelerates or is fast"


@pytest.mark.parametrize(
    ("wrong", "reported"), [((0.0, 0.0), False), ((2.0, 0.0), True), ((0.0, -2.0), True)], ids=["right", "2 m", "-2 m"]
)
def test_only_a_lever_arm_that_is_wrong_by_two_metres_is_reported(wrong: tuple[float, float], reported: bool) -> None:
    d = drive()
    x, y, z = d.lever_arm_b
    made = Navigator(Settings(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=(x + wrong[0], y + wrong[1], z)))))
    made.use_prior(Prior(Geodetic(*d.position[0].tolist()), (1.0, 1.0, 2.0), float(d.attitude[0, 2]), radians(1.0)))
    for i, time_ns in enumerate(d.t_ns.tolist()):
        if i % 20 == 19:
            give_fix(made, i // 20, 0, None)
        made.imu(time_ns, d.force_b[i].tolist(), d.rate_b[i].tolist())
    error = made.lever_arm_error
    assert (error is not None) is reported
    if error:
        along = -(error[0] * wrong[0] + error[1] * wrong[1]) / 2.0
        assert 0.5 < along < 2.5 and hypot(*error) < 1.2 * along
