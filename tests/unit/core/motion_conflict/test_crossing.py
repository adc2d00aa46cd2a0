"""Ferry and train: what the driver's begin and end silence, and the question that silences nothing."""

from math import cos, hypot, sin

import pytest

from services.core.motion_conflict.codes import Code
from services.core.motion_conflict.process import Config, Process
from services.core.motion_conflict.tachograph import FERRY_SPEED_M_S, DistanceRule, distance_limit
from shared.messages.base import Tick
from shared.messages.imu import ImuSamples
from shared.messages.operation import Crossing, CrossingEnd
from shared.messages.trust import Outcome, TrustMonitor
from tests.unit.core.motion_conflict.test_process import SECOND_NS, drive, fix, odometer

KNOT = 0.514444  # [m/s]
FERRY_M_S = 15.0 * KNOT


def crossing(second: int, is_open: bool) -> Crossing:
    ended = None if is_open else CrossingEnd.DRIVER
    return Crossing(sampled_ns=second * SECOND_NS, is_open=is_open, since_ns=0, ended_by=ended)


def accusing(statement: TrustMonitor) -> set[str]:
    return {test.name for test in statement.tests if test.outcome is Outcome.ACCUSES}


def test_a_parked_vehicle_on_a_ferry_is_accused_unless_its_driver_has_entered_the_crossing() -> None:
    """The second row of the attack "parked and spoofed": it looks the same, and is accused."""
    entered, not_entered = Process(Config()), Process(Config())
    list(entered.handle(crossing(0, True)))
    with_entry = drive(entered, range(1, 700), FERRY_M_S, 0.0)["motion"]
    without = drive(not_entered, range(1, 700), FERRY_M_S, 0.0)["motion"]
    assert with_entry.outcome is Outcome.NOT_EVALUATED and accusing(with_entry) == set()
    assert {test.reason_code.code for test in with_entry.tests if test.reason_code} >= {Code.CROSSING.value}
    assert without.outcome is Outcome.ACCUSES and accusing(without) >= {"motion_sensor", "trimmed_mean", "event"}


def test_after_the_end_of_a_crossing_nothing_of_it_is_left_in_the_windows() -> None:
    process = Process(Config())
    list(process.handle(crossing(0, True)))
    drive(process, range(1, 600), FERRY_M_S, 0.0)
    list(process.handle(crossing(600, False)))
    driven = drive(process, range(600, 1000), 20.0, 20.0)["motion"]
    assert driven.outcome is Outcome.PASS and accusing(driven) == set()
    spoofed = drive(process, range(1000, 1400), 20.0, 0.0)["motion"]
    assert spoofed.outcome is Outcome.ACCUSES, "a crossing that was closed silences nothing more"


@pytest.mark.parametrize(("ferry_s", "limit"), [(0, distance_limit(0.0)), (600, 1000.0 + 600.0 * FERRY_SPEED_M_S)])
def test_the_distance_rule_allows_200_km_h_times_the_crossing(ferry_s: int, limit: float) -> None:
    rule = DistanceRule(gap_s=2.0)
    rule.position(0, 0.7, 0.1)
    for second in range(0, 901):
        if ferry_s and second in (100, 100 + ferry_s):
            rule.crossing(second * SECOND_NS, second == 100)
        rule.odometer(second * SECOND_NS, 0.0)
    rule.position(900 * SECOND_NS, 0.7, 0.101)
    assert rule.compared is not None and rule.compared[1] == pytest.approx(limit)


def test_a_crossing_over_several_intervals_counts_in_each() -> None:
    rule = DistanceRule(gap_s=2.0)
    rule.crossing(0, True)
    for second in range(0, 1801):
        rule.odometer(second * SECOND_NS, 0.0)
        if second % 900 == 0:
            rule.position(second * SECOND_NS, 0.7, 0.1)
            if second:
                assert rule.compared is not None
                assert rule.compared[1] == pytest.approx(1000.0 + 900.0 * FERRY_SPEED_M_S)


def carried(process: Process, seconds: range, gyroscope_rad_s: float, course_rad_s: float) -> TrustMonitor:
    """Move with standing wheels along a circle at constant speed; give the last statement `motion`."""
    last: dict[str, TrustMonitor] = {}
    for k in seconds:
        stamps = tuple(k * SECOND_NS + n * SECOND_NS // 10 for n in range(10))
        samples = ImuSamples(
            received_ns=stamps[-1], source="imu0", sampled_ns=stamps,
            specific_force_body_m_s2=((0.0, 0.0, -9.8),) * 10,
            angular_rate_body_rad_s=((0.0, 0.0, gyroscope_rad_s),) * 10,
        )  # fmt: skip
        course = course_rad_s * k
        velocity = (FERRY_M_S * cos(course), FERRY_M_S * sin(course), 0.0)
        moved = fix(k * SECOND_NS, FERRY_M_S).model_copy(update={"velocity_ned_m_s": velocity})
        assert hypot(*velocity) == pytest.approx(FERRY_M_S)
        for message in (samples, moved, odometer(k * SECOND_NS, 0.0), Tick(now_ns=k * SECOND_NS)):
            last |= {one.monitor: one for one in process.handle(message) if isinstance(one, TrustMonitor)}
    return last["motion"]


@pytest.mark.parametrize(("course_rad_s", "is_asked"), [(0.01, True), (-0.01, False), (0.0, False)])
def test_carried_is_a_question_where_the_gyroscope_turns_as_gnss_does(course_rad_s: float, is_asked: bool) -> None:
    statement = carried(Process(Config()), range(1, 66), 0.01, course_rad_s)
    codes = {test.name: test.reason_code.code for test in statement.tests if test.reason_code}
    assert statement.doubtful is is_asked
    assert codes["carried"] == (Code.CARRIED_OR_SPOOFED if is_asked else Code.NOT_CARRIED).value


def doubt(statement: TrustMonitor) -> str | None:
    codes = {test.name: test.reason_code.code for test in statement.tests if test.reason_code}
    return codes["carried"] if statement.doubtful else None


@pytest.mark.parametrize(
    ("course_rad_s", "opened_s", "why"),
    [(0.01, 0, None), (0.0, 0, Code.CROSSING_TURNS), (0.01, -86_400, Code.CROSSING_LONG)],
)
def test_a_crossing_is_doubted_where_turns_disagree_and_after_a_day(
    course_rad_s: float, opened_s: int, why: Code | None
) -> None:
    """Driven with an odometer at zero: GNSS is spoofed, or the crossing is never closed."""
    process = Process(Config())
    entered = crossing(0, True).model_copy(update={"since_ns": opened_s * SECOND_NS})
    list(process.handle(entered))
    statement = carried(process, range(1, 66), 0.01, course_rad_s)
    assert statement.outcome is Outcome.NOT_EVALUATED
    assert doubt(statement) == (None if why is None else why.value)


def test_a_crossing_without_an_odometer_is_doubted() -> None:
    process = Process(Config())
    list(process.handle(crossing(0, True)))
    (motion,) = (
        one
        for one in process.handle(Tick(now_ns=20 * SECOND_NS))
        if isinstance(one, TrustMonitor) and one.monitor == "motion"
    )
    assert doubt(motion) == Code.CROSSING_WITHOUT_WHEELS.value


def test_the_question_silences_nothing() -> None:
    """Parked and spoofed along a straight road looks like a ferry; the rules accuse as without the question."""
    statement = carried(Process(Config()), range(1, 120), 0.0, 0.0)
    assert statement.doubtful and statement.outcome is Outcome.ACCUSES and accusing(statement) == {"motion_sensor"}
