"""From the simulated receiver's bytes to the statement `satellites`, through parsers.gnss and core.cooperative."""

from collections.abc import Iterator
from typing import Any

import pytest

from services.core.cooperative.codes import Code
from services.core.cooperative.process import Config, Process
from services.sensors.simulator.world import messages
from shared.messages.explanation import explain
from shared.messages.gnss import GnssFix, GnssNavigationBits, GnssRawEpoch
from shared.messages.trust import Outcome, TrustMonitor
from shared.runtime.config import parse_vehicle
from shared.runtime.offline import OfflineUnit

NAMES = ("parsers.gnss", "core.cooperative")
PUSH_M = 50.0
EPHEMERIDES_S = 30  # a satellite sends its ephemeris in 30 s
PUSHED_EPOCH = 40


def statements(scenario: str, seed: int, duration_s: float) -> list[TrustMonitor]:
    unit = OfflineUnit(parse_vehicle(""), NAMES)
    found = [message for message in unit.run(messages(scenario, seed, duration_s)) if isinstance(message, TrustMonitor)]
    for name in NAMES:
        process: Any = unit.process(name)
        assert not process.rejects
    return found


@pytest.mark.parametrize(("scenario", "seed"), [("parking_lot", 1), ("urban", 2), ("degraded", 3)])
def test_a_minute_of_the_simulator_passes_once_the_ephemerides_are_complete(scenario: str, seed: int) -> None:
    found = statements(scenario, seed, 60.0)
    assert {trust_monitor.monitor for trust_monitor in found} == {"satellites"} and len(found) > 55
    begin, later = found[0], found[EPHEMERIDES_S + 2 :]
    assert begin.outcome is Outcome.NOT_EVALUATED and begin.reason
    why = found[10].reason_code
    assert why is not None and (why.code, why.values["known_count"]) == (Code.EPHEMERIDES_MISSING, 0)
    assert {trust_monitor.outcome for trust_monitor in later} == {Outcome.PASS} and len(later) > 20
    assert all(
        trust_monitor.statistic is not None
        and trust_monitor.threshold
        and trust_monitor.statistic < trust_monitor.threshold
        for trust_monitor in later
    )


def test_in_a_tunnel_the_monitor_is_not_evaluated_with_a_reason() -> None:
    found = statements("tunnel", 1, 80.0)
    assert found[-1].outcome is Outcome.NOT_EVALUATED
    assert found[-1].reason_code == explain(Code.NO_MEASUREMENTS)


def pushed(epoch: GnssRawEpoch, row: int) -> GnssRawEpoch:
    """The epoch with a longer pseudorange of one satellite."""
    rows = list(epoch.measurements)
    pseudorange_m = rows[row].pseudorange_m
    assert pseudorange_m is not None
    rows[row] = rows[row].model_copy(update={"pseudorange_m": pseudorange_m + PUSH_M})
    return epoch.model_copy(update={"measurements": tuple(rows)})


def with_push(row: int) -> Iterator[tuple[str, TrustMonitor]]:
    """Name of the satellite with an error from `PUSHED_EPOCH` on, and the statement of each epoch."""
    process, epochs = Process(Config()), 0
    for message in OfflineUnit(parse_vehicle(""), ("parsers.gnss",)).run(messages("parking_lot", 1, 50.0)):
        if isinstance(message, GnssRawEpoch):
            epochs += 1
            one = message.measurements[row]
            name = f"{'G' if one.constellation.value == 'gps' else 'E'}{one.number:02d}"
            for statement in process.handle(pushed(message, row) if epochs >= PUSHED_EPOCH else message):
                if isinstance(statement, TrustMonitor):
                    yield name, statement
        elif isinstance(message, GnssFix | GnssNavigationBits):
            assert not list(process.handle(message))


@pytest.mark.parametrize("row", [0, 3, 8, 12])
def test_a_pseudorange_error_of_50_m_on_one_satellite_is_excluded_in_its_epoch(row: int) -> None:
    found = list(with_push(row))
    (_, before), (name, at_once), *later = found[PUSHED_EPOCH - 2 :]
    assert before.outcome is Outcome.PASS
    for trust_monitor in (at_once, *(statement for _, statement in later)):
        assert (trust_monitor.outcome, trust_monitor.accused) == (Outcome.ACCUSES, (name,))
        assert trust_monitor.suspect_since_ns == before.sampled_ns
        assert (
            trust_monitor.statistic is not None
            and trust_monitor.threshold is not None
            and trust_monitor.statistic < trust_monitor.threshold
        )
