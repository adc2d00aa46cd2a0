"""What the JSON of `obu demo --role rsu` says of the reconciliation."""

import pytest

from cli.demo.plaza_balance import Accounts, PlazaBalance
from shared.messages.toll import LaneBalance, LedgerState

LANE = LaneBalance(lane="n1", hour_ns=0, detections=9, charged=5, pending=2, provisional=7)


@pytest.mark.parametrize(
    ("changes", "agree"),
    [
        ({}, None),
        ({"provisional": 6}, True),
        ({"provisional": 6, "agrees": False}, False),
        ({"agrees": False}, False),
        ({"detections": 0, "pending": 0, "provisional": 0}, None),
    ],
)
def test_accounts_agree_only_where_a_detection_is_closed(changes: dict[str, int], agree: bool | None) -> None:
    assert Accounts.of([LANE.model_copy(update=changes)]).agree is agree


def test_the_summary_says_what_is_pending_held_in_review_and_unconfirmed() -> None:
    balance = PlazaBalance()
    before = balance.summary(1, 1, 0)
    assert (before.accounts_agree, before.accounts_pending) == (None, 0)
    state = LedgerState(now_ns=1, plaza="p", lanes=(LANE,), held=3, in_review=2, unconfirmed=1)
    balance.add("ledger/state", state, 1)
    found = balance.summary(1, 1, 0)
    assert (found.accounts_agree, found.accounts_closed) == (None, 0)
    assert (found.accounts_provisional, found.accounts_pending) == (7, 2)
    assert (found.held, found.in_review, found.unconfirmed) == (3, 2, 1)
