"""While a satellite is excluded, the least-squares fix of core.cooperative replaces that of the receiver."""

from collections.abc import Iterator
from math import degrees, radians

import pytest

from services.core.cooperative.codes import Code
from services.sensors.simulator.world import messages
from shared.maths.earth import Geodetic, geodetic_from_ned_difference
from shared.messages.base import Message
from shared.messages.gnss import FaultFreeFix, GnssFix, GnssRawEpoch
from shared.messages.navigation import AidingKind, AidingUpdate, NavigationState
from shared.messages.trust import Outcome, TrustMonitor, TrustState
from shared.runtime.config import parse_vehicle
from shared.runtime.offline import OfflineUnit

PARSERS = ("parsers.gnss", "parsers.imu", "parsers.can")
CORE = ("core.fusion", "core.cooperative", "core.trust")
BEGIN_NS, END_NS = 45_000_000_000, 50_000_000_000
PUSH_M, MOVED_M = 50.0, 6.0
ROW = 3  # satellite of an epoch


@pytest.fixture(scope="module")
def drive() -> list[Message]:
    parsed = OfflineUnit(parse_vehicle(""), PARSERS).run(messages("parking_lot", 1, 70.0))
    return [message for message in parsed if hasattr(message, "sampled_ns")]


def faulty(drive: list[Message]) -> Iterator[Message]:
    """The drive with a longer pseudorange of one satellite for ten seconds, and the resulting fixes of the receiver."""
    origin_ns = next(message.sampled_ns for message in drive if isinstance(message, GnssFix))
    for message in drive:
        since_ns = message.sampled_ns - origin_ns if isinstance(message, GnssFix | GnssRawEpoch) else 0
        if not BEGIN_NS <= since_ns < END_NS:
            yield message
        elif isinstance(message, GnssRawEpoch):
            rows = list(message.measurements)
            true_m = rows[ROW].pseudorange_m
            assert true_m is not None
            rows[ROW] = rows[ROW].model_copy(update={"pseudorange_m": true_m + PUSH_M})
            yield message.model_copy(update={"measurements": tuple(rows)})
        elif isinstance(message, GnssFix) and message.latitude_deg is not None and message.longitude_deg is not None:
            place = Geodetic(radians(message.latitude_deg), radians(message.longitude_deg), 0.0)
            latitude, _, _ = geodetic_from_ned_difference((MOVED_M, 0.0, 0.0), place)
            yield message.model_copy(update={"latitude_deg": degrees(latitude)})
        else:
            yield message


@pytest.fixture(scope="module")
def published(drive: list[Message]) -> list[Message]:
    return list(OfflineUnit(parse_vehicle(""), CORE).run(faulty(drive)))


def test_the_fault_free_fix_replaces_that_of_the_receiver(published: list[Message]) -> None:
    replaced = {message.sampled_ns for message in published if isinstance(message, FaultFreeFix)}
    assert len(replaced) >= 5
    used = {
        message.sampled_ns: message
        for message in published
        if isinstance(message, AidingUpdate)
        and message.kind is AidingKind.GNSS_POSITION
        and message.sampled_ns in replaced
    }
    assert set(used) == replaced and all(aiding_update.used for aiding_update in used.values()), (
        "the last outcome of each epoch"
    )
    assert max(abs(aiding_update.innovation[0]) for aiding_update in used.values()) < MOVED_M / 2.0, (
        "not those of the receiver"
    )


def test_an_excluded_satellite_is_a_finding_and_no_accusation(
    published: list[Message],
) -> None:
    accusing = [
        message
        for message in published
        if isinstance(message, TrustMonitor) and message.monitor == "satellites" and message.outcome is Outcome.ACCUSES
    ]
    [name] = accusing[0].accused
    known = [message for message in published if isinstance(message, NavigationState) and message.satellites_left_out]
    assert {navigation_state.satellites_left_out for navigation_state in known} == {(name,)}
    verdicts = [
        message
        for message in published
        if isinstance(message, TrustState) and known[0].sampled_ns < message.sampled_ns <= known[-1].sampled_ns
    ]
    assert verdicts and not any(verdict.row == 5 or verdict.gnss_excluded for verdict in verdicts)
    assert any(f"satellite {name} is excluded" in verdict.findings for verdict in verdicts)
    last = [message for message in published if isinstance(message, NavigationState)][-1]
    assert last.satellites_left_out == (), "the receiver's own fix is used again"


def test_gnss_is_accused_where_raw_measurements_end_while_a_satellite_is_excluded(drive: list[Message]) -> None:
    def cut() -> Iterator[Message]:
        raw_epochs = 0
        for message in faulty(drive):
            raw_epochs += isinstance(message, GnssRawEpoch)
            if not (isinstance(message, GnssRawEpoch) and raw_epochs > 50):
                yield message

    found = [
        message for message in OfflineUnit(parse_vehicle(""), CORE).run(cut()) if isinstance(message, TrustMonitor)
    ]
    satellites = [trust_monitor for trust_monitor in found if trust_monitor.monitor == "satellites"]
    why = satellites[-1].reason_code
    assert satellites[-1].accused == ("gnss",)
    assert why is not None and why.code == Code.SILENT_AFTER_EXCLUSION
