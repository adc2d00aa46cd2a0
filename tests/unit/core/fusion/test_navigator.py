"""The navigator as a whole: late, doubled, missing and mad input, and what it says of itself."""

from dataclasses import dataclass, replace
from functools import cache
from math import degrees, hypot, radians

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.core.fusion.alignment.heading import Prior
from services.core.fusion.measurements.base import Outcome
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.solution import Solution
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference
from shared.messages.navigation import AidingKind, NavigationPhase

SECOND_NS = 1_000_000_000
DURATION_S = 40.0


@cache
def drive() -> Drive:
    """Forty seconds of the car park: 16 s or more of standstill, then corners."""
    return simulate("parking_lot", seed=2, duration_s=DURATION_S, epoch_s=0.2)


def navigator(**changes: object) -> Navigator:
    """Navigator that is level after two seconds and knows its heading."""
    d = drive()
    made = Navigator(
        Settings().with_values({"gnss.lever_arm_body_m": d.lever_arm_b, "alignment.levelling_s": 2.0, **changes})
    )
    made.use_prior(Prior(Geodetic(*d.position[0].tolist()), (1.0, 1.0, 2.0), float(d.attitude[0, 2]), radians(1.0)))
    return made


@dataclass
class Run:
    """What came of feeding a navigator."""

    navigator: Navigator
    solutions: list[Solution]
    outcomes: list[Outcome]

    @property
    def last(self) -> Solution:
        return self.solutions[-1]

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
    repeats: int | None = None  # the fix whose values it tells again


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


def test_a_drive_ends_where_it_ends() -> None:
    run = feed(navigator(), samples() + fixes())
    assert run.navigator.phase is NavigationPhase.NAVIGATING
    assert run.error_m() < 0.5
    assert degrees(abs(run.last.yaw - drive().attitude[-1, 2])) < 1.0
    counts = run.navigator.counts
    assert counts.fixes_used > 150 and counts.imu_gaps == 0 and counts.resets == 0


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(0, 49_000_000), min_size=200, max_size=200), st.integers(0, 49_000_000))
def test_the_order_of_arrival_does_not_matter(jitter_ns: list[int], sample_delay_ns: int) -> None:
    """Fixes and samples travel on topics of their own; the bus may delay any of them by less than the merge delay."""
    until_s = 5.0
    fixed, moved = fixes(until_s), samples(until_s)
    late = [Event(e.arrival_ns + jitter_ns[k], e.received_ns, fix=e.fix) for k, e in enumerate(fixed)]
    shifted = [Event(e.arrival_ns + sample_delay_ns, e.received_ns, e.sample) for e in moved]
    reference, other = feed(navigator(), moved + fixed), feed(navigator(), shifted + late)
    assert len(reference.solutions) > 100
    assert all(map(same, reference.solutions, other.solutions))
    assert reference.outcomes == other.outcomes
    assert reference.navigator.counts == other.navigator.counts


@pytest.mark.parametrize("offset_ns", [0, -3_000_000])
def test_a_late_fix_is_worth_as_much_as_one_in_time(offset_ns: int) -> None:
    """Fixes that come 0.7 s late lead, once they have come, to the same solution to the last bit."""
    until_s = 30.0
    prompt = [Event(e.arrival_ns, e.received_ns, fix=e.fix) for e in fixes(until_s, delay_ns=0)]
    late = [Event(e.arrival_ns, e.received_ns, fix=e.fix) for e in fixes(until_s, delay_ns=700_000_000)]
    end = samples(until_s + 0.9)
    in_time = feed(navigator(merge_delay_s=0.0), end + prompt, stamp_offset_ns=offset_ns)
    afterwards = feed(navigator(merge_delay_s=0.0), end + late, stamp_offset_ns=offset_ns)
    assert same(in_time.last, afterwards.last)
    assert in_time.navigator.counts == afterwards.navigator.counts


def test_fixes_that_were_held_up_together_lead_to_the_solution_of_fixes_in_time() -> None:
    in_time, held = feed(navigator(), samples(30.0) + fixes(29.5)).last, round(29.6 * SECOND_NS)
    late = [replace(e, arrival_ns=held, received_ns=held) if e.arrival_ns > 28 * SECOND_NS else e for e in fixes(29.5)]
    assert same(feed(navigator(), samples(30.0) + late).last, in_time)


def test_a_fix_stamped_ahead_of_the_samples_waits_for_them() -> None:
    """A receiver whose clock is ahead by 0.1 s, and the setting that says so."""
    ahead = feed(navigator(**{"gnss.delay_s": 0.1}), samples() + fixes(delay_ns=0), stamp_offset_ns=100_000_000)
    level = feed(navigator(), samples() + fixes(delay_ns=0))
    assert ahead.error_m() == pytest.approx(level.error_m(), abs=1e-3)


def test_a_fix_stamped_ahead_is_told_with_the_sample_that_passes_it() -> None:
    d, run = drive(), feed(navigator(merge_delay_s=0.0), samples(20.0) + fixes(19.5)).navigator
    give_fix(run, round(20.2 / 0.2), 20 * SECOND_NS)
    for i in range(2000, 2050):
        told = run.imu(int(d.t_ns[i]), d.force_b[i].tolist(), d.rate_b[i].tolist())
        if any(outcome.source == "gnss" for outcome in told):
            break
    assert 0 <= d.t_ns[i] - told[0].time_ns < 10_000_000 and len(told) == 2, "position and velocity"


@pytest.mark.parametrize("delay_ns", [80_000_000, 600_000_000])
def test_a_fix_that_comes_twice_and_late_is_told_once(delay_ns: int) -> None:
    """Also where both come at once."""
    once = feed(navigator(merge_delay_s=0.0), samples(20.0) + fixes(19.0))
    again = fixes(19.0) + fixes(19.0, delay_ns=delay_ns)
    twice = feed(navigator(merge_delay_s=0.0), samples(20.0) + again)
    told = [sum(outcome.source == "gnss" for outcome in run.outcomes) for run in (once, twice)]
    assert told[0] == told[1] and twice.navigator.counts.epochs_repeated > 50
    assert same(once.last, twice.last)


def test_stamps_below_zero_take_no_more_memory() -> None:
    begin_ns = -(2**60)
    d, run = drive(), navigator()
    for i, time_ns in enumerate(d.t_ns.tolist()):
        if i % 100 == 0:
            run.fix(begin_ns + time_ns, position=Geodetic(*d.position[i].tolist()), position_sd=(1.0, 1.0, 1.0))
        run.imu(begin_ns + time_ns, d.force_b[i].tolist(), d.rate_b[i].tolist())
    oosm = run._oosm
    assert run.counts.fixes_used > 30
    assert max(len(oosm._samples), 10 * len(oosm._snapshots), 10 * len(oosm._measurements)) < 400


def test_a_fix_older_than_the_memory_is_counted_and_dropped() -> None:
    run = feed(navigator(), samples(10.0) + fixes(10.0))
    give_fix(run.navigator, 0, 10 * SECOND_NS)
    feed(run.navigator, [Event(10_300_000_000, 10_300_000_000, 1005)])
    assert run.navigator.rejects["measurement older than the memory"] == 2  # its position and its velocity


def test_doubled_and_swapped_samples_are_dropped() -> None:
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
def test_impossible_samples_are_dropped(force: tuple[float, float, float], kind: str) -> None:
    run = feed(navigator(), samples(20.0) + fixes(20.0))
    before = run.navigator.solution()
    run.navigator.imu(21 * SECOND_NS, force, (0.0, 0.0, 0.0), received_ns=20 * SECOND_NS)
    after = run.navigator.solution()
    assert run.navigator.rejects[kind] == 1
    assert before and after and same(before, after)


def test_a_clock_that_was_set_back_begins_again_with_a_reason() -> None:
    run = feed(navigator(), samples(10.0) + fixes(10.0)).navigator
    for k in range(300):
        run.imu(SECOND_NS + k * 10_000_000, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0))
    assert run.counts.resets == 1
    assert run.phase is NavigationPhase.LEVELLING
    assert "clock went back" in run.reason


def without(events: list[Event], begin_s: float, end_s: float) -> list[Event]:
    return [e for e in events if not begin_s <= e.received_ns * 1e-9 < end_s]


def test_a_short_gap_of_samples_is_bridged_and_admitted() -> None:
    """Half a second of driving without samples: the solution goes on, and says that it is less certain."""
    run = feed(navigator(), without(samples(), 30.0, 30.5) + fixes())
    assert run.navigator.counts.imu_gaps == 1 and run.navigator.counts.resets == 0
    before = next(s for s in reversed(run.solutions) if s.time_ns < 30 * SECOND_NS)
    after = next(s for s in run.solutions if s.time_ns > 30.45 * SECOND_NS)
    assert after.velocity_cov[0, 0] > 10.0 * before.velocity_cov[0, 0]
    assert run.error_m() < 0.8


def test_after_a_longer_gap_the_next_fix_starts_again_from_the_heading_that_was() -> None:
    run = feed(navigator(), without(samples(), 30.0, 32.0) + fixes())
    assert run.navigator.counts.imu_gaps == 1
    lost = [s for s in run.solutions if 32.0 < s.time_ns * 1e-9 < 32.05]
    assert not lost, "no solution is given until a fix has come"
    assert run.navigator.phase is NavigationPhase.NAVIGATING
    assert "no inertial sample for 2.0 s" in run.navigator.reason
    assert run.error_m() < 1.5


def test_after_a_gap_of_minutes_levelling_begins_again() -> None:
    run = feed(navigator(), samples(20.0) + fixes(20.0)).navigator
    run.imu(200 * SECOND_NS, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0))
    assert run.phase is NavigationPhase.LEVELLING
    assert run.solution() is None
    assert "no inertial sample for 180.0 s" in run.reason


def test_without_fixes_the_solution_coasts_and_says_so() -> None:
    run = feed(navigator(), samples() + without(fixes(), 25.0, 60.0))
    assert run.navigator.phase is NavigationPhase.COASTING
    assert run.navigator.since_ns * 1e-9 == pytest.approx(28.0, abs=0.2)
    assert run.last.gnss_age_s == pytest.approx(15.2, abs=0.3)
    sd = float(np.sqrt(run.last.position_cov[0, 0] + run.last.position_cov[1, 1]))
    assert run.error_m() < 4.0 * sd


@pytest.mark.parametrize(
    "sd", [(0.0, 0.0, 0.0), (1e30, 1e30, 1e30), (1e-30, 1.0, 1e5), None], ids=["zero", "huge", "mixed", "none"]
)
def test_a_receiver_may_say_anything_of_its_precision(sd: tuple[float, float, float] | None) -> None:
    run = feed(navigator(), samples(30.0) + fixes(30.0), position_sd=sd, velocity_sd=sd)
    assert np.isfinite(run.last.position_cov).all()
    assert np.linalg.eigvalsh(run.last.position_cov)[0] > 0.0
    assert np.isfinite(run.last.velocity).all()


def test_a_receiver_without_velocity_is_enough() -> None:
    run = feed(navigator(), samples() + fixes(), no_velocity=True)
    assert {o.kind for o in run.outcomes} >= {AidingKind.GNSS_POSITION, AidingKind.ZERO_VELOCITY}
    assert AidingKind.GNSS_VELOCITY not in {o.kind for o in run.outcomes}
    assert run.error_m() < 0.7


def test_positions_alone_are_used_if_the_settings_say_so() -> None:
    run = feed(navigator(**{"gnss.position_only": True}), samples() + fixes())
    assert AidingKind.GNSS_VELOCITY not in {o.kind for o in run.outcomes}


def test_every_measurement_yields_an_outcome() -> None:
    run = feed(navigator(), samples() + fixes())
    used = [o for o in run.outcomes if o.kind is AidingKind.GNSS_POSITION and o.used]
    assert len(used) == run.navigator.counts.fixes_used - 1  # the first started the filter
    assert {o.kind for o in run.outcomes} == {
        AidingKind.GNSS_POSITION,
        AidingKind.GNSS_VELOCITY,
        AidingKind.ZERO_VELOCITY,
        AidingKind.ZERO_ANGULAR_RATE,
        AidingKind.NON_HOLONOMIC,
    }
    assert all(o.used == (o.reason is None) == (o.weight > 0.0) for o in run.outcomes)
    assert all((o.weight == 1.0) == (o.test_ratio <= 1.0) for o in run.outcomes)


def test_a_jump_is_refused_and_a_lasting_one_resets_with_its_reason() -> None:
    jumped = [e for e in fixes() if e.received_ns > 25 * SECOND_NS]
    run = feed(navigator(), samples(25.0) + fixes(25.0))
    first = feed(run.navigator, samples()[2500:2800] + jumped[:10], shift=(500.0, 0.0, 0.0))
    assert run.navigator.counts.resets == 0
    assert first.error_m() < 1.0, "a jump of two seconds is not followed"
    last = feed(run.navigator, samples()[2800:] + jumped[10:], shift=(500.0, 0.0, 0.0))
    assert run.navigator.counts.resets == 1
    assert "positions in a row rejected" in run.navigator.reason
    assert last.error_m() == pytest.approx(500.0, abs=2.0)


def test_numbers_that_break_down_reset_with_their_reason() -> None:
    """A measurement of nonsense reaches the filter past every door; the solution stops and says why."""
    run = feed(navigator(), samples(25.0) + fixes(24.0)).navigator
    engine = run.engine  # nothing that a caller does breaks the numbers down
    assert engine.filter is not None
    engine.filter.P = engine.filter.P * np.nan
    feed(run, samples()[2500:2510])
    assert run.solution() is None
    assert run.counts.resets == 1
    assert "covariance" in run.reason


def test_a_start_from_rest_is_not_held_back() -> None:
    """Freezing position and velocity while a mean over four seconds is slow would cost metres at every start."""
    d = drive()
    run = feed(navigator(), samples() + fixes())
    speed = np.hypot(d.velocity_n[:, 0], d.velocity_n[:, 1])
    start = int(np.argmax(speed > 0.1))
    standing = {round(s.time_ns / 1e7) - 1 for s in run.solutions if s.stationary}
    assert start - 50 in standing and start + 5 not in standing
    after = [s for s in run.solutions if start < round(s.time_ns / 1e7) - 1 < start + 400]
    errors = [hypot(*np.subtract(s.velocity, d.velocity_n[round(s.time_ns / 1e7) - 1])[:2]) for s in after]
    assert max(errors) < 0.2


def test_a_standstill_pins_velocity_and_learns_the_gyroscope() -> None:
    run = feed(navigator(), samples(15.0) + fixes(15.0))
    assert run.last.stationary
    assert hypot(*run.last.velocity) < 0.01
    true_bias = (drive().rate_b - drive().ideal_rate_b)[:1500].mean(axis=0)
    assert run.last.gyroscope_bias == pytest.approx(true_bias, abs=2e-4)


def test_standstill_aiding_can_be_switched_off() -> None:
    run = feed(navigator(**{"standstill.enabled": False}), samples(15.0) + fixes(15.0))
    assert {o.kind for o in run.outcomes} == {AidingKind.GNSS_POSITION, AidingKind.GNSS_VELOCITY}


def test_fixes_before_the_first_sample_do_no_harm() -> None:
    made = navigator()
    for k in range(5):
        give_fix(made, k, SECOND_NS + k * 200_000_000)
    run = feed(made, samples()[200:] + fixes()[12:])
    assert run.error_m() < 0.5


def test_a_fix_from_the_future_is_refused() -> None:
    made = navigator()
    give_fix(made, 10, received_ns=0, stamp_offset_ns=10**15)
    assert made.rejects["measurement from the future"] == 2


def test_measurements_without_samples_are_forgotten_at_last() -> None:
    made = navigator()
    for k in range(1200):
        give_fix(made, 0, SECOND_NS + k)
    assert made.rejects["held without inertial samples"] == 2400 - 1000


def test_an_epoch_told_twice_is_used_once_and_counted() -> None:
    """Also if the second comes late, and with other numbers: the first of a stamp counts."""
    once = feed(navigator(), samples(22.0) + fixes(22.0))
    twice = [Event(e.arrival_ns + 150_000_000, e.received_ns + 150_000_000, fix=e.fix) for e in fixes(21.0)]
    again = feed(navigator(), samples(22.0) + fixes(22.0) + twice)
    assert same(once.last, again.last)
    assert again.navigator.counts == once.navigator.counts._replace(epochs_repeated=2 * len(twice))
    assert again.navigator.measurements_late == 0, "newer stamps had not come yet"


def test_epochs_out_of_order_are_used_in_theirs_and_counted() -> None:
    """Every tenth fix comes half a second late, two others later than it was true."""
    late = [replace(e, arrival_ns=e.arrival_ns + 500_000_000, received_ns=e.received_ns + 500_000_000)
            if e.fix is not None and e.fix % 10 == 0 else e for e in fixes(21.0)]  # fmt: skip
    in_order, swapped = feed(navigator(), samples(22.0) + fixes(21.0)), feed(navigator(), samples(22.0) + late)
    assert same(in_order.last, swapped.last)
    assert swapped.navigator.measurements_late == 2 * sum(e.fix is not None and e.fix % 10 == 0 for e in late)
    assert in_order.navigator.measurements_late == 0


def test_a_fix_two_seconds_late_is_used_without_a_setting() -> None:
    until_s = 20.0
    prompt = [Event(e.arrival_ns, e.received_ns, fix=e.fix) for e in fixes(until_s, delay_ns=0)]
    late = [replace(e, arrival_ns=e.arrival_ns + 2 * SECOND_NS, received_ns=e.received_ns + 2 * SECOND_NS)
            for e in prompt]  # fmt: skip
    end = samples(until_s + 2.3)
    in_time, afterwards = feed(navigator(), end + prompt), feed(navigator(), end + late)
    assert same(in_time.last, afterwards.last) and not afterwards.navigator.rejects


def hold(run: Navigator, begin_s: float, end_s: float, until_s: float, *, no_velocity: bool = False) -> Run:
    """Feed the drive; from one time to another the receiver repeats its fix under new stamps."""
    held = int(np.searchsorted(drive().fix_ns, begin_s * 1e9))
    events = samples(until_s)
    for k, event in enumerate(fixes(until_s)):
        inside = begin_s * 1e9 <= drive().fix_ns[k] < end_s * 1e9
        events.append(replace(event, repeats=held) if inside else event)
    return feed(run, events, no_velocity=no_velocity)


@pytest.mark.parametrize("no_velocity", [False, True])
def test_a_fix_that_a_receiver_holds_while_the_vehicle_drives_is_left_out(no_velocity: bool) -> None:
    """The receiver holds for 4 s; without the rule its positions pull, and are then refused."""
    begin_s = float(drive().t_ns[np.argmax(np.hypot(*drive().velocity_n[:, :2].T) > 3.0)]) * 1e-9 + 1.0
    end_s = begin_s + 6.0
    found = hold(navigator(), begin_s, begin_s + 4.0, end_s, no_velocity=no_velocity)
    whole = feed(navigator(), samples(end_s) + fixes(end_s), no_velocity=no_velocity)
    assert found.navigator.counts.epochs_repeated >= (18 if no_velocity else 30)
    assert found.navigator.counts.resets == 0
    assert found.error_m() < whole.error_m() + 0.3


def test_a_receiver_that_repeats_itself_at_rest_is_believed() -> None:
    """Static hold: the same position and a velocity of zero for as long as the vehicle stands."""
    found = hold(navigator(), 2.0, 14.0, until_s=15.0)
    assert found.navigator.counts.epochs_repeated == 0 and found.navigator.counts.fixes_used > 40
