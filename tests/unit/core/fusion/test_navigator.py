"""The navigator as a whole: late, doubled, missing and impossible input, and its reported state."""

import pickle
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache
from math import degrees, hypot, radians

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.core.fusion.aids.base import Outcome
from services.core.fusion.codes import Code
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.solution import Solution
from services.core.fusion.start.heading import Prior
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference
from shared.messages.explanation import explain
from shared.messages.navigation import AidingKind, NavigationPhase

SECOND_NS = 1_000_000_000
DURATION_S = 40.0


@cache
def drive() -> Drive:
    """40 s of the car park: at least 16 s of standstill, then corners."""
    return simulate("parking_lot", seed=2, duration_s=DURATION_S, epoch_s=0.2)


def navigator(**changes: object) -> Navigator:
    """Navigator with two seconds of levelling and a known heading."""
    d = drive()
    made = Navigator(
        Settings().with_values(
            {"vehicle.gnss.lever_arm_body_m": d.lever_arm_b, "alignment.levelling_s": 2.0, **changes}
        )
    )
    made.use_prior(Prior(Geodetic(*d.position[0].tolist()), (1.0, 1.0, 2.0), float(d.attitude[0, 2]), radians(1.0)))
    return made


@dataclass
class Run:
    """A navigator after some input, with its solutions and outcomes."""

    navigator: Navigator
    solutions: list[Solution]
    outcomes: list[Outcome]

    @property
    def last(self) -> Solution:
        return self.solutions[-1]

    def settled(self) -> Solution:
        """Solution once everything has been used, whatever the lag of the horizon was."""
        navigator = deepcopy(self.navigator)
        self.outcomes += navigator.finish()
        solution = navigator.solution()
        assert solution is not None
        return solution

    def error_m(self) -> float:
        """Horizontal error at the last solution."""
        truth = Geodetic(*drive().position[round(self.last.time_ns / 1e7) - 1].tolist())
        return hypot(*ned_from_geodetic_difference(self.last.position, truth)[:2])


@dataclass(frozen=True)
class Event:
    """A sample (fix is None) or a fix of the drive, and when it reaches the navigator."""

    arrival_ns: int
    received_ns: int
    sample: int = 0
    fix: int | None = None
    repeats: int | None = None  # the fix whose values it repeats


def samples(until_s: float = DURATION_S, delay_ns: int = 2_000_000) -> list[Event]:
    d = drive()
    return [Event(t + delay_ns, t + delay_ns, i) for i, t in enumerate(d.t_ns.tolist()) if t <= until_s * 1e9]


def fixes(until_s: float = DURATION_S, delay_ns: int = 80_000_000) -> list[Event]:
    d = drive()
    return [Event(t + delay_ns, t + delay_ns, fix=k) for k, t in enumerate(d.fix_ns.tolist()) if t <= until_s * 1e9]


def feed(run: Navigator, events: list[Event], *, stamp_offset_ns: int = 0, **fix_changes: object) -> Run:
    d, result = drive(), Run(run, [], [])
    for event in sorted(events, key=lambda e: e.arrival_ns):
        if event.fix is not None:
            repeated_ns = 0 if event.repeats is None else int(d.fix_ns[event.fix] - d.fix_ns[event.repeats])
            value = event.fix if event.repeats is None else event.repeats
            give_fix(run, value, event.received_ns, stamp_offset_ns + repeated_ns, **fix_changes)
            continue
        i = event.sample
        result.outcomes += run.imu(int(d.t_ns[i]), d.force_b[i].tolist(), d.rate_b[i].tolist(), event.received_ns)
        solution = run.solution()
        if solution:
            result.solutions.append(solution)
    return result


@cache
def standard_run() -> Run:
    """All samples and fixes of the drive in order."""
    return feed(navigator(), samples() + fixes())


@cache
def standard_until(end_s: float) -> Run:
    """Samples and fixes until a time."""
    return feed(navigator(), samples(end_s) + fixes(end_s))


def navigator_at(end_s: float) -> Navigator:
    """Copy of the navigator at a time of the drive."""
    return deepcopy(standard_until(end_s).navigator)


def give_fix(run: Navigator, k: int, received_ns: int, stamp_offset_ns: int = 0, **changes: object) -> None:
    d = drive()
    shift = changes.get("shift", (0.0, 0.0, 0.0))
    assert isinstance(shift, tuple)
    north, east, down = d.fix_velocity_n[k].tolist()
    position = geodetic_from_ned_difference(shift, Geodetic(*d.fix_position[k].tolist()))
    run.fix(
        int(d.fix_ns[k]) + stamp_offset_ns,
        position=position,
        velocity=None if changes.get("no_velocity") else (north, east, down),
        position_sd=changes.get("position_sd", tuple(d.fix_position_sd_n[k].tolist())),  # type: ignore[arg-type]  # of the test's own making
        velocity_sd=changes.get("velocity_sd", tuple(d.fix_velocity_sd_n[k].tolist())),  # type: ignore[arg-type]  # the same
        received_ns=received_ns,
    )


def same(first: Solution, second: Solution) -> bool:
    """Whether two solutions are equal to the last bit."""
    scalars = all(
        getattr(first, name) == getattr(second, name)
        for name in ("time_ns", "phase", "position", "velocity", "roll", "pitch", "yaw", "rate", "gnss_age_s")
    )
    return scalars and all(
        np.array_equal(getattr(first, name), getattr(second, name))
        for name in ("position_cov", "velocity_cov", "attitude_cov", "accelerometer_bias", "gyroscope_bias")
    )


def test_after_40_s_position_and_heading_are_close_to_the_truth() -> None:
    run = standard_run()
    assert run.navigator.phase is NavigationPhase.NAVIGATING
    assert run.error_m() < 0.5
    assert degrees(abs(run.last.yaw - drive().attitude[-1, 2])) < 1.0
    counts = run.navigator.counts
    assert counts.fixes_used > 150 and counts.imu_gaps == 0 and counts.resets == 0


@settings(max_examples=12, deadline=None)
@given(st.lists(st.integers(0, 49_000_000), min_size=200, max_size=200), st.integers(0, 49_000_000))
def test_the_order_of_arrival_does_not_matter(jitter_ns: list[int], sample_delay_ns: int) -> None:
    """Fixes and samples have separate topics; the bus may delay any of them by less than the merge delay."""
    until_s = 5.0
    fixed, moved = fixes(until_s), samples(until_s)
    late = [Event(e.arrival_ns + jitter_ns[k], e.received_ns, fix=e.fix) for k, e in enumerate(fixed)]
    shifted = [Event(e.arrival_ns + sample_delay_ns, e.received_ns, e.sample) for e in moved]
    reference, other = standard_until(until_s), feed(navigator(), shifted + late)
    assert len(reference.solutions) > 100
    assert all(map(same, reference.solutions, other.solutions))
    assert reference.outcomes == other.outcomes
    assert reference.navigator.counts == other.navigator.counts


@pytest.mark.parametrize("offset_ns", [0, -3_000_000])
def test_fixes_that_are_0_7_s_late_result_in_the_same_solution_to_the_last_bit(offset_ns: int) -> None:
    until_s = 30.0
    prompt = [Event(e.arrival_ns, e.received_ns, fix=e.fix) for e in fixes(until_s, delay_ns=0)]
    late = [Event(e.arrival_ns, e.received_ns, fix=e.fix) for e in fixes(until_s, delay_ns=700_000_000)]
    end = samples(until_s + 0.9)
    in_time = feed(navigator(merge_delay_s=0.0), end + prompt, stamp_offset_ns=offset_ns)
    afterwards = feed(navigator(merge_delay_s=0.0), end + late, stamp_offset_ns=offset_ns)
    assert same(in_time.settled(), afterwards.settled())


def test_fixes_received_together_result_in_the_solution_of_fixes_in_time() -> None:
    in_time, held = feed(navigator(), samples(30.0) + fixes(29.5)).settled(), round(29.6 * SECOND_NS)
    late = [replace(e, arrival_ns=held, received_ns=held) if e.arrival_ns > 28 * SECOND_NS else e for e in fixes(29.5)]
    assert same(feed(navigator(), samples(30.0) + late).settled(), in_time)


def test_a_fix_stamped_ahead_of_the_samples_waits_for_them() -> None:
    """The clock of the receiver is 0.1 s ahead, and `gnss.delay_s` is set to it."""
    ahead = feed(navigator(**{"gnss.delay_s": 0.1}), samples() + fixes(delay_ns=0), stamp_offset_ns=100_000_000)
    in_time = feed(navigator(), samples() + fixes(delay_ns=0))
    assert ahead.error_m() == pytest.approx(in_time.error_m(), abs=1e-3)


def test_the_outcomes_of_a_fix_stamped_ahead_are_returned_once_the_horizon_has_passed_it() -> None:
    d, run = drive(), feed(navigator(), samples(20.0) + fixes(19.5)).navigator
    give_fix(run, round(20.2 / 0.2), 20 * SECOND_NS)
    for i in range(2000, 2080):
        outcomes = run.imu(int(d.t_ns[i]), d.force_b[i].tolist(), d.rate_b[i].tolist())
        if any(outcome.source == "gnss" for outcome in outcomes):
            break
    found = [outcome for outcome in outcomes if outcome.source == "gnss"]
    assert 0.2e9 <= d.t_ns[i] - found[0].time_ns <= 0.3e9 and len(found) == 2, "position and velocity"


@pytest.mark.parametrize("delay_ns", [80_000_000, 600_000_000])
def test_a_fix_received_twice_is_used_and_reported_once(delay_ns: int) -> None:
    """The second time late, or at once with the first."""
    once = feed(navigator(merge_delay_s=0.0), samples(20.0) + fixes(19.0))
    again = fixes(19.0) + fixes(19.0, delay_ns=delay_ns)
    twice = feed(navigator(merge_delay_s=0.0), samples(20.0) + again)
    assert same(once.settled(), twice.settled())
    reported = [sum(outcome.source == "gnss" for outcome in run.outcomes) for run in (once, twice)]
    assert reported[0] == reported[1] and twice.navigator.counts.epochs_repeated > 50


def test_stamps_below_zero_take_no_more_memory() -> None:
    d, sizes = drive(), []
    for begin_ns in (0, -(2**60)):
        run = navigator()
        for i, time_ns in enumerate(d.t_ns[:1200].tolist()):
            if i % 100 == 0:
                run.fix(begin_ns + time_ns, position=Geodetic(*d.position[i].tolist()), position_sd=(1.0, 1.0, 1.0))
            run.imu(begin_ns + time_ns, d.force_b[i].tolist(), d.rate_b[i].tolist())
        assert run.counts.fixes_used > 5
        sizes.append(len(pickle.dumps(run)))
    assert sizes[1] < 1.05 * sizes[0]


def test_a_fix_older_than_the_history_is_counted_and_rejected() -> None:
    run = navigator_at(10.0)
    give_fix(run, 0, 10 * SECOND_NS)
    feed(run, [Event(10_300_000_000, 10_300_000_000, 1015)])
    assert run.rejects["measurement older than the memory"] == 2  # its position and its velocity


def test_doubled_and_swapped_samples_are_counted_and_rejected() -> None:
    events = samples()
    doubled = events + [Event(e.arrival_ns + 1, e.received_ns, e.sample) for e in events[::100]]
    swapped = [Event(e.arrival_ns + 15_000_000, e.received_ns, e.sample) if e.sample % 97 == 50 else e for e in doubled]
    run = feed(navigator(), swapped + fixes())
    assert run.navigator.samples_rejected == run.navigator.rejects["sample doubled or out of order"] > 70
    assert run.error_m() < 0.5


@pytest.mark.parametrize(
    ("force", "kind"),
    [((float("nan"), 0.0, -9.8), "sample not finite"), ((0.0, 1e6, -9.8), "implausible sample")],
)
def test_impossible_samples_are_counted_and_change_nothing(force: tuple[float, float, float], kind: str) -> None:
    run = navigator_at(20.0)
    before = run.solution()
    run.imu(21 * SECOND_NS, force, (0.0, 0.0, 0.0), received_ns=20 * SECOND_NS)
    after = run.solution()
    assert run.rejects[kind] == 1
    assert before and after and same(before, after)


def test_an_imu_clock_that_was_set_back_restarts_levelling_with_a_reason() -> None:
    run = navigator_at(10.0)
    for k in range(300):
        run.imu(SECOND_NS + k * 10_000_000, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0))
    assert run.counts.resets == 1
    assert run.phase is NavigationPhase.LEVELLING
    assert run.why[-1].code == Code.CLOCK_BACK


def without(events: list[Event], begin_s: float, end_s: float) -> list[Event]:
    return [e for e in events if not begin_s <= e.received_ns * 1e-9 < end_s]


def test_a_gap_of_half_a_second_is_bridged_and_added_to_the_covariance() -> None:
    run = feed(navigator(), without(samples(), 30.0, 30.5) + fixes())
    assert run.navigator.counts.imu_gaps == 1 and run.navigator.counts.resets == 0
    before = next(s for s in reversed(run.solutions) if s.time_ns < 30 * SECOND_NS)
    after = next(s for s in run.solutions if s.time_ns > 30.45 * SECOND_NS)
    assert after.velocity_cov[0, 0] > 10.0 * before.velocity_cov[0, 0]
    assert run.error_m() < 0.8


def test_after_a_gap_of_two_seconds_the_next_fix_starts_a_solution_with_the_kept_heading() -> None:
    run = feed(navigator(), without(samples(), 30.0, 32.0) + fixes())
    assert run.navigator.counts.imu_gaps == 1
    lost = [s for s in run.solutions if 32.0 < s.time_ns * 1e-9 < 32.05]
    assert not lost, "no solution until a fix was used"
    assert run.navigator.phase is NavigationPhase.NAVIGATING
    assert run.navigator.why[-1].code == Code.GAP
    assert run.navigator.why[-1].values["gap_s"] == pytest.approx(2.0, abs=0.05)
    assert run.error_m() < 1.5


def test_after_a_gap_of_three_minutes_levelling_restarts() -> None:
    run = navigator_at(20.0)
    run.imu(200 * SECOND_NS, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0))
    assert run.phase is NavigationPhase.LEVELLING
    assert run.solution() is None
    assert run.why[-1].code == Code.GAP and run.why[-1].values["gap_s"] == pytest.approx(180.0, abs=0.05)


def test_without_fixes_the_phase_is_coasting_and_the_error_within_four_sigma() -> None:
    run = feed(navigator(), samples() + without(fixes(), 25.0, 60.0))
    assert run.navigator.phase is NavigationPhase.COASTING
    assert run.navigator.since_ns * 1e-9 == pytest.approx(28.0, abs=0.2)
    assert run.last.gnss_age_s == pytest.approx(15.2, abs=0.3)
    sd = float(np.sqrt(run.last.position_cov[0, 0] + run.last.position_cov[1, 1]))
    assert run.error_m() < 4.0 * sd


@pytest.mark.parametrize(
    "sd", [(0.0, 0.0, 0.0), (1e30, 1e30, 1e30), (1e-30, 1.0, 1e5), None], ids=["zero", "huge", "mixed", "none"]
)
def test_any_stated_accuracy_leaves_the_covariance_finite_and_positive(sd: tuple[float, float, float] | None) -> None:
    run = feed(navigator(), samples(22.0) + fixes(22.0), position_sd=sd, velocity_sd=sd)
    assert np.isfinite(run.last.position_cov).all()
    assert np.linalg.eigvalsh(run.last.position_cov)[0] > 0.0
    assert np.isfinite(run.last.velocity).all()


def test_with_positions_alone_the_error_is_below_0_7_m() -> None:
    run = feed(navigator(), samples() + fixes(), no_velocity=True)
    assert {o.kind for o in run.outcomes} >= {AidingKind.GNSS_POSITION, AidingKind.ZERO_VELOCITY}
    assert AidingKind.GNSS_VELOCITY not in {o.kind for o in run.outcomes}
    assert run.error_m() < 0.7


def test_with_position_only_set_no_velocity_is_used() -> None:
    run = feed(navigator(**{"gnss.position_only": True}), samples(15.0) + fixes(15.0))
    assert AidingKind.GNSS_POSITION in {o.kind for o in run.outcomes}
    assert AidingKind.GNSS_VELOCITY not in {o.kind for o in run.outcomes}


def test_every_measurement_has_an_outcome() -> None:
    run = standard_run()
    used = [o for o in run.outcomes if o.kind is AidingKind.GNSS_POSITION and o.used]
    assert len(used) == run.navigator.counts.fixes_used - 1  # the first one initialised the filter
    assert {o.kind for o in run.outcomes} == {
        AidingKind.GNSS_POSITION,
        AidingKind.GNSS_VELOCITY,
        AidingKind.ZERO_VELOCITY,
        AidingKind.ZERO_ANGULAR_RATE,
        AidingKind.NON_HOLONOMIC,
    }
    assert all(o.used == (o.reason is None) == (o.weight > 0.0) for o in run.outcomes)
    assert all((o.weight == 1.0) == (o.test_ratio <= 1.0) for o in run.outcomes)


def test_a_jump_is_rejected_and_a_permanent_one_resets_the_filter_with_a_reason() -> None:
    jumped = [e for e in fixes() if e.received_ns > 25 * SECOND_NS]
    run = navigator_at(25.0)
    first = feed(run, samples()[2500:2800] + jumped[:10], shift=(500.0, 0.0, 0.0))
    assert run.counts.resets == 0
    assert first.error_m() < 1.0, "two seconds after the jump"
    last = feed(run, samples()[2800:] + jumped[10:], shift=(500.0, 0.0, 0.0))
    assert run.counts.resets == 1
    assert run.why[-1].code == Code.POSITIONS_REJECTED
    assert last.error_m() == pytest.approx(500.0, abs=2.0)


def test_a_covariance_that_is_not_finite_resets_the_filter_with_a_reason() -> None:
    run = feed(navigator(), samples(25.0) + fixes(24.0)).navigator  # with no fix left that leads back to a finite one
    engine = run.engine  # no input leads to such a covariance
    assert engine.filter is not None
    engine.filter.P = engine.filter.P * np.nan
    feed(run, samples()[2500:2510])
    assert run.solution() is None
    assert run.counts.resets == 1
    assert run.why[-1] == explain(Code.DIVERGED, cause="covariance")


def test_a_standstill_ends_within_50_ms_of_moving_off_and_velocity_errors_stay_below_0_2_m_s() -> None:
    """A zero-velocity update with a mean over seconds would continue while the vehicle moves off."""
    d = drive()
    run = standard_run()
    speed = np.hypot(d.velocity_n[:, 0], d.velocity_n[:, 1])
    start = int(np.argmax(speed > 0.1))
    standing = {round(s.time_ns / 1e7) - 1 for s in run.solutions if s.stationary}
    assert start - 50 in standing and start + 5 not in standing
    after = [s for s in run.solutions if start < round(s.time_ns / 1e7) - 1 < start + 400]
    errors = [hypot(*np.subtract(s.velocity, d.velocity_n[round(s.time_ns / 1e7) - 1])[:2]) for s in after]
    assert max(errors) < 0.2


def test_at_standstill_velocity_is_zero_and_the_gyroscope_bias_is_estimated() -> None:
    run = standard_until(15.0)
    assert run.last.stationary
    assert hypot(*run.last.velocity) < 0.01
    true_bias = (drive().rate_b - drive().ideal_rate_b)[:1500].mean(axis=0)
    assert run.last.gyroscope_bias == pytest.approx(true_bias, abs=2e-4)


def test_with_standstill_aiding_disabled_only_gnss_is_used() -> None:
    run = feed(navigator(**{"standstill.enabled": False}), samples(15.0) + fixes(15.0))
    assert {o.kind for o in run.outcomes} == {AidingKind.GNSS_POSITION, AidingKind.GNSS_VELOCITY}


def test_with_fixes_before_the_first_sample_the_error_is_below_half_a_metre() -> None:
    made = navigator()
    for k in range(5):
        give_fix(made, k, SECOND_NS + k * 200_000_000)
    run = feed(made, samples()[200:] + fixes()[12:])
    assert run.error_m() < 0.5


def test_a_fix_from_the_future_is_rejected() -> None:
    made = navigator()
    give_fix(made, 10, received_ns=0, stamp_offset_ns=10**15)
    assert made.rejects["measurement from the future"] == 2


def test_at_most_a_thousand_measurements_wait_for_inertial_samples() -> None:
    made = navigator()
    for k in range(1200):
        give_fix(made, 0, SECOND_NS + k)
    assert made.rejects["held without inertial samples"] == 2400 - 1000


def test_an_epoch_received_twice_is_used_once_and_counted() -> None:
    """The second one late; the first one of a stamp is used."""
    once = standard_until(22.0)
    twice = [Event(e.arrival_ns + 150_000_000, e.received_ns + 150_000_000, fix=e.fix) for e in fixes(21.0)]
    again = feed(navigator(), samples(22.0) + fixes(22.0) + twice)
    assert same(once.settled(), again.settled())
    again.navigator.finish()
    assert again.navigator.counts.epochs_repeated == 2 * len(twice)


def test_epochs_out_of_order_result_in_the_same_solution_and_are_counted() -> None:
    """Every tenth fix is half a second late, after two newer ones."""
    late = [replace(e, arrival_ns=e.arrival_ns + 500_000_000, received_ns=e.received_ns + 500_000_000)
            if e.fix is not None and e.fix % 10 == 0 else e for e in fixes(21.0)]  # fmt: skip
    in_order, swapped = feed(navigator(), samples(22.0) + fixes(21.0)), feed(navigator(), samples(22.0) + late)
    assert same(in_order.settled(), swapped.settled())
    assert swapped.navigator.measurements_late == 2, "the first position and velocity, for which the horizon waits then"
    assert in_order.navigator.measurements_late == 0


def test_fixes_two_seconds_late_are_used_with_default_settings() -> None:
    until_s = 20.0
    prompt = [Event(e.arrival_ns, e.received_ns, fix=e.fix) for e in fixes(until_s, delay_ns=0)]
    late = [replace(e, arrival_ns=e.arrival_ns + 2 * SECOND_NS, received_ns=e.received_ns + 2 * SECOND_NS)
            for e in prompt]  # fmt: skip
    end = samples(until_s + 2.3)
    in_time, afterwards = feed(navigator(), end + prompt), feed(navigator(), end + late)
    assert same(in_time.settled(), afterwards.settled()) and not afterwards.navigator.rejects


def hold(run: Navigator, begin_s: float, end_s: float, until_s: float, *, no_velocity: bool = False) -> Run:
    """Feed the drive; from one time to another the receiver repeats its fix with new stamps."""
    held = int(np.searchsorted(drive().fix_ns, begin_s * 1e9))
    events = samples(until_s)
    for k, event in enumerate(fixes(until_s)):
        inside = begin_s * 1e9 <= drive().fix_ns[k] < end_s * 1e9
        events.append(replace(event, repeats=held) if inside else event)
    return feed(run, events, no_velocity=no_velocity)


@pytest.mark.parametrize("no_velocity", [False, True])
def test_fixes_that_a_receiver_repeats_in_motion_are_not_used(no_velocity: bool) -> None:
    """For 4 s; used, they would add an error and then be rejected."""
    begin_s = float(drive().t_ns[np.argmax(np.hypot(*drive().velocity_n[:, :2].T) > 3.0)]) * 1e-9 + 1.0
    end_s = begin_s + 6.0
    found = hold(navigator(), begin_s, begin_s + 4.0, end_s, no_velocity=no_velocity)
    whole = feed(navigator(), samples(end_s) + fixes(end_s), no_velocity=no_velocity)
    assert found.navigator.counts.epochs_repeated >= (18 if no_velocity else 30)
    assert found.navigator.counts.resets == 0
    assert found.error_m() < whole.error_m() + 0.3


def test_fixes_that_a_receiver_repeats_at_standstill_are_used() -> None:
    """Static hold: the same position and a velocity of zero."""
    found = hold(navigator(), 2.0, 14.0, until_s=15.0)
    assert found.navigator.counts.epochs_repeated == 0 and found.navigator.counts.fixes_used > 40
