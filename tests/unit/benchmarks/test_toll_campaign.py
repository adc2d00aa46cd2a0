"""The stored result of the toll campaign, and the page that shows it."""

from benchmarks import toll_campaign
from benchmarks.toll_campaign import BEGIN, END, EXPLANATION, Result


def test_the_explanation_of_charging_shows_the_stored_campaign() -> None:
    shown = EXPLANATION.read_text(encoding="utf-8").split(BEGIN)[1].split(END)[0]
    assert shown == toll_campaign.table(toll_campaign.stored())


def test_parts_are_added_by_number_and_by_kind() -> None:
    one = Result(passages=3, decided=2, decided_uncharged={"void": 1}, kills_by_step={"ledger before COMMIT": 1})
    other = Result(passages=4, decided=2, kills_by_step={"ledger before COMMIT": 2}, reconciliation_exact=False)
    both = one.plus(other)
    assert (both.passages, both.decided_uncharged, both.kills_by_step) == (7, {"void": 1}, {"ledger before COMMIT": 3})
    assert both.charged_share_of_decided == 0.75
    assert not both.reconciliation_exact and not both.is_good
