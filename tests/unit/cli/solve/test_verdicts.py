"""Seconds by verdict, and exclusions of GNSS, from what core.trust and core.fusion publish."""

import numpy as np
import pytest

from cli.solve.verdicts import VerdictLog
from shared.messages.navigation import NavigationPhase, NavigationState
from shared.messages.trust import TrustLevel, TrustState

S = 1_000_000_000
FIRST_NS = 1_000 * S


def state(second: float, level: TrustLevel, *, gnss: bool = False, odometer: bool = False) -> TrustState:
    return TrustState(
        sampled_ns=FIRST_NS + round(second * S), state=level, since_ns=0, row=1, reasons=("made",),
        gnss_excluded=gnss, odometer_excluded=odometer, alert_limit_horizontal_m=10.0, alert_limit_vertical_m=20.0,
    )  # fmt: skip


def navigation(*, since_ns: int | None = None, odometer: bool = False) -> NavigationState:
    return NavigationState(
        sampled_ns=FIRST_NS, phase=NavigationPhase.NAVIGATING, since_ns=0, reason="", fixes_used=0, fixes_rejected=0,
        samples_used=0, samples_rejected=0, imu_gaps=0, resets=0, gnss_excluded_since_ns=since_ns,
        odometer_excluded=odometer,
    )  # fmt: skip


def log_of(*messages: TrustState | NavigationState) -> VerdictLog:
    log = VerdictLog()
    for message in messages:
        log.add(message)
    return log


def test_each_verdict_holds_until_the_next_and_the_last_until_the_last_input() -> None:
    log = log_of(
        state(2, TrustLevel.INITIALISING), state(3, TrustLevel.CAUTION), state(4, TrustLevel.CAUTION),
        state(4.5, TrustLevel.UNSAFE, gnss=True), state(5, TrustLevel.DEAD_RECKONING, gnss=True),
        state(6, TrustLevel.SAFE),
    )  # fmt: skip
    found = log.verdicts(FIRST_NS, FIRST_NS + 7 * S)
    assert found.seconds(FIRST_NS) == pytest.approx(
        {"safe": 1.0, "caution": 1.5, "unsafe": 0.5, "dead_reckoning": 1.0, "no_fix": 0.0, "initialising": 3.0}
    )
    assert found.seconds(FIRST_NS + 5 * S + S // 2) == pytest.approx(
        {"safe": 1.0, "caution": 0.0, "unsafe": 0.0, "dead_reckoning": 0.5, "no_fix": 0.0, "initialising": 0.0}
    )
    assert found.excluded_s() == pytest.approx(1.5)
    assert found.exclusions() == [(FIRST_NS + 4 * S + S // 2, FIRST_NS + 6 * S)]
    stamps = FIRST_NS + np.array([-1, 0, 3, 4, 6, 9]) * S
    assert found.at(stamps) == ["initialising", "initialising", "caution", "caution", "safe", "safe"]


def test_in_a_gap_of_all_inputs_the_verdict_is_no_fix_after_two_seconds() -> None:
    found = log_of(state(0, TrustLevel.SAFE), state(17, TrustLevel.SAFE)).verdicts(FIRST_NS, FIRST_NS + 18 * S)
    seconds = found.seconds(FIRST_NS)
    assert seconds[TrustLevel.SAFE] == pytest.approx(3.0) and seconds[TrustLevel.NO_FIX] == pytest.approx(15.0)


def test_a_tick_behind_the_last_verdict_and_verdicts_outside_the_inputs_take_no_time() -> None:
    log = log_of(state(-1, TrustLevel.CAUTION), state(1, TrustLevel.SAFE), state(0.9, TrustLevel.UNSAFE))
    found = log.verdicts(FIRST_NS, FIRST_NS + 2 * S)
    assert sum(found.seconds(FIRST_NS).values()) == pytest.approx(2.0)
    assert found.seconds(FIRST_NS)[TrustLevel.UNSAFE] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("message", "excluded"),
    [
        (state(1, TrustLevel.SAFE), False),
        (state(1, TrustLevel.UNSAFE, gnss=True), True),
        (state(1, TrustLevel.CAUTION, odometer=True), True),
        (navigation(), False),
        (navigation(since_ns=FIRST_NS), True),
        (navigation(odometer=True), True),
    ],
)
def test_any_exclusion_is_noticed(message: TrustState | NavigationState, excluded: bool) -> None:
    assert log_of(message).excluded is excluded
