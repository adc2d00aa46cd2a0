from itertools import permutations

import pytest

from shared.chosen import SILENT_NS, ChosenSource

NAMES = ("can0/j1939/00", "can0/j1939/0B", "can1/obd")
STEP_NS = 100_000_000


@pytest.mark.parametrize("order", list(permutations(NAMES)))
def test_the_choice_does_not_depend_on_who_was_heard_first(order: tuple[str, ...]) -> None:
    chosen = ChosenSource()
    heard = [(name, k * STEP_NS) for k in range(1, 10) for name in order]
    used = [name for name, at_ns in heard if chosen.takes(name, at_ns)]
    assert set(used[3:]) == {"can0/j1939/00"} and chosen.current(9 * STEP_NS) == "can0/j1939/00"


def test_another_device_takes_the_place_of_one_that_is_silent_and_gives_it_back() -> None:
    chosen = ChosenSource()
    assert chosen.takes("a", 0) and not chosen.takes("b", SILENT_NS)
    assert chosen.current(SILENT_NS + 1) is None
    assert chosen.takes("b", SILENT_NS + 1) and chosen.current(SILENT_NS + 1) == "b"
    assert chosen.takes("a", SILENT_NS + 2) and not chosen.takes("b", SILENT_NS + 3)
