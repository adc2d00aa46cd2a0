"""Weight cannot come back unseen: what a sample and a second cost may not grow by more than 3 % without a reason."""

import json

import pytest

from tests.support.weight import STORED, VERSION, Figures, measured

GROWTH = 1.03
LEAST = 0.5  # calls a sample, or messages and bytes a second, below which growth is no weight
CALLS = "calls per sample"
STORE = 'if it must be, store it with the reason: python -m tests.support.weight --store "..."'


@pytest.fixture(scope="module")
def figures() -> Figures:
    return measured()


@pytest.fixture(scope="module")
def stored() -> dict[str, Figures]:
    found: dict[str, Figures] = json.loads(STORED.read_text())
    return found


def grown(now: dict[str, float], before: dict[str, float]) -> list[str]:
    """Name every part that has grown, the sum first."""
    return [
        f"{part}: {value} instead of {before.get(part, 0.0)}"
        for part, value in now.items()
        if value > max(GROWTH * before.get(part, 0.0), before.get(part, 0.0) + LEAST)
    ]


def test_messages_and_bytes_on_the_bus_have_not_grown(figures: Figures, stored: dict[str, Figures]) -> None:
    before = next(iter(stored.values()))
    for kind in (kind for kind in figures if not kind.startswith(CALLS)):
        found = grown(figures[kind], before[kind])
        assert not found, f"{kind}: {found}; {STORE}"


def test_a_sample_calls_no_more_functions_than_before(figures: Figures, stored: dict[str, Figures]) -> None:
    if VERSION not in stored:
        pytest.skip(f"this machine has Python {VERSION}, for which no weight is stored; {STORE}")
    for kind in (kind for kind in figures if kind.startswith(CALLS)):
        found = grown({"sum": figures[kind]["sum"]}, stored[VERSION][kind])
        shares = grown(figures[kind], stored[VERSION][kind])
        assert not found, f"{kind}: {found}, of it {shares}; {STORE}"


def test_the_stored_weight_has_a_reason_and_is_of_all_hypotheses(stored: dict[str, Figures]) -> None:
    for version, row in stored.items():
        assert row["reason"], version
        assert row["calls per sample, with hypotheses"]["services/core/fusion"] > 0.0


def test_growth_of_3_percent_is_found_and_less_is_not() -> None:
    before = {"sum": 100.0, "shared": 10.0}
    assert not grown({"sum": 102.9, "shared": 5.0}, before)
    assert grown({"sum": 103.1, "shared": 10.0, "services/new": 3.0}, before) == [
        "sum: 103.1 instead of 100.0", "services/new: 3.0 instead of 0.0",
    ]  # fmt: skip
