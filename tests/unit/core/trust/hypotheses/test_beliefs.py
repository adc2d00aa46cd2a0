"""Posteriors: who explains what the monitors say, bounds of one monitor, survival and action."""

from dataclasses import replace
from math import exp

import pytest

from services.core.trust.codes import Code
from services.core.trust.facts import SECOND_NS, Facts, Monitor, Posterior, Statement
from services.core.trust.hypotheses.beliefs import CERTAIN_PROBABILITY, Beliefs, suspected_priors
from services.core.trust.hypotheses.evidence import FALSE_ALARM, MAX_LOG_LIKELIHOOD, Evidence, explained_by
from services.core.trust.hypotheses.priors import PRIOR, SUSPECTED
from shared.messages.explanation import explain
from shared.messages.trust import Hypothesis, Outcome
from shared.words.words import words
from tests.support.cases import each

H = Hypothesis
EITHER, SPEEDS = ("gnss", "imu"), ("gnss", "odometer")


def statement(monitor: Monitor, accused: tuple[str, ...] = (), *, tests: tuple[str, ...] = ()) -> Statement:
    outcome = Outcome.ACCUSES if accused else Outcome.PASS
    return Statement(monitor, outcome, 0, "", accused, window_s=5.0, accusing_tests=tests)


def after(seconds: int, said: dict[Monitor, tuple[str, ...] | None], *, odometer: bool = True) -> dict[H, Posterior]:
    """Posteriors after some seconds of the same statements; None of a monitor that is not evaluated."""
    return updated(Beliefs(), seconds, said, odometer=odometer)


def updated(
    beliefs: Beliefs, seconds: int, said: dict[Monitor, tuple[str, ...] | None], *, odometer: bool = True
) -> dict[H, Posterior]:
    """Posteriors of beliefs after the same."""
    found = tuple[Posterior, ...]()
    for k in range(1, seconds + 1):
        now_ns = k * SECOND_NS
        statements = {
            monitor: replace(statement(monitor, accused), stated_ns=now_ns, suspect_since_ns=now_ns - 7 * SECOND_NS)
            for monitor, accused in said.items()
            if accused is not None
        }
        found = beliefs.update(Facts(now_ns, None, statements, odometer_in_use=odometer), ())
    return {posterior.hypothesis: posterior for posterior in found}


def test_one_that_alone_survives_is_acted_on_from_a_probability_of_0_99() -> None:
    """What is excluded by mistake costs more than what is excluded late."""
    shares = []
    for weight in range(0, 200):
        beliefs = Beliefs()
        beliefs._since_ns[H.GNSS], beliefs._earlier[H.GNSS] = 0, 0.1 * weight
        found = {posterior.hypothesis: posterior for posterior in beliefs.update(Facts(SECOND_NS), (H.GNSS,))}[H.GNSS]
        shares.append(found.probability)
        assert found.acted_on is (found.probability > 0.99)
    assert sum(0.9 < share < 0.99 for share in shares) > 5


ALL_PASS: dict[Monitor, tuple[str, ...] | None] = dict.fromkeys(Monitor, ())
CASES = [
    pytest.param({Monitor.INERTIAL_SHORT: EITHER}, {H.GNSS, H.IMU}, None, id="one difference says the same of both"),
    pytest.param({Monitor.INERTIAL_SHORT: EITHER, Monitor.MOTION_FAST: SPEEDS}, {H.GNSS}, H.GNSS, id="drag along"),
    pytest.param({Monitor.INERTIAL_SHORT: EITHER, Monitor.GYROSCOPE: ("imu",)}, {H.IMU, H.GNSS_AND_ODOMETER}, None,
                 id="gyroscope, or course and wheels alike"),
    pytest.param({Monitor.MOTION_FAST: SPEEDS, Monitor.HYPOTHESES: ("odometer",)}, {H.ODOMETER}, H.ODOMETER,
                 id="odometer against inertial sensors alone"),
    pytest.param({Monitor.MOTION_FAST: SPEEDS, Monitor.HYPOTHESES: ("gnss",), Monitor.INERTIAL_LONG: None},
                 {H.GNSS}, H.GNSS,
                 id="GNSS against inertial sensors alone"),
    pytest.param({Monitor.INERTIAL_SHORT: EITHER, Monitor.COHERENT_SCALE: SPEEDS}, {H.GNSS_AND_ODOMETER, H.IMU}, None,
                 id="falsified alike, or the scale of the inertial sensors"),
    pytest.param({Monitor.SATELLITES: ("G05",)}, {H.SATELLITES}, H.SATELLITES, id="satellite"),
]  # fmt: skip


@pytest.mark.parametrize(("said", "includes", "acted_on"), CASES)
def test_hypotheses_that_explain_what_is_said_survive_and_one_alone_is_acted_on(
    said: dict[Monitor, tuple[str, ...]], includes: set[H], acted_on: H | None
) -> None:
    found = after(30, {**ALL_PASS, **said})
    surviving = {name for name, posterior in found.items() if posterior.survives and name is not H.NOTHING}
    assert includes <= surviving
    assert {name for name, posterior in found.items() if posterior.acted_on} == ({acted_on} if acted_on else set())
    if acted_on is not None:
        assert surviving == {acted_on} and found[acted_on].probability > CERTAIN_PROBABILITY


def test_a_belief_names_the_monitors_that_speak_for_it_and_against_it() -> None:
    quiet, found, alone, against = (Beliefs() for _ in range(4))
    updated(quiet, 3, {})
    assert quiet.why(H.NOTHING) == explain(Code.NO_ACCUSATION) and quiet.why(H.GNSS) == explain(Code.NO_EVIDENCE)
    updated(found, 30, {**ALL_PASS, Monitor.INERTIAL_SHORT: EITHER, Monitor.GYROSCOPE: ("imu",)})
    assert found.why(H.NOTHING) == explain(Code.FALSE_ALARMS)
    assert found.why(H.IMU).code in (Code.SUPPORTED, Code.DISPUTED)
    assert {"inertial_short", "gyroscope"} <= set(found.why(H.IMU).values["supporting"])  # type: ignore[arg-type]
    updated(alone, 30, {Monitor.INERTIAL_SHORT: EITHER})
    assert alone.why(H.IMU) == explain(Code.SUPPORTED, supporting=("inertial_short",))
    updated(against, 30, {Monitor.SATELLITES: ("G05",), Monitor.GYROSCOPE: (), Monitor.INERTIAL_SHORT: EITHER})
    disputed = explain(Code.DISPUTED, supporting=("inertial_short",), contradicting=("gyroscope",))
    assert against.why(H.GNSS) == disputed
    assert all(words().detail(beliefs.why(name)) for beliefs in (quiet, found, alone, against) for name in H)


def test_without_a_statement_the_posteriors_are_the_priors() -> None:
    found = after(100, ALL_PASS)
    assert {name: posterior.probability for name, posterior in found.items() if name is not H.NOTHING} == pytest.approx(
        dict(PRIOR)
    )
    assert [name for name, posterior in found.items() if posterior.survives] == [H.NOTHING]
    assert sum(posterior.probability for posterior in found.values()) == pytest.approx(1.0)


def test_the_flags_of_the_receiver_alone_are_no_conflict_but_its_time_is() -> None:
    assert not after(60, {**ALL_PASS, Monitor.EVIDENCE: ("gnss",)})[H.GNSS].survives
    said = replace(statement(Monitor.EVIDENCE, ("gnss",), tests=("host_time",)), stated_ns=SECOND_NS)
    found = Beliefs().update(Facts(SECOND_NS, None, {Monitor.EVIDENCE: said}), ())
    assert {posterior.hypothesis for posterior in found if posterior.survives} >= {H.RECEIVER_TIME}


def test_one_statement_a_window_counts_and_one_monitor_is_bounded() -> None:
    evidence, found = Evidence(Monitor.INERTIAL_SHORT), []
    for k in range(100):
        facts = Facts(k * SECOND_NS)
        evidence.update(statement(Monitor.INERTIAL_SHORT, EITHER), facts, {H.GNSS})
        found.append(evidence.sums[H.GNSS])
    assert found[0] == found[4] == pytest.approx(0.5 * MAX_LOG_LIKELIHOOD), "the window is 5 s long"
    assert found[5] == found[-1] == pytest.approx(MAX_LOG_LIKELIHOOD)
    assert exp(0.5 * MAX_LOG_LIKELIHOOD) == pytest.approx(0.5 / FALSE_ALARM)


def test_passing_speaks_only_against_what_another_monitor_has_spoken_for() -> None:
    evidence = Evidence(Monitor.INERTIAL_LONG)
    for k in range(10):
        evidence.update(statement(Monitor.INERTIAL_LONG), Facts(k * SECOND_NS), ())
    assert not evidence.sums
    evidence.update(statement(Monitor.INERTIAL_LONG), Facts(10 * SECOND_NS), {H.GNSS})
    assert evidence.sums[H.GNSS] < 0.0


def test_what_was_said_is_kept_while_a_contradiction_is_open_and_forgotten_after_it() -> None:
    beliefs = Beliefs()
    accusing = replace(statement(Monitor.INERTIAL_SHORT, ("gnss",)), stated_ns=SECOND_NS, suspect_since_ns=5)
    quiet = replace(statement(Monitor.INERTIAL_SHORT), stated_ns=2 * SECOND_NS)
    beliefs.update(Facts(SECOND_NS, None, {Monitor.INERTIAL_SHORT: accusing}), ())
    facts = Facts(2 * SECOND_NS, None, {Monitor.INERTIAL_SHORT: quiet})
    kept = {posterior.hypothesis: posterior for posterior in beliefs.update(facts, (H.GNSS,))}[H.GNSS]
    assert kept.survives and kept.since_ns == 5
    gone = {posterior.hypothesis: posterior for posterior in beliefs.update(facts, ())}[H.GNSS]
    assert not gone.survives and gone.probability == pytest.approx(PRIOR[H.GNSS], rel=1e-2)


@each("monitor", Monitor)
def test_every_accusation_of_a_source_is_explained_by_its_hypothesis(monitor: Monitor) -> None:
    for name, hypothesis in (("gnss", H.GNSS), ("imu", H.IMU), ("odometer", H.ODOMETER)):
        if (monitor, name) != (Monitor.COHERENT_SCALE, "odometer"):
            assert hypothesis in explained_by(statement(monitor, (name,)), odometer_in_use=False)
    assert not explained_by(statement(monitor, ("neighbour 17",)), odometer_in_use=False)


def test_suspects_share_the_floor_in_proportion_to_their_priors_and_none_is_below_its_own() -> None:
    shared = suspected_priors((H.IMU, H.GNSS), 1e-3)
    assert sum(shared.values()) == pytest.approx(SUSPECTED * 1e-3)
    assert shared[H.IMU] / shared[H.GNSS] == pytest.approx(PRIOR[H.IMU] / PRIOR[H.GNSS])
    assert suspected_priors((H.IMU, H.GNSS), 1e-9) == {H.IMU: PRIOR[H.IMU], H.GNSS: PRIOR[H.GNSS]}


@pytest.mark.parametrize("held", [False, True])
def test_the_floor_holds_while_a_test_is_exceeded_or_an_offset_is_held_and_not_longer(held: bool) -> None:
    beliefs, open_ones, found = Beliefs(), {H.GNSS, H.IMU}, {}
    for second, accused in enumerate((EITHER, EITHER, ())):
        now_ns = (second + 1) * SECOND_NS
        said = {Monitor.INERTIAL_SHORT: replace(statement(Monitor.INERTIAL_SHORT, accused), stated_ns=now_ns)}
        facts = Facts(now_ns, None, said, held_m=(20.0, 0.0) if held else None)
        found[second] = {posterior.hypothesis: posterior.probability for posterior in beliefs.update(facts, open_ones)}
    odds = [found[k][H.GNSS] / found[k][H.NOTHING] for k in (1, 2)]
    fell = odds[1] / odds[0]
    assert fell == pytest.approx(0.5 if held else 0.5 * PRIOR[H.GNSS] / suspected_priors((H.GNSS, H.IMU), 1e-3)[H.GNSS],
                                 rel=0.2)  # fmt: skip
