"""The process core.cooperative with neighbours: what it publishes with their help, and what it refuses."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from services.core.cooperative.codes import Code
from services.core.cooperative.measurements import Constellation, RawEpoch, SatelliteId
from services.core.cooperative.process import MAX_LISTS, Config, Process, largest_sd
from shared.maths.earth import geodetic_from_ecef, ned_from_ecef
from shared.maths.frequency_offset import cfo_from_range_rate
from shared.messages.base import Tick
from shared.messages.explanation import Reference, ReferenceKind, Value, explain
from shared.messages.neighbours import MAX_NEIGHBOURS, Neighbour, NeighbourStates
from shared.messages.trust import MonitorTest, Outcome, TrustMonitor
from shared.runtime.config import Vehicle
from tests.support.cases import each
from tests.support.gnss.constellation import NOW_NS, raw_epoch
from tests.unit.core.cooperative.satellites.test_satellite_process import HERE, NS, at, bits, informed, message, said

TO_NED = ned_from_ecef(*geodetic_from_ecef((HERE[0], HERE[1], HERE[2]))[:2])
OWN_OFFSET = -3e-7  # [-] of the vehicle's radio
CARS = (((30.0, 10.0), (1.0, 0.5)), ((-25.0, -12.0), (4.0, 0.0)), ((60.0, -50.0), (-12.0, -5.0)))
POSITION_COV, VELOCITY_COV = (1.0, 0.0, 0.0, 1.0, 0.0, 2.0), (0.04, 0.0, 0.0, 0.04, 0.0, 0.04)


def neighbours(second: int, lie: float = 0.0, **changes: object) -> NeighbourStates:
    """Three cars at constant places, seen by a vehicle at rest; the first may lie about its speed, or be changed."""
    rng, found = np.random.default_rng((5, second)), []
    for number, (away, velocity) in enumerate(CARS):
        rate = float(np.dot(away, velocity) / np.hypot(*away))
        x, y, z = (HERE + TO_NED.T @ np.array([*away, 0.0])).tolist()
        place = geodetic_from_ecef((x, y, z))
        one = Neighbour(
            station_id=number, latitude_deg=float(np.degrees(place.latitude)),
            longitude_deg=float(np.degrees(place.longitude)), height_ellipsoid_m=place.height,
            velocity_ned_m_s=(velocity[0] + (lie if number == 0 else 0.0), velocity[1], 0.0),
            position_cov_ned_m2=POSITION_COV, velocity_cov_ned_m2_s2=VELOCITY_COV, oscillator_offset=1e-7 * number,
            cfo_hz=cfo_from_range_rate(rate, 1e-7 * number, OWN_OFFSET) + 15.0 * rng.standard_normal(), cfo_sd_hz=15.0,
        )  # fmt: skip
        found.append(one.model_copy(update=changes) if number == 0 else one)
    time_ns = second * NS - 300_000_000
    return NeighbourStates(sampled_ns=time_ns, received_ns=time_ns, source="radio0", neighbours=tuple(found))


def with_method(method: Literal["bank", "paper", "plain"]) -> Process:
    return informed(config=Config(method=method))


def by_name(statement: TrustMonitor, name: str) -> MonitorTest:
    return next(test for test in statement.tests if test.name == name)


def help_of(statement: TrustMonitor) -> Value:
    """Give the number of neighbours that the test with their help has used."""
    code = by_name(statement, "cooperative").reason_code
    assert code is not None and code.code == Code.AGREE_WITH_NEIGHBOURS
    return code.values["neighbours_count"]


def run(process: Process, seconds: range, epoch: object = at, **changes: object) -> list[TrustMonitor]:
    found: list[TrustMonitor] = []
    for second in seconds:
        found += said(process, neighbours(second, **changes), message(epoch(second), float(second)))  # type: ignore[arg-type, operator]
    return found


def test_neighbours_that_are_received_unsigned_are_used_by_a_setting_only() -> None:
    for config, number, count in ((Config(), 2, 3), (Config(unsigned_neighbours=True), 3, 0)):
        process = informed(config=config)
        assert help_of(run(process, range(1, 4), authenticated=False)[-1]) == number
        assert process.rejects["neighbour_not_authenticated"] == count
    process = informed()
    assert help_of(run(process, range(1, 4), authenticated=True)[-1]) == 3 and not process.rejects


def test_neighbours_make_the_cooperative_test_from_the_second_epoch_on() -> None:
    process = informed()
    first, *others = run(process, range(1, 12))
    assert by_name(first, "cooperative").outcome is Outcome.NOT_EVALUATED
    for statement in others:
        cooperative = by_name(statement, "cooperative")
        assert statement.outcome is cooperative.outcome is Outcome.PASS
        assert help_of(statement) == 3
        assert {test.name for test in statement.tests} >= {"neighbour 0", "neighbour 1", "neighbour 2"}
    assert not process.rejects


@pytest.mark.parametrize("method", ["bank", "paper", "plain"])
def test_the_method_is_selectable(method: Literal["bank", "paper", "plain"]) -> None:
    *_, last = run(with_method(method), range(1, 6))
    assert last.outcome is Outcome.PASS
    assert [test.name for test in last.tests if test.name == "cooperative"] == ["cooperative"][: method != "plain"]


def test_with_neighbours_a_ramp_of_1_m_s_is_accused_earlier_than_by_plain_raim() -> None:
    """Plain RAIM first detects a fault that it cannot attribute, and accuses GNSS as a whole."""
    victim, began = at(1).measurements[3].satellite, {}
    methods: dict[Literal["bank", "plain"], set[tuple[str, ...]]] = {
        "bank": {(str(victim),)},
        "plain": {(str(victim),), ("gnss",)},
    }
    for method, expected in methods.items():
        process = with_method(method)
        run(process, range(1, 15))
        statements = run(process, range(15, 60), lambda k: at(k, push=(victim, k - 15.0)))
        accusing = [statement for statement in statements if statement.accused]
        assert {trust_monitor.accused for trust_monitor in accusing} == expected
        began[method] = accusing[0].sampled_ns
        assert accusing[0].suspect_since_ns == accusing[0].sampled_ns - NS
    assert began["bank"] < began["plain"]


def four(second: int, push: tuple[SatelliteId, float] | None = None) -> RawEpoch:
    epoch = at(second, push=push)
    gps = tuple(
        measurement for measurement in epoch.measurements if measurement.satellite.constellation == Constellation.GPS
    )
    return replace(epoch, measurements=gps[:4])


def test_four_satellites_are_evaluated_with_neighbours_and_a_step_is_attributed() -> None:
    process, victim = informed(), four(1).measurements[1].satellite
    run(process, range(1, 15))
    clean = run(process, range(15, 20), four)
    assert {trust_monitor.outcome for trust_monitor in clean} == {Outcome.PASS}
    (accusing,) = run(process, range(20, 21), lambda k: four(k, (victim, 150.0)))
    assert accusing.accused == (str(victim),)
    assert accusing.reason_code == explain(
        Code.EXCLUDED_WITH_NEIGHBOURS, satellites=(victim.reference,), neighbours_count=3
    )


LIAR = Reference(kind=ReferenceKind.NEIGHBOUR, name="0")


def test_a_lying_neighbour_is_accused_by_its_station_id_and_the_satellites_go_on_passing() -> None:
    process = informed()
    run(process, range(1, 10))
    statements = run(process, range(10, 13), lie=-15.0)
    for statement in statements:
        assert (statement.outcome, statement.accused) == (Outcome.ACCUSES, ("neighbour 0",))
        assert statement.reason_code == explain(Code.NEIGHBOURS_CONTRADICTED, neighbours=(LIAR,))
        code = by_name(statement, "neighbour 0").reason_code
        assert code is not None and (code.subject, code.code) == (LIAR, Code.NEIGHBOUR_LEFT_OUT)
        assert by_name(statement, "cooperative").outcome is Outcome.PASS
        assert by_name(statement, "neighbour 0").outcome is Outcome.ACCUSES
    (faulty,) = run(process, range(13, 14), lambda k: at(k, push=(at(1).measurements[3].satellite, 80.0)), lie=-15.0)
    assert set(faulty.accused) == {str(at(1).measurements[3].satellite), "neighbour 0"}
    assert faulty.suspect_since_ns == 12 * NS, "the neighbour's lie does not make the satellites suspect"
    later = run(process, range(14, 30))
    assert later[-1].outcome is Outcome.PASS


@pytest.mark.parametrize(("limit_m", "outcome"), [(1000.0, Outcome.PASS), (0.5, Outcome.NOT_EVALUATED)])
def test_the_protection_level_is_compared_with_the_alert_limit_of_the_vehicle(limit_m: float, outcome: Outcome) -> None:
    process = informed(config=Config(vehicle=Vehicle(alert_limit_horizontal_m=limit_m)))
    (statement,) = run(process, range(1, 2))
    level = by_name(statement, "horizontal protection level")
    assert (level.threshold, level.outcome, level.unit) == (limit_m, outcome, "m")
    assert statement.outcome is Outcome.PASS, "a large level is no accusation"


HUGE = (1e8, 0.0, 0.0, 1e8, 0.0, 1e8)
BAD = (
    ("neighbour_without_cfo", {"cfo_hz": None}),
    ("neighbour_without_oscillator_offset", {"oscillator_offset": None}),
    ("implausible_cfo", {"cfo_hz": 1e9}),
    ("implausible_neighbour", {"latitude_deg": -42.0}),
    ("implausible_neighbour", {"velocity_ned_m_s": (900.0, 0.0, 0.0)}),
    ("inaccurate_neighbour", {"position_cov_ned_m2": HUGE}),
    ("inaccurate_neighbour", {"velocity_cov_ned_m2_s2": HUGE}),
    ("neighbour_without_accuracy", {"position_cov_ned_m2": (1.0, 5.0, 0.0, 1.0, 0.0, 1.0)}),
    ("neighbour_without_accuracy", {"position_cov_ned_m2": (0.0,) * 6}),
    ("neighbour_without_accuracy", {"position_cov_ned_m2": (1e300,) * 6}),
    ("neighbour_without_accuracy", {"cfo_sd_hz": None}),
)


@each(("reason", "change"), BAD)
def test_a_bad_neighbour_is_refused_with_a_counted_reason_and_the_others_are_used(
    reason: str, change: dict[str, object]
) -> None:
    process = informed()
    *_, last = run(process, range(1, 5), **change)
    assert process.rejects == {reason: 3}, "from the second epoch on"
    assert help_of(last) == 2 and last.outcome is Outcome.PASS


def test_lists_out_of_order_of_a_second_radio_or_without_end_are_counted() -> None:
    process = informed()
    said(process, neighbours(2), neighbours(1), neighbours(3).model_copy(update={"source": "radio1"}))
    assert process.rejects == {"late_neighbour": 3, "second_radio": 1}
    process = informed()
    crowd = (neighbours(1).neighbours * MAX_NEIGHBOURS)[:MAX_NEIGHBOURS]
    flood = [neighbours(second).model_copy(update={"neighbours": crowd}) for second in range(1, MAX_LISTS + 11)]
    assert not said(process, *flood)
    assert process.rejects == {"too_many_neighbours": 10 * MAX_NEIGHBOURS}


def test_when_all_satellites_jump_together_gnss_is_accused_once_and_the_filters_start_anew() -> None:
    """So it is at a jump of the position, and at the end of a drag-off, where the signals are true again."""
    process = informed()
    run(process, range(1, 12))

    def jumped(second: int) -> RawEpoch:
        place = HERE + TO_NED.T @ np.array([150.0, 80.0, 0.0])
        return raw_epoch(place, gps_time_ns=NOW_NS + second * NS, rng=np.random.default_rng((7, second)))

    statements = run(process, range(12, 30), jumped)
    assert by_name(statements[0], "cooperative").reason_code == explain(Code.FILTERS_RESTART)
    assert statements[0].reason_code == explain(Code.FILTERS_RESTART)
    assert statements[0].accused[0] == "gnss"
    assert not any(name.startswith(("g", "G", "E")) for later in statements[1:] for name in later.accused)
    assert by_name(statements[-1], "cooperative").outcome is not Outcome.ACCUSES


def test_another_radio_is_used_when_the_first_one_is_silent() -> None:
    process = informed()
    run(process, range(1, 5))
    others = [neighbours(second).model_copy(update={"source": "radio1"}) for second in range(9, 13)]
    for second, states in zip(range(9, 13), others, strict=True):
        (*_, last) = said(process, states, message(at(second), float(second)))
    assert "second_radio" not in process.rejects
    assert help_of(last) == 3


@pytest.mark.parametrize("tick_first", [True, False])
def test_a_list_of_the_future_does_not_keep_out_those_of_now(tick_first: bool) -> None:
    process = informed()
    ahead, tick = neighbours(10_000), Tick(now_ns=NS // 2)
    said(process, *((tick, ahead) if tick_first else (ahead, tick)))
    *_, last = run(process, range(1, 5))
    assert process.rejects == {"neighbour_from_the_future": 3}
    assert help_of(last) == 3


def test_when_neighbours_stop_plain_raim_goes_on_and_says_why_they_do_not_help() -> None:
    process = informed()
    run(process, range(1, 5))
    (statement,) = said(process, message(at(5), 5.0))
    assert statement.outcome is Outcome.PASS
    assert by_name(statement, "cooperative").outcome is Outcome.NOT_EVALUATED
    assert by_name(statement, "cooperative").reason_code == explain(Code.NO_NEIGHBOUR)


@pytest.mark.parametrize(
    ("cov", "sd"),
    [((4.0, 0.0, 0.0, 9.0, 0.0, 1.0), 3.0), ((2.0, 1.0, 0.0, 2.0, 0.0, 0.5), np.sqrt(3.0)), ((-1.0,) * 6, None)],
)
def test_the_accuracy_is_the_largest_standard_deviation_in_any_direction(
    cov: tuple[float, float, float, float, float, float], sd: float | None
) -> None:
    found = largest_sd(cov)
    assert found is sd if sd is None else found == pytest.approx(sd)


@pytest.mark.parametrize("seed", [1, 3, 4])
def test_while_ephemerides_are_collected_after_a_gap_nobody_is_accused(seed: int) -> None:
    """The four satellites known first have a PDOP of 264: filters that start from them are wrong by hundreds of metres.

    With such a start these seeds accuse up to two of the three neighbours for 5 to 22 epochs.
    """
    first = ("G08", "G12", "G18", "G21")
    process = informed(first)

    def epoch(second: int) -> RawEpoch:
        return at(second, seed)

    statements = run(process, range(1, 9), epoch)
    others = [name for measurement in at(1).measurements if (name := str(measurement.satellite)) not in first]
    for second, name in zip(range(11, 21), others, strict=False):  # 9 and 10 are missing
        said(process, *bits(float(second), (name,)))
        statements += run(process, range(second, second + 1), epoch)
    assert not [statement for statement in statements if statement.accused]
    assert statements[7].outcome is Outcome.NOT_EVALUATED
    assert help_of(statements[-1]) == 3
