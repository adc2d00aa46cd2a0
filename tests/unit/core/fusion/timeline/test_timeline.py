"""The timeline: what it tells depends on stamps and arrival stamps alone, and late measurements lose nothing."""

from collections.abc import Sequence
from functools import cache
from random import Random

import numpy as np
import pytest
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st

from services.core.fusion.inertial import error_model as em
from services.core.fusion.timeline.events import GnssExcluded
from services.core.fusion.timeline.horizon import STEPS_NS
from services.core.fusion.timeline.timeline import Timeline
from tests.support.drives.on_time import (
    BEGIN_S,
    END_S,
    SAMPLE_DELAY_NS,
    SECOND_NS,
    Delivery,
    TimelineRun,
    contents,
    differences,
    epochs,
    fix,
    play,
    samples,
    speed,
    speed_at,
    wheel_stamps,
)
from tests.support.drives.on_time import settings as settings_of_drive

WITHOUT_SHRINKING = Phase.explicit, Phase.reuse, Phase.generate  # a failing example of a drive is found in no time
MS = 1_000_000
ALLOWANCE_NS = round(settings_of_drive().merge_delay_s * SECOND_NS)
HISTORY_NS = round(settings_of_drive().history_s * SECOND_NS)
STEP_NS = 100 * MS  # of the horizon
LATENCY_NS, SPEED_LATENCY_NS = 80 * MS, 10 * MS
MIDDLE = epochs(BEGIN_S + 3.0, END_S - 3.0)


def prompt(end_s: float = END_S, *, gnss_until_s: float = END_S) -> list[Delivery]:
    """All measurements with small delays."""
    fixes = [fix(k, LATENCY_NS) for k in epochs(end_s=min(end_s, gnss_until_s))]
    return fixes + [speed(k, SPEED_LATENCY_NS) for k in wheel_stamps(end_s=end_s)]


@cache
def in_time() -> TimelineRun:
    return play(prompt())


def settled(played: TimelineRun) -> object:
    """State once all has been used."""
    played.timeline.finish()
    return contents(played.timeline.engine)


@cache
def in_time_finished() -> Timeline:
    timeline = play(prompt()).timeline
    timeline.finish()
    return timeline


@cache
def in_time_settled() -> object:
    return contents(in_time_finished().engine)


@cache
def scattered(seed: int) -> tuple[tuple[int, int], ...]:
    """Kind and index of measurements that arrive out of sequence, by more and more: the lag grows on the way."""
    rng = np.random.default_rng(seed)
    places = epochs(), wheel_stamps()
    scatter = [np.linspace(0.0, 1.0, len(k)) ** 2 * rng.integers(0, 450 * MS, len(k)) for k in places]
    fixes = [(int(late), k) for k, late in zip(places[0], scatter[0], strict=True)]
    return tuple(fixes + [(-int(late) - 1, k) for k, late in zip(places[1], scatter[1], strict=True)])


def scattered_deliveries(seed: int, after_ns: Sequence[int]) -> list[Delivery]:
    """Those measurements, each reaching the timeline some time after its arrival at the driver."""
    made = []
    for (late_ns, k), after in zip(scattered(seed), after_ns, strict=True):
        made.append(fix(k, late_ns, after) if late_ns >= 0 else speed(k, -late_ns - 1, after))
    return made


@cache
def scattered_run(seed: int) -> TimelineRun:
    return play(scattered_deliveries(seed, [0] * len(scattered(seed))))


@settings(max_examples=6, deadline=None, phases=WITHOUT_SHRINKING)
@given(st.randoms(use_true_random=False), st.integers(0, 1000))
def test_any_order_in_which_measurements_reach_the_timeline_gives_the_same_bytes(random: Random, seed: int) -> None:
    """Their stamps are out of sequence, by up to 0.45 s, and so is what the bus makes of their arrival."""
    count = len(scattered(seed))
    jitter = [random.randrange(ALLOWANCE_NS - SAMPLE_DELAY_NS) for _ in range(count)]
    deliveries = scattered_deliveries(seed, jitter)
    random.shuffle(deliveries)
    reference, other = scattered_run(seed), play(deliveries)
    by_arrival = sorted(deliveries, key=lambda d: d.received_ns)
    assert [d.time_ns for d in by_arrival] != sorted(d.time_ns for d in deliveries), "out of sequence"
    assert len(reference.published) > 60 and differences(reference.published, other.published) == []
    assert len(reference.outcomes) > 100 and differences(reference.outcomes, other.outcomes) == []
    assert reference.lags_ns == other.lags_ns


LATENESS = st.integers(2 * SPEED_LATENCY_NS, HISTORY_NS - STEP_NS - 10 * MS)


@settings(max_examples=6, deadline=None, phases=WITHOUT_SHRINKING)
@given(st.dictionaries(st.sampled_from(MIDDLE), LATENESS, min_size=1, max_size=3))
@example({MIDDLE[6]: 900 * MS, MIDDLE[7]: 1_500 * MS})  # one after the other behind the same snapshot
def test_late_measurements_end_in_the_state_of_those_in_time_to_the_last_bit(late_ns: dict[int, int]) -> None:
    """Of measurements with one stamp the first received is used first; so the late ones are later than their speeds."""
    moved = {fix(k, 0).time_ns for k in late_ns}
    others = [d for d in prompt() if d.time_ns not in moved or len(d.measurements) == 1]
    played = play([*others, *(fix(k, late) for k, late in late_ns.items())])
    before_ns, behind = least_step(LATENCY_NS), 0
    raised = [before_ns]
    for _, late in sorted(late_ns.items(), key=lambda pair: (fix(*pair).received_ns, fix(*pair).time_ns)):
        # Horizon and arrival move in steps: within one of them a fix may be behind the one and not behind the other.
        behind += late + ALLOWANCE_NS > raised[-1] + STEP_NS + 30 * MS
        raised += [least_step(late)] if least_step(late) > raised[-1] else []
    assert set(played.lags_ns) <= set(raised) and played.lags_ns[-1] == raised[-1]
    assert played.timeline.measurements_late >= 2 * behind, "velocity and position of each"
    assert differences(settled(played), in_time_settled()) == []


def least_step(late_ns: int) -> int:
    """Lag that holds a delay."""
    return min(step for step in STEPS_NS if step >= late_ns + ALLOWANCE_NS)


def test_a_measurement_of_the_instant_of_a_snapshot_is_not_part_of_it() -> None:
    snapshot_ns = in_time_finished().verdicts.main.before(round(19.5 * SECOND_NS)).time_ns
    told = [speed_at(snapshot_ns, 5.0, late_ns) for late_ns in (SPEED_LATENCY_NS, 1_200 * MS)]
    in_time, late = (play([*prompt(), delivery]) for delivery in told)
    assert late.timeline.measurements_late == 1
    assert differences(settled(late), settled(in_time)) == []
    assert differences(settled(late), in_time_settled()) != []


def test_a_measurement_older_than_the_history_is_left_out_and_does_not_raise_the_lag() -> None:
    late = MIDDLE[0]
    others = [d for d in prompt() if d.time_ns != fix(late, 0).time_ns or len(d.measurements) == 1]
    played = play([*others, fix(late, HISTORY_NS + ALLOWANCE_NS)])
    assert played.lags_ns == in_time().lags_ns
    assert differences(settled(played), settled(play(others))) == []


def test_the_solution_is_that_of_the_newest_sample_whatever_the_lag() -> None:
    late = [fix(k, 1_300 * MS) for k in epochs()]
    played = play([*late, *(speed(k, SPEED_LATENCY_NS) for k in wheel_stamps())], every=1)
    assert played.lags_ns[-1] == 1_500 * MS
    stamps = {told[:40]: told for told in played.published}
    now_and_then = play([*late, *(speed(k, SPEED_LATENCY_NS) for k in wheel_stamps())])
    assert len(stamps) == len(played.published) > 500
    assert all(stamps[told[:40]] == told for told in now_and_then.published), "however often it is asked for"
    newest = [f'"sampled_ns":{sample.time_ns},'.encode() for sample in samples()][-len(played.published) :]
    assert all(stamp in told for stamp, told in zip(newest, played.published, strict=True))


@pytest.mark.parametrize("seed", [0, 1])
def test_forks_and_predictions_change_nothing_of_what_they_start_from(seed: int) -> None:
    rng = np.random.default_rng(seed)
    played = play(prompt(), samples(end_s=BEGIN_S + 6.0 + rng.random()))
    timeline, cursor = played.timeline, played.timeline.verdicts.main
    before = contents(cursor.engine), contents([*cursor._snapshots])
    for since_s in rng.uniform(BEGIN_S + 2.0, BEGIN_S + 6.0, 3).tolist():
        since_ns = round(since_s * SECOND_NS)
        forked = cursor.fork(since_ns, (GnssExcluded(since_ns + 1, since_ns),))
        forked.advance(timeline.log, timeline.newest_ns)
        assert contents(forked.engine) != before[0]
    ahead = timeline.now
    assert ahead.time_ns > cursor.engine.time_ns and contents(ahead) != before[0]
    ahead.attempt(lambda navigation: navigation.inflate(attitude_sd=0.1, velocity_sd=1.0))
    assert (contents(cursor.engine), contents([*cursor._snapshots])) == before


@pytest.mark.parametrize("since_s", [17.5, 18.5, 20.3])
def test_a_fork_that_leaves_gnss_out_is_a_timeline_that_has_received_none_since(since_s: float) -> None:
    """To the last bit without GNSS in the log; what is left out is compared, and there P takes two steps for one."""
    timeline, since_ns = in_time_finished(), round(since_s * SECOND_NS)
    cursor = timeline.verdicts.main
    snapshot_ns = cursor.before(since_ns).time_ns
    without = play(prompt(gnss_until_s=snapshot_ns / SECOND_NS)).timeline
    without.finish()
    plain = cursor.fork(since_ns)
    plain.advance(without.log, timeline.newest_ns)
    assert differences(contents(plain.engine), contents(without.engine)) == []
    excluding = cursor.fork(since_ns, (GnssExcluded(snapshot_ns + 1, snapshot_ns),))
    excluding.advance(timeline.log, timeline.newest_ns)
    ours, theirs = excluding.engine.filter, without.engine.filter
    assert ours is not None and theirs is not None and ours.time_ns == theirs.time_ns == timeline.newest_ns
    assert ours.P.diagonal() == pytest.approx(theirs.P.diagonal(), rel=1e-3)
    sd = np.sqrt(theirs.P.diagonal())[em.VELOCITY]
    assert np.abs(np.subtract(ours.velocity, theirs.velocity) / sd).max() < 1e-3
    assert excluding.engine.accepted_ns == without.engine.accepted_ns and excluding.engine.exclusions.fixes > 15
