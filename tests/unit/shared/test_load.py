"""Which work is paused and which inputs are skipped, by ticks and arrival stamps alone."""

from shared.load import CHECKS, ORDER, RELAPSE, RESUME_AFTER, RESUME_AFTER_MAX, SKIP_ABOVE_S, SKIP_UNTIL_S, Load
from shared.messages.operation import ProcessLoad

S = 1_000_000_000


def follow(load: Load, lags_s: list[float], start: int = 1000) -> list[ProcessLoad | None]:
    """One tick a second, and behind each an input with a lag."""
    told = []
    for k, lag_s in enumerate(lags_s):
        now_ns = (start + k) * S
        load.tick(now_ns)
        told.append(load.see(now_ns - round(lag_s * S)))
        assert load.see(now_ns + S // 2) is None, "only the first input after a tick is measured"
    return told


def paused(told: list[ProcessLoad | None]) -> list[int]:
    return [0 if process_load is None else len(process_load.paused) for process_load in told]


def test_a_process_that_keeps_up_says_so_once_and_pauses_nothing() -> None:
    told = follow(Load("core.fusion"), [0.05, 0.1, 0.3, 0.1, 0.0])
    assert told[0] is not None and told[0].paused == ()
    assert told[1] is None and told[3] is not None, "after a delay that was told its end is told"
    assert paused(told) == [0, 0, 0, 0, 0]


def test_no_lag_is_measured_without_inputs_so_that_silence_of_a_sensor_pauses_nothing() -> None:
    load = Load("core.fusion")
    for k in range(100):
        load.tick(k * S)
    told = load.see(99 * S + S // 10)
    assert told is not None and told.lag_s == 0.0 and not told.paused


def test_checks_are_paused_before_anything_else_and_all_work_with_a_larger_lag() -> None:
    told = follow(Load("core.fusion"), [0.6, 0.6, 0.1])
    assert told[0] is not None and told[0].paused == CHECKS
    assert told[1] is not None and told[1].paused == ORDER[: 2 * len(CHECKS)]
    assert paused(follow(Load("core.fusion"), [1.4])) == [len(ORDER)]


def test_work_is_resumed_after_ten_seconds_without_a_lag_and_later_after_a_relapse() -> None:
    load = Load("core.fusion")
    first = paused(follow(load, [0.6] + [0.05] * RESUME_AFTER))
    assert first[-2:] == [2, 0]
    second = paused(follow(load, [0.6] + [0.05] * RESUME_AFTER * 2, 1100))
    assert second[RESUME_AFTER] == 2 and second[-1] == 0
    for start in range(2000, 3000, 100):
        relapses = paused(follow(load, [0.6] + [0.05] * RESUME_AFTER_MAX, start))
    assert relapses[-2:] == [2, 0], "the wait has a largest length"
    follow(load, [0.05] * RELAPSE, 4000)
    assert paused(follow(load, [0.6] + [0.05] * RESUME_AFTER, 5000))[-1] == 0


def test_a_lag_between_both_limits_keeps_what_is_paused() -> None:
    assert paused(follow(Load("core.fusion"), [0.6] + [0.3] * 30))[-1] == 2


def test_inputs_are_skipped_only_after_everything_is_paused_and_up_to_a_recent_one() -> None:
    load = Load("core.fusion")
    follow(load, [3.0])
    assert not load.skips(0), "it may still catch up"
    follow(load, [3.0], 1001)
    now_ns = 1001 * S
    assert load.skips(now_ns - round((SKIP_UNTIL_S + 0.1) * S)) and load.skipped == 1
    assert not load.skips(now_ns - round((SKIP_UNTIL_S - 0.1) * S))
    catching_up = Load("core.fusion")
    follow(catching_up, [8.0, 6.0, 4.0, 2.0, 0.1])
    assert not catching_up.skips(0)
    held = Load("core.fusion")
    follow(held, [SKIP_ABOVE_S - 0.1] * 10)
    assert not held.skips(0)
