"""A worse verdict acts at once, a better one has to last, and limits are left lower than they are entered."""

from dataclasses import replace

import pytest

from services.core.trust.codes import Code
from services.core.trust.facts import SECOND_NS, Facts, Monitor
from services.core.trust.steady import DURATION_S, VerdictHysteresis
from services.core.trust.verdict import verdict
from shared.messages.trust import TrustLevel
from tests.unit.core.trust.test_verdict import SAFE as FACTS
from tests.unit.core.trust.test_verdict import levels

UNSAFE, CAUTION, SAFE = TrustLevel.UNSAFE, TrustLevel.CAUTION, TrustLevel.SAFE


def at(facts: Facts, time_s: float) -> Facts:
    """The same facts at another time, nothing of them older."""
    moved_ns = round(time_s * SECOND_NS)
    assert facts.solution is not None
    return replace(
        facts,
        time_ns=facts.time_ns + moved_ns,
        solution=replace(facts.solution, sampled_ns=facts.solution.sampled_ns + moved_ns),
        statements={
            m: replace(statement, stated_ns=statement.stated_ns + moved_ns) for m, statement in facts.statements.items()
        },
    )


def with_level(horizontal_m: float) -> Facts:
    """Facts of a position that is SAFE but for its horizontal level."""
    return levels(horizontal_m, 5.0)


def states(levels_m: list[float], step_s: float = 1.0) -> list[TrustLevel]:
    """Verdicts of a horizontal level over time, with an alert limit of 10 m."""
    steady = VerdictHysteresis()
    return [steady.after(at(with_level(level_m), k * step_s)).state for k, level_m in enumerate(levels_m)]


def test_what_is_worse_acts_at_once_and_what_is_better_after_it_has_lasted() -> None:
    assert states([5.0, 11.0, 5.0, 5.0, 5.0, 5.0]) == [SAFE, UNSAFE, UNSAFE, UNSAFE, UNSAFE, SAFE]
    assert states([5.0, 9.0, 11.0, 5.0, 5.0, 5.0, 5.0])[1:3] == [CAUTION, UNSAFE]


def test_a_better_verdict_that_is_interrupted_begins_to_last_again() -> None:
    found = states([11.0, 5.0, 5.0, 11.0, 5.0, 5.0, 5.0, 5.0])
    assert found == [*[UNSAFE] * 7, SAFE]


@pytest.mark.parametrize(("level_m", "before_m", "state"), [
    (9.6, 11.0, UNSAFE), (9.4, 11.0, CAUTION), (7.7, 9.0, CAUTION), (7.4, 9.0, SAFE), (7.7, 11.0, SAFE),
])  # fmt: skip
def test_a_limit_is_left_at_a_smaller_share(level_m: float, before_m: float, state: TrustLevel) -> None:
    assert states([before_m, *[level_m] * 5])[-1] is state


def test_no_verdict_is_ever_better_than_that_of_its_facts() -> None:
    steady = VerdictHysteresis()
    for k, level_m in enumerate([5.0, 7.0, 9.0, 7.8, 11.0, 9.7, 9.0, 7.9, 7.0, 6.0] * 5):
        facts = at(with_level(level_m), 0.7 * k)
        order = (UNSAFE, CAUTION, SAFE)
        assert order.index(steady.after(facts).state) <= order.index(verdict(facts).state)


def test_it_says_what_it_waits_for_and_shows_no_figure_of_a_narrower_limit() -> None:
    steady = VerdictHysteresis()
    steady.after(with_level(11.0))
    waiting = steady.after(at(with_level(5.0), 1.0))
    assert waiting.row == 3
    assert [reason.code for reason in waiting.reasons][-1] == Code.HAS_TO_LAST
    assert waiting.reasons[-1].values == {"state": "safe", "lasts_s": DURATION_S}
    near = steady.after(at(with_level(9.6), 2.0)).reasons[0]
    assert near.code == Code.LEVEL_HAS_TO_FALL and near.values["limit_m"] == pytest.approx(10.0)


def test_a_first_position_and_one_after_a_loss_are_shown_at_once() -> None:
    steady, lost = VerdictHysteresis(), replace(FACTS, solution=None)
    assert steady.after(lost).state is TrustLevel.INITIALISING
    assert steady.after(at(FACTS, 0.1)).state is SAFE
    assert Monitor.MOTION in FACTS.statements


def test_the_worst_of_what_is_better_is_given_first() -> None:
    """UNSAFE, then CAUTION for most of three seconds and SAFE at their end: CAUTION, and SAFE three seconds later."""
    assert states([11.0, 9.0, 9.0, 9.0, 5.0, 5.0, 5.0, 5.0, 5.0])[4:] == [CAUTION, CAUTION, CAUTION, CAUTION, SAFE]
