"""What a person reads of the hypotheses: the banner's clause, the table, the satellites, the tracks."""

import dataclasses

from pydantic_core import to_json

from services.monitoring.status.history.alternatives import POINTS_MAXIMUM, Alternatives
from services.monitoring.status.series.fields import parse, value_at
from services.monitoring.status.state import State
from services.monitoring.status.views import hypotheses, reports
from services.monitoring.status.views.banner import Evidence, show
from shared.messages.trust import Belief, Hypothesis, HypothesisSolution, TrustHypotheses, TrustLevel
from tests.support.dashboard.status_world import START_NS, World, trust

SECOND_NS = 1_000_000_000
GOOD = Evidence(broker=True, trust=trust(START_NS), trust_age_s=0.6, odometer_age_s=0.1)


def belief(hypothesis: Hypothesis, probability: float, **changes: object) -> Belief:
    base = Belief(
        hypothesis=hypothesis, prior=1e-4, probability=probability, survives=probability > 1e-3,
        reason="for and against",
        since_ns=None if hypothesis is Hypothesis.NOTHING else START_NS,
    )  # fmt: skip
    return base.model_copy(update=changes)


def solution(hypothesis: Hypothesis, *left_out: str, north_m: float = 0.0, **changes: object) -> HypothesisSolution:
    base = HypothesisSolution(
        hypothesis=hypothesis, left_out=left_out, since_ns=START_NS, latitude_deg=48.0 + north_m / 111_200.0,
        longitude_deg=11.0, height_ellipsoid_m=500.0, velocity_ned_m_s=(10.0, 0.0, 0.0),
        position_cov_ned_m2=(1.0, 0.0, 0.0, 1.0, 0.0, 2.0), protection_level_horizontal_m=4.0,
        protection_level_vertical_m=6.0, apart_ned_m=(-north_m, 0.0, 0.5), separation=8.0, separation_limit=16.0,
    )  # fmt: skip
    return base.model_copy(update=changes)


def stated(ns: int, *solutions: HypothesisSolution, source: str = "core.fusion", **changes: object) -> TrustHypotheses:
    return TrustHypotheses(sampled_ns=ns, source=source, solutions=solutions).model_copy(update=changes)


NOTHING = belief(Hypothesis.NOTHING, 0.2)


def test_whoever_asks_why_reads_the_probability_and_the_reason_of_each_suspect() -> None:
    shown = trust(START_NS, TrustLevel.UNSAFE, row=4, beliefs=(NOTHING, belief(Hypothesis.IMU, 0.625)))
    assert show(dataclasses.replace(GOOD, trust=shown)).reasons[-1] == (
        "The inertial sensors are wrong: 62.5 %; for and against"
    )


def test_a_row_has_belief_solution_and_distance_and_a_missing_one_says_why() -> None:
    message = stated(
        START_NS, solution(Hypothesis.GNSS, "gnss", north_m=30.0),
        missing=((Hypothesis.ODOMETER, "there is no odometer"),),
    )  # fmt: skip
    beliefs = (belief(Hypothesis.GNSS, 0.62345678), belief(Hypothesis.IMU, 0.1, distance_m=12.5, level_m=7.0))
    rows = hypotheses.table(beliefs, [("core.fusion", message)])
    assert list(rows) == ["gnss", "imu", "odometer"], "those of which nothing is stated are left out"
    gnss, imu, odometer = rows["gnss"], rows["imu"], rows["odometer"]
    assert isinstance(gnss, dict) and isinstance(imu, dict) and isinstance(odometer, dict)
    assert (gnss["distance_m"], gnss["level_m"], gnss["ratio"], gnss["left_out"]) == (30.0, 4.0, 0.5, "GNSS")
    assert (gnss["probability"], gnss["prior"], gnss["suspected"]) == (0.6235, 1e-4, True)
    assert (imu["distance_m"], imu["level_m"], imu["solutions"]) == (12.5, 7.0, 0)
    assert (odometer["missing"], odometer["probability"]) == ("there is no odometer", None)


def test_satellites_are_one_row_that_opens_to_a_list_with_the_largest_separation_first() -> None:
    parts = [solution(Hypothesis.SATELLITES, f"G{n:02d}", separation=float(n)) for n in (3, 9, 5)]
    message = stated(START_NS, *parts, source="core.cooperative")
    row = hypotheses.table((), [("core.cooperative", message)])["satellites"]
    assert isinstance(row, dict)
    assert (row["solutions"], row["left_out"], row["distance_m"]) == (3, "G09", None)
    assert [satellite["left_out"] for satellite in hypotheses.satellites([("core.cooperative", message)])] == [
        ["G09"], ["G05"], ["G03"],
    ]  # fmt: skip


def test_tracks_hold_two_minutes_and_break_at_pauses_and_where_another_source_is_left_out() -> None:
    kept = Alternatives()
    for second in range(400):
        left_out = "G05" if second < 350 else "G07"
        if not 300 <= second < 310:
            kept.note(
                stated(START_NS + second * SECOND_NS, solution(Hypothesis.SATELLITES, left_out)), "core.fusion", 0
            )
    now_ns = START_NS + 399 * SECOND_NS
    lines = kept.lines(now_ns)
    seconds = [[(point.time_ns - START_NS) // SECOND_NS for point in line.points] for line in lines]
    assert [(part[0], part[-1]) for part in seconds] == [(279, 299), (310, 349), (350, 399)]
    assert sum(map(len, seconds)) <= POINTS_MAXIMUM
    assert kept.lines(now_ns + 500 * SECOND_NS) == []


def test_fast_messages_strangers_and_stamps_that_go_back_do_not_grow_the_tracks() -> None:
    kept = Alternatives()
    for step in range(5000):
        kept.note(stated(START_NS + step * 10_000_000, solution(Hypothesis.IMU, "imu")), "core.fusion", 0)
        kept.note(stated(START_NS + step, solution(Hypothesis.IMU, "imu")), f"stranger{step}", 0)
    (line,) = kept.lines(START_NS + 50 * SECOND_NS)
    assert 45 <= len(line.points) <= 56 and list(kept.newest) == ["core.fusion"]
    kept.note(stated(START_NS - 7 * SECOND_NS, solution(Hypothesis.IMU, "imu")), "core.fusion", 0)
    (line,) = kept.lines(START_NS)
    assert len(line.points) == 1, "earlier positions are of another time line"


def test_the_report_has_tracks_rows_and_satellites_and_an_old_message_states_nothing() -> None:
    world = World()
    world.beat("core.fusion")
    world.hear(trust(world.now_ns, TrustLevel.UNSAFE, beliefs=(belief(Hypothesis.IMU, 0.7),)), "core.trust")
    for step in range(5):
        world.hear(stated(world.now_ns, solution(Hypothesis.GNSS, "gnss", north_m=float(step))), "core.fusion")
        world.pass_time(1.0)
    report = reports.hypotheses(world.state, world.now_ns)
    rows, (track,) = report["hypotheses"], report["tracks"]
    assert isinstance(rows, dict) and set(rows) == {"gnss", "imu"}
    assert (track["label"], len(track["places"])) == ("if GNSS is wrong", 5)
    world.pass_time(6.0)
    rows = reports.hypotheses(world.state, world.now_ns)["hypotheses"]
    assert isinstance(rows, dict) and set(rows) == {"imu"}, "the solutions are stale"


def test_the_probability_of_a_hypothesis_is_a_field_that_can_be_plotted() -> None:
    state = trust(START_NS, beliefs=(NOTHING, belief(Hypothesis.IMU, 0.7)))
    assert value_at(state, parse("trust/state:beliefs.imu.probability").path) == 0.7


def test_the_history_of_probabilities_survives_a_restart() -> None:
    world = World()
    world.hear(trust(world.now_ns, TrustLevel.UNSAFE, beliefs=(belief(Hypothesis.IMU, 0.71234),)), "core.trust")
    world.pass_time(1.2)
    history = world.state.trust_history.columns(world.now_ns, 900.0)["probabilities"]
    assert isinstance(history, dict) and history["imu"][-1] == 0.712
    lines = [to_json(record) for record in world.state.unsaved()]
    later = State("truck-07", (), world.now_ns, 900.0)
    assert later.restore(lines) == 0
    restored = later.trust_history.columns(world.now_ns, 900.0)["probabilities"]
    assert isinstance(restored, dict) and "imu" in restored
