import pytest

from shared.attacks import ATTACKS, BY_NAME, ScheduledAttack, schedule
from shared.messages.simulation import AttackName
from tests.support.cases import each


def test_every_attack_has_a_row_with_defaults_within_their_limits() -> None:
    assert [row.name for row in ATTACKS] == list(AttackName)
    for row in ATTACKS:
        assert all(parameter.least <= parameter.default <= parameter.greatest for parameter in row.parameters)
        assert row.complete({}) == row.defaults


def test_an_attack_is_read_from_its_notation() -> None:
    assert schedule("jam@5") == ScheduledAttack(AttackName.JAM, 5.0, None, BY_NAME[AttackName.JAM].defaults)
    found = schedule(" drag_off(accel=0.1, speed=1)@60:120 ")
    assert (found.attack, found.start_s, found.duration_s) == ("drag_off", 60.0, 120.0)
    assert found.parameters == {"acceleration": 0.1, "speed": 1.0, "direction": 0.0}


@each(
    ("text", "reason"),
    [
        ("drag_off", "write name@start, such as drag_off@60"),
        ("drog_off@60", "did you mean drag_off?"),
        ("x" * 10_000, "is no attack"),
        ("drag_off@soon", "the start .* must be a number, not 'soon'"),
        ("drag_off@nan", "start and duration must be 0 to 86400 s"),
        ("drag_off@60:-1", "start and duration must be 0 to 86400 s"),
        ("drag_off(speed)@60", "speed must be a number, not ''"),
        ("drag_off(speed=inf)@60", "speed must be 0.01 to 60 m/s"),
        ("drag_off(colour=1)@60", "has no parameter 'colour'; its parameters: acceleration, speed, direction"),
        ("delay(d=1)@60", "has no parameter 'd'; its parameters: distance, direction, delay"),
        ("freeze(speed=1)@60", "its parameters: none"),
    ],
)
def test_an_unknown_attack_is_an_error_that_lists_the_known_ones(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        schedule(text)
