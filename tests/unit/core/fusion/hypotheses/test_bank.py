"""The bank: which solutions it keeps, what they leave out, anchors, suspicion, and the level that reaches to them."""

from functools import cache
from math import hypot

import numpy as np
import pytest

from services.core.fusion.codes import Code
from services.core.fusion.hypotheses import bank as banks
from services.core.fusion.hypotheses.bank import Alternative
from services.core.fusion.integrity.disagreement import CLOSURE_SDS
from services.core.fusion.integrity.separation import squared
from services.core.fusion.messages import hypotheses_message
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic
from shared.messages.trust import Hypothesis

SECOND_NS = 1_000_000_000
EXPECTED = {
    Hypothesis.GNSS,
    Hypothesis.IMU,
    Hypothesis.ODOMETER,
    Hypothesis.GNSS_AND_ODOMETER,
    Hypothesis.RECEIVER_TIME,
}


@cache
def drive() -> Drive:
    return simulate("urban", 1, 110.0)


def run(nav: Navigator, begin_s: float, end_s: float) -> None:
    d = drive()
    first, last = (int(np.searchsorted(d.t_ns, s * SECOND_NS, side="right")) for s in (begin_s, end_s))
    k, j = (int(np.searchsorted(stamps, begin_s * SECOND_NS, side="right")) for stamps in (d.fix_ns, d.odometer_ns))
    for i in range(first, last):
        now_ns = int(d.t_ns[i])
        nav.imu(now_ns, d.force_b[i].tolist(), d.rate_b[i].tolist())
        while j < len(d.odometer_ns) and d.odometer_ns[j] <= now_ns:
            nav.speed(int(d.odometer_ns[j]), abs(float(d.odometer[j])), received_ns=now_ns)
            j += 1
        while k < len(d.fix_ns) and d.fix_ns[k] <= now_ns:
            if d.fix_valid[k]:
                nav.fix(
                    int(d.fix_ns[k]), position=Geodetic(*d.fix_position[k].tolist()),
                    velocity=d.fix_velocity_n[k].tolist(), position_sd=d.fix_position_sd_n[k].tolist(),
                    velocity_sd=d.fix_velocity_sd_n[k].tolist(), received_ns=now_ns,
                )  # fmt: skip
            k += 1


def navigator(end_s: float) -> Navigator:
    nav = Navigator(Settings().with_values({"vehicle.gnss.lever_arm_body_m": tuple(drive().lever_arm_b)}))
    run(nav, 0.0, end_s)
    return nav


@pytest.fixture(scope="module")
def driven() -> Navigator:
    return navigator(100.0)


def alternatives(nav: Navigator) -> dict[Hypothesis, Alternative]:
    return {
        alternative.hypothesis: alternative
        for alternative in nav.bank.alternatives()
        if isinstance(alternative, Alternative)
    }


def test_every_hypothesis_has_a_solution_that_agrees_on_a_drive_without_a_fault(driven: Navigator) -> None:
    found = alternatives(driven)
    assert set(found) == EXPECTED
    for alternative in found.values():
        assert hypot(*alternative.apart_n[:2]) < alternative.levels[0], (
            f"{alternative.hypothesis} is farther away than its own level"
        )
        assert alternative.separation is not None and alternative.separation < banks.SEPARATION_LIMIT


def test_differences_on_a_drive_without_a_fault_are_as_large_as_their_covariance_says() -> None:
    nav, found = navigator(60.0), []
    for second in range(60, 110):
        run(nav, float(second), second + 1.0)
        mine = alternatives(nav)
        found += [
            mine[hypothesis].separation
            for hypothesis in (Hypothesis.GNSS, Hypothesis.GNSS_AND_ODOMETER)
            if hypothesis in mine
        ]
    squares = [value for value in found if value is not None]
    assert len(squares) > 80 and 0.5 <= float(np.median(squares)) <= 1.4
    assert max(squares) < CLOSURE_SDS**2, "nothing that a level would hold"


def test_before_the_filter_has_converged_each_missing_one_says_why() -> None:
    nav = navigator(30.0)
    missing = [alternative for alternative in nav.bank.alternatives() if not isinstance(alternative, Alternative)]
    assert {hypothesis for hypothesis, _ in missing} >= EXPECTED - {Hypothesis.IMU}
    assert all(why for _, why in missing)
    message = hypotheses_message(nav)
    assert len(message.missing) == len(missing) and message.sampled_ns == nav.engine.time_ns


def test_a_solution_without_gnss_uses_none_since_its_anchor_and_two_anchors_are_staggered(driven: Navigator) -> None:
    mine = [member for member in driven.bank._members if member.kept.hypothesis is Hypothesis.GNSS_AND_ODOMETER]
    assert len(mine) == 2
    apart_s = abs(mine[0].anchor_ns - mine[1].anchor_ns) / SECOND_NS
    assert apart_s == pytest.approx(0.5 * mine[0].kept.longest_s, abs=2.0)
    for member in mine:
        exclusions = member.cursor.engine.exclusions
        assert exclusions.gnss_since_ns is not None and exclusions.odometer
        assert member.cursor.engine.accepted_ns is not None and member.cursor.engine.accepted_ns <= member.anchor_ns


def test_a_suspicion_starts_them_anew_from_before_the_suspect_time_and_its_end_drops_them() -> None:
    nav = navigator(95.0)
    suspect_ns = 90 * SECOND_NS
    nav.believe([Hypothesis.ODOMETER], suspect_ns)
    run(nav, 95.0, 103.0)
    mine = [member for member in nav.bank._members if member.kept.hypothesis is Hypothesis.ODOMETER]
    assert [member.anchor_ns < suspect_ns and not member.is_behind for member in mine] == [True]
    nav.believe([], None)
    assert not nav.bank._members


@pytest.mark.parametrize("hypothesis", [Hypothesis.ODOMETER, Hypothesis.IMU])
def test_the_level_reaches_to_the_solution_of_a_hypothesis_that_survives(hypothesis: Hypothesis) -> None:
    nav = navigator(100.0)
    before = nav.solution()
    other = alternatives(nav)[hypothesis]
    nav._surviving = frozenset([hypothesis])
    after = nav.solution()
    assert before is not None and after is not None
    reached = hypot(*other.apart_n[:2]) + other.levels[0]
    assert after.protection_level_horizontal == pytest.approx(max(before.protection_level_horizontal, reached))


def test_without_inertial_sensors_the_published_position_is_that_of_the_model_of_motion(driven: Navigator) -> None:
    driven.believe([Hypothesis.IMU], None, imu_excluded=True)
    published, model = driven.solution(), driven.bank.motion.state(driven.now.time_ns)
    driven.believe([], None)
    assert published is not None and model is not None
    assert published.position == model.position and published.yaw == model.heading
    assert published.protection_level_horizontal == pytest.approx(driven.bank.levels(model.position_cov)[0])


def test_separation_is_the_square_of_the_difference_over_its_covariance() -> None:
    rng = np.random.default_rng(2)
    root = rng.normal(size=(3, 3))
    covariance, apart = root @ root.T + np.eye(3), (3.0, -4.0, 7.0)
    expected = np.array(apart[:2]) @ np.linalg.solve(covariance[:2, :2], np.array(apart[:2]))
    assert squared(apart, covariance) == pytest.approx(expected)
    assert squared(apart, np.zeros((3, 3))) is None


@pytest.mark.slow
def test_a_paused_bank_costs_nothing_leaves_the_position_unchanged_and_begins_again() -> None:
    nav, other = navigator(90.0), navigator(90.0)
    nav.bank.pause(paused=True)
    for item in (nav, other):
        run(item, 90.0, 100.0)
    assert not nav.bank._members and not nav._timeline.followers
    missing = [alternative for alternative in nav.bank.alternatives() if not isinstance(alternative, Alternative)]
    assert {why.code for _, why in missing} == {Code.PAUSED}
    ours, theirs = nav.solution(), other.solution()
    assert ours is not None and theirs is not None
    assert (ours.position, ours.velocity) == (theirs.position, theirs.velocity), "to the bit"
    nav.bank.pause(paused=False)
    run(nav, 100.0, 110.0)
    assert set(alternatives(nav)) >= EXPECTED - {Hypothesis.IMU}, "the model of motion needs a drive of its own"


def test_a_source_that_became_suspect_during_a_pause_is_left_out_after_it() -> None:
    nav = navigator(90.0)
    nav.bank.pause(paused=True)
    nav.believe({Hypothesis.GNSS}, 85 * SECOND_NS)
    run(nav, 90.0, 92.0)
    assert not nav.bank._members
    nav.bank.pause(paused=False)
    assert {member.kept.hypothesis for member in nav.bank._members} == {
        Hypothesis.GNSS_AND_ODOMETER,
        Hypothesis.ODOMETER,
    }
