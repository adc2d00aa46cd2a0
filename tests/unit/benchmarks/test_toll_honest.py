"""The stored results of honest traffic, and the page that shows them."""

from benchmarks.v2x import honest
from benchmarks.v2x.honest import BEGIN, END, EXPLANATION, Result


def test_the_explanation_of_charging_shows_the_stored_results() -> None:
    shown = EXPLANATION.read_text(encoding="utf-8").split(BEGIN)[1].split(END)[0]
    assert shown == honest.table(honest.stored())


def test_nobody_is_charged_wrongly_or_free_in_the_stored_results_and_parts_are_added() -> None:
    for content in honest.stored().values():
        result = Result(**content["result"])
        assert result.wrong == result.double == result.free == 0
    both = Result(contracts=3, reasons={"a": 1}).plus(Result(contracts=1, reviews=2, reasons={"a": 1, "b": 1}))
    assert (both.contracts, both.reasons, both.review_share) == (4, {"a": 2, "b": 1}, 0.5)
    assert not Result(free=1).is_right
