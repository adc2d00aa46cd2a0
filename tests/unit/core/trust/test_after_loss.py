"""A loss of GNSS with interference, and one without."""

from services.core.trust.after_loss import AGREEMENT_S, InterferenceLoss
from services.core.trust.facts import SECOND_NS, Facts, Monitor, Solution, Statement
from services.core.trust.readmission import Judgement
from shared.messages.trust import Outcome

NOTHING = Judgement(accused=False, decided=False, contradicted=True, agrees=True, suspect_since_ns=None)


def at(now_s: int, gnss_age_s: float, *tests: str, excluded: bool = False) -> Facts:
    now_ns = now_s * SECOND_NS
    outcome = Outcome.ACCUSES if tests else Outcome.PASS
    evidence = Statement(Monitor.EVIDENCE, outcome, now_ns, "", ("gnss",) if tests else (), accusing_tests=tests)
    solution = Solution(now_ns, True, "navigating", 3.0, 5.0, gnss_age_s)
    return Facts(now_ns, solution, {Monitor.EVIDENCE: evidence}, gnss_excluded=excluded)


def test_a_loss_with_interference_opens_a_conflict_at_the_last_position_and_holds_it_open() -> None:
    loss = InterferenceLoss()
    loss.update(at(100, 0.2))
    loss.update(at(104, 4.0, "gain"))
    assert loss.since_ns == 100 * SECOND_NS
    first, second = loss.judged(NOTHING), loss.judged(NOTHING)
    assert first.accused and first.suspect_since_ns == 100 * SECOND_NS and first.within_s == AGREEMENT_S
    assert not second.accused and not second.contradicted and second.agrees
    loss.end()
    assert loss.judged(NOTHING) is NOTHING


def test_evidence_within_10_s_after_the_return_is_of_the_loss_and_later_one_is_not() -> None:
    for later_s, flag in ((5, True), (12, False)):
        loss = InterferenceLoss()
        for k in range(12):
            loss.update(at(100 + k, float(k)))
        for k in range(12, 12 + later_s):
            loss.update(at(100 + k, 0.2))
        loss.update(at(112 + later_s, 0.2, "clock"))
        assert (loss.since_ns is not None) is flag


def test_a_tunnel_time_tests_interference_without_a_loss_and_an_exclusion_open_nothing() -> None:
    loss = InterferenceLoss()
    for facts in (at(10, 60.0), at(20, 60.0, "gnss_time"), at(31, 0.2, "gain")):
        if facts.solution is not None and facts.solution.gnss_age_s == 0.2:
            loss = InterferenceLoss()
        loss.update(facts)
        assert loss.since_ns is None
    loss.update(at(40, 20.0, "gain", excluded=True))
    assert loss.since_ns is None
