"""Receivers over time, and why a satellite is not used."""

import math
from pathlib import Path

import pytest
from pydantic_core import from_json, to_json

from services.monitoring.status.history.gnss_history import (
    SATELLITES_MAXIMUM,
    SOURCES_MAXIMUM,
    Changes,
    GnssHistory,
    correction_of,
    kind_of,
)
from services.monitoring.status.history.history_file import HistoryFile
from services.monitoring.status.state import State
from services.monitoring.status.views.gnss import gnss, why_not_used
from shared.messages.corrections import CorrectionsState
from shared.messages.explanation import explain
from shared.messages.gnss import (
    CarrierSolution,
    Constellation,
    FixType,
    GnssFix,
    GnssRawEpoch,
    GnssSatellites,
    GnssSignal,
    GnssSignals,
    RawMeasurement,
    Satellite,
    SignalQuality,
)
from shared.messages.trust import MonitorTest, Outcome, TrustMonitor
from shared.trust.result import SATELLITE_LEFT_OUT
from tests.support.bus.envelopes import sent
from tests.support.cases import each
from tests.support.dashboard.status_world import trust

NS = 1_000_000_000
TRACKED = Satellite(
    constellation=Constellation.GPS, number=7, cn0_db_hz=40.0, elevation_rad=0.5, azimuth_rad=1.0, used=False,
    quality=SignalQuality.CARRIER_LOCKED, healthy=True, orbit_known=True,
)  # fmt: skip


def fix(**changes: object) -> GnssFix:
    given = {"sampled_ns": NS, "received_ns": NS, "source": "gnss0", "fix_type": FixType.THREE_D,
             "latitude_deg": 48.0, "longitude_deg": 11.0, **changes}  # fmt: skip
    return GnssFix.model_validate(given)


@each(
    ("changes", "reason"),
    [
        ({}, "tracked; the receiver states no reason"),
        ({"healthy": False, "elevation_rad": 0.01}, "unhealthy"),
        ({"elevation_rad": math.radians(9)}, "below the elevation mask of 10°"),
        ({"quality": SignalQuality.SEARCHING, "cn0_db_hz": None}, "searched for"),
        ({"quality": SignalQuality.UNUSABLE}, "not usable"),
        ({"quality": None, "cn0_db_hz": None}, "no signal"),
        ({"orbit_known": False}, "orbit not known"),
        ({"constellation": Constellation.SBAS}, "corrections only"),
        ({"quality": SignalQuality.CODE_LOCKED}, "code tracked, carrier not"),
    ],
)
def test_each_cause_has_its_own_reason(changes: dict[str, object], reason: str) -> None:
    satellite = TRACKED.model_copy(update=changes)
    assert reason in (why_not_used(satellite, math.radians(10)) or "")
    assert why_not_used(satellite.model_copy(update={"used": True}), math.radians(10)) is None


def rows_of(*messages: GnssSatellites | GnssSignals | GnssRawEpoch, second: int = 1) -> dict[str, list[object]]:
    """Satellites of the view with their signals."""
    state = State("bench", (), 0, 900.0)
    for message in messages:
        state.gnss.note(message, second * NS)
    shown = from_json(to_json(gnss(state, NS)))
    return {row["name"]: row["signals"] for row in shown["receivers"][0]["satellites"]}


def test_each_signal_has_its_own_use_and_reason_and_replaces_the_raw_measurement() -> None:
    stamps = {"sampled_ns": NS, "received_ns": NS, "source": "gnss0"}
    sky = GnssSatellites.model_validate({**stamps, "satellites": (TRACKED.model_copy(update={"used": True}),)})
    l1 = GnssSignal(
        constellation=Constellation.GPS, number=7, signal="1C", cn0_db_hz=44.0, quality=SignalQuality.CARRIER_LOCKED,
        healthy=True, pseudorange_used=True, carrier_phase_used=True, doppler_used=True, corrected=False,
    )  # fmt: skip
    l2 = l1.model_copy(update={"signal": "2L", "quality": SignalQuality.UNUSABLE, "pseudorange_used": False})
    signals = GnssSignals.model_validate({**stamps, "signals": (l1, l2)})
    measured = RawMeasurement(constellation=Constellation.GPS, number=7, signal="5Q", cn0_db_hz=39.0)
    raw = GnssRawEpoch.model_validate({**stamps, "gps_time_ns": NS, "measurements": (measured,)})
    used = {"band": "L1", "cn0_db_hz": 44.0, "used": True, "reason": None}
    unused = {"band": "L2", "cn0_db_hz": 44.0, "used": False, "reason": "signal detected, but not usable"}
    assert rows_of(sky, raw, signals) == {"G07": [used, unused]}
    assert rows_of(signals) == {"G07": [used, unused]}, "a receiver that states signals only"
    assert rows_of(sky, raw) == {"G07": [{"band": "L5", "cn0_db_hz": 39.0, "used": None, "reason": None}]}
    assert rows_of(sky) == {"G07": []}


def test_an_unknown_mask_is_no_reason() -> None:
    low = TRACKED.model_copy(update={"elevation_rad": 0.01})
    assert why_not_used(low, None) == "tracked; the receiver states no reason"


@each(
    ("changes", "kind", "correction"),
    [
        ({}, "three_d", "none"),
        ({"differential": True, "correction_age_s": 1.0}, "differential", "fresh"),
        ({"carrier_solution": CarrierSolution.FIXED, "correction_age_s": 10.0}, "rtk_fixed", "aged"),
        ({"carrier_solution": CarrierSolution.FLOAT, "correction_age_s": 60.0}, "rtk_float", "old"),
        ({"differential": True}, "differential", "used"),
        ({"fix_type": FixType.NONE, "latitude_deg": None}, "none", "none"),
        ({"fix_type": FixType.TIME_ONLY, "latitude_deg": None}, "time_only", "none"),
        ({"fix_type": FixType.TWO_D}, "two_d", "none"),
    ],
)
def test_kind_and_corrections_of_a_fix_are_classed(changes: dict[str, object], kind: str, correction: str) -> None:
    assert (kind_of(fix(**changes)), correction_of(fix(**changes))) == (kind, correction)


def test_a_pause_is_shown_as_such_and_ends_with_the_next_message() -> None:
    changes = Changes()
    for second in (1, 2, 3):
        changes.note(second * NS, "three_d")
    assert list(changes.until(4 * NS)) == [(NS, "three_d")]
    assert list(changes.until(60 * NS)) == [(NS, "three_d"), (8 * NS, "no_data")]
    changes.note(61 * NS, "three_d")
    assert list(changes.until(62 * NS)) == [(NS, "three_d"), (8 * NS, "no_data"), (61 * NS, "three_d")]


def test_the_time_to_first_fix_is_measured_from_the_first_message_without_position() -> None:
    history = GnssHistory()
    for second in range(30):
        located = second >= 26
        found = fix() if located else fix(fix_type=FixType.NONE, latitude_deg=None, longitude_deg=None)
        history.note(found, second * NS)
    receiver = history.receivers["gnss0"]
    assert (receiver.waited_since_ns, receiver.first_position_ns) == (0, 26 * NS)


def test_tracks_and_bands_are_those_of_before_a_restart_with_the_pause_between(tmp_path: Path) -> None:
    first, file = State("bench", (), 0, 900.0), HistoryFile(tmp_path / "kept.jsonl")
    for second in range(1, 121):
        turned = TRACKED.model_copy(update={"azimuth_rad": math.radians(second)})
        stamps = {"sampled_ns": second * NS, "received_ns": second * NS}
        sky = GnssSatellites(source="gnss0", satellites=(turned,), **stamps)
        located = fix(differential=second > 60, correction_age_s=1.0 if second > 60 else None)
        for message in (located.model_copy(update=stamps), sky):
            first.receive(sent(message, second * NS))
    file.append(first.unsaved())
    restarted = State("bench", (), 150 * NS, 900.0)
    assert restarted.restore(file.read()) == 0
    before, after = first.gnss.receivers["gnss0"], restarted.gnss.receivers["gnss0"]
    assert [(ns // NS, azimuth) for ns, _, azimuth in after.tracks["gps", 7]] == [(1, 1), (31, 31), (61, 61), (91, 91)]
    assert after.tracks == before.tracks
    for changes in (before.fixes, after.fixes):
        assert list(changes.until(150 * NS)) == [(NS, "three_d"), (61 * NS, "differential"), (125 * NS, "no_data")]
    assert list(after.corrections.until(121 * NS)) == [(NS, "none"), (61 * NS, "fresh")]


def test_tracks_have_a_point_every_half_minute_and_all_of_it_is_bounded() -> None:
    history = GnssHistory()
    crowd = tuple(TRACKED.model_copy(update={"number": n}) for n in range(SATELLITES_MAXIMUM + 50))
    for second in range(95):
        sky = GnssSatellites(sampled_ns=0, received_ns=0, source="gnss0", satellites=crowd)
        history.note(sky, second * NS)
    tracks = history.receivers["gnss0"].tracks
    assert len(tracks) == SATELLITES_MAXIMUM
    assert [ns // NS for ns, _, _ in tracks["gps", 0]] == [0, 30, 60, 90]
    for n in range(20):
        history.note(fix(source=f"gnss{n}"), NS)
    assert len(history.receivers) == SOURCES_MAXIMUM
    alone = GnssSatellites(sampled_ns=0, received_ns=0, source="gnss0", satellites=crowd[:1])
    history.note(alone, 7200 * NS)
    assert set(tracks) == {("gps", 0)}, "who has not been seen for an hour is dropped"


def test_the_source_of_corrections_is_shown_while_its_statement_is_fresh() -> None:
    state = State("bench", (), 0, 900.0)
    assert gnss(state, NS)["corrections"] is None
    types = {"RTCM 1005 station position": 3}
    stated = CorrectionsState(sampled_ns=NS, active="ntrip://caster/M", reason="", types=types)
    state.receive(sent(stated, NS, "parsers.corrections", 1))
    shown = from_json(to_json(gnss(state, 2 * NS)))["corrections"]
    assert (shown["active"], shown["types"]) == ("ntrip://caster/M", types)
    assert gnss(state, 60 * NS)["corrections"] is None


@pytest.mark.parametrize(
    ("test", "shown"),
    [
        ({"outcome": Outcome.ACCUSES, "reason_code": explain(SATELLITE_LEFT_OUT, residual_m=31.2)},
         (True, False, "excluded by core.cooperative, residual 31.2 m")),
        ({"outcome": Outcome.PASS, "reason_code": explain("cooperative.used_without_bias", residual_m=0.4)},
         (False, False, "used, residual 0.4 m")),
        ({"outcome": Outcome.ACCUSES, "reason": "excluded, residual 31.2 m"},
         (False, True, "excluded, residual 31.2 m")),
    ],
    ids=["excluded", "used", "of release 0.1.0, whose text decides nothing"],
)  # fmt: skip
def test_whether_a_satellite_is_excluded_is_the_code_of_its_test(
    test: dict[str, object], shown: tuple[bool, bool, str]
) -> None:
    state = State("bench", (), 0, 900.0)
    stamps = {"sampled_ns": NS, "received_ns": NS, "source": "gnss0"}
    state.gnss.note(GnssSatellites.model_validate({**stamps, "satellites": (TRACKED,)}), NS)
    tests = (MonitorTest(name="G07", **test),)  # type: ignore[arg-type]
    monitor = TrustMonitor(sampled_ns=NS, monitor="satellites", outcome=Outcome.PASS, reason="", tests=tests)
    state.receive(sent(trust(NS).model_copy(update={"monitors": (monitor,)}), NS, "core.trust", 1))
    (row,) = from_json(to_json(gnss(state, NS)))["receivers"][0]["satellites"]
    assert (row["excluded"], row["suspect"], row["integrity"]) == shown
