"""RXM-RAWX and RXM-SFRBX against pyubx2 as an independent reader, and against impossible values."""

import math
import struct
from collections import Counter
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyubx2.ubxmessage import UBXMessage

from services.parsers.gnss.process import Config, Process
from services.parsers.gnss.protocols import FRAMINGS
from services.parsers.gnss.ubx import raw
from services.parsers.gnss.ubx.messages import UbxError
from shared.maths.crc import fletcher
from shared.maths.dates import GPS_EPOCH_UTC_NS
from shared.messages.gnss import (
    Constellation,
    GnssFix,
    GnssNavigationBits,
    GnssRaw,
    GnssRawEpoch,
    RawMeasurement,
)
from shared.protocols.framing.framer import Framer
from shared.protocols.ubx import SYNC
from tests.support.data import recording

NS = 1_000_000_000
HEAD = struct.Struct("<dHbBBBBB")
MEASUREMENT = struct.Struct("<ddfBBBBHBBBBBB")
TOW_S, WEEK = 136_819.0004, 2437
GOOD = (21_345_678.25, 112_345_678.5, -1234.5, 0, 7, 0, 0, 64500, 44, 5, 2, 7, 0b0111, 0)


def frame(kind: int, payload: bytes) -> bytes:
    body = struct.pack("<BBH", 2, kind, len(payload)) + payload
    return SYNC + body + fletcher(body)


def rawx(*measurements: tuple[float, ...], tow_s: float = TOW_S, week: int = WEEK, status: int = 1) -> bytes:
    head = HEAD.pack(tow_s, week, 18, len(measurements), status, 1, 0, 0)
    return head + b"".join(MEASUREMENT.pack(*measurement) for measurement in measurements)


def changed(**values: float) -> tuple[float, ...]:
    names = "code cycles doppler system number signal channel lock cn0 code_sd carrier_sd doppler_sd status reserved"
    return tuple({**dict(zip(names.split(), GOOD, strict=True)), **values}.values())


def decode(*measurements: tuple[float, ...]) -> tuple[RawMeasurement, ...]:
    return raw.decode_raw(rawx(*measurements), Counter()).measurements


def independently(kind: str, payload: bytes) -> Any:
    return UBXMessage("RXM", kind, 0, payload=payload)


rows = st.tuples(
    st.floats(1e7, 5e7),
    st.floats(-1e9, 1e9),
    st.floats(-9e4, 9e4, width=32),
    st.integers(0, 7),
    st.integers(1, 255),
    st.integers(0, 9),
    st.integers(0, 13),
    st.integers(0, 64500),
    st.integers(1, 60),
    st.integers(0, 15),
    st.integers(0, 14),
    st.integers(0, 15),
    st.integers(0, 15),
    st.just(0),
)


@given(st.lists(rows, max_size=40))
def test_every_field_is_what_pyubx2_reads(measurements: list[tuple[float, ...]]) -> None:
    rejects: Counter[str] = Counter()
    payload = rawx(*measurements)
    found, read = raw.decode_raw(payload, rejects), independently("RXM-RAWX", payload)
    assert (found.gps_time_ns, found.leap_seconds) == (read.week * 604_800 * NS + round(read.rcvTow * NS), read.leapS)
    assert len(found.measurements) == read.numMeas and not rejects
    for k, measurement in enumerate(found.measurements, 1):
        field = {
            name: getattr(read, f"{name}_{k:02d}")
            for name in (
                "prMes",
                "cpMes",
                "doMes",
                "svId",
                "cno",
                "locktime",
                "prStd",
                "cpStd",
                "doStd",
                "prValid",
                "cpValid",
                "halfCyc",
            )
        }
        assert measurement.pseudorange_m == (field["prMes"] if field["prValid"] else None)
        assert measurement.carrier_phase_cycles == (field["cpMes"] if field["cpValid"] else None)
        assert measurement.half_cycle_resolved == bool(field["halfCyc"])
        assert (measurement.doppler_hz, measurement.number, measurement.cn0_db_hz) == (
            field["doMes"],
            field["svId"],
            field["cno"],
        )
        assert measurement.lock_time_s == pytest.approx(field["locktime"] * 1e-3)
        assert measurement.pseudorange_sd_m == (0.01 * 2 ** field["prStd"] if field["prValid"] else None)
        assert measurement.carrier_phase_sd_cycles == (
            pytest.approx(0.004 * field["cpStd"]) if field["cpValid"] else None
        )
        assert measurement.doppler_sd_hz == 0.002 * 2 ** field["doStd"]


@pytest.mark.parametrize(
    ("folder", "name"), [("gpsd_receiver_logs", "ublox-neo-m8t.log"), ("pyubx2_logs", "pygpsdata-RXMRAWX.log")]
)
def test_a_recorded_receivers_measurements_are_what_pyubx2_reads(folder: str, name: str) -> None:
    frames = [
        frame.data
        for frame in Framer(FRAMINGS).feed((recording(folder) / name).read_bytes())
        if frame.protocol == "UBX" and frame.data[2:4] == b"\x02\x15"
    ]
    assert frames
    for data in frames:
        found, read = raw.decode_raw(data[6:-2], Counter()), independently("RXM-RAWX", data[6:-2])
        assert [measurement.pseudorange_m for measurement in found.measurements] == [
            getattr(read, f"prMes_{k:02d}") if getattr(read, f"prValid_{k:02d}") else None
            for k in range(1, read.numMeas + 1)
        ]


def test_glonass_satellites_have_their_frequency_number() -> None:
    """RXM-RAWX: freqId is the frequency number + 7, and of GLONASS alone."""
    found = decode(*(changed(system=6, channel=k) for k in (0, 7, 13, 14, 255)), changed(system=0, channel=5))
    assert [raw_measurement.glonass_frequency_number for raw_measurement in found] == [-7, 0, 6, None, None, None]


def test_signals_have_the_observation_codes_of_rinex() -> None:
    first, second, third, unknown = decode(
        GOOD, changed(signal=3), changed(system=2, signal=1), changed(system=4, signal=9)
    )
    assert [raw_measurement.signal for raw_measurement in (first, second, third, unknown)] == ["1C", "2L", "1B", None]
    assert (third.constellation, unknown.constellation) == (Constellation.GALILEO, Constellation.UNKNOWN)


@pytest.mark.parametrize(
    ("values", "field", "reject"),
    [
        ({"code": 0.0}, "pseudorange_m", "ubx_pseudorange"),
        ({"code": -1.0}, "pseudorange_m", "ubx_pseudorange"),
        ({"code": math.nan}, "pseudorange_m", "ubx_pseudorange"),
        ({"code": 1e300}, "pseudorange_m", "ubx_pseudorange"),
        ({"cycles": math.inf}, "carrier_phase_cycles", "ubx_carrier_phase"),
        ({"doppler": math.nan}, "doppler_hz", "ubx_doppler"),
        ({"doppler": 1e9}, "doppler_hz", "ubx_doppler"),
    ],
)
def test_an_impossible_value_is_counted_and_none(values: dict[str, float], field: str, reject: str) -> None:
    rejects: Counter[str] = Counter()
    bad, good = raw.decode_raw(rawx(changed(**values), GOOD), rejects).measurements
    assert getattr(bad, field) is None and getattr(good, field) is not None
    assert rejects == {reject: 1}


def test_a_value_not_marked_valid_is_none_and_not_counted() -> None:
    rejects: Counter[str] = Counter()
    payload = rawx(changed(code=0.0, cycles=0.0, cn0=0, status=0), status=0)
    found = raw.decode_raw(payload, rejects)
    (one,) = found.measurements
    assert (one.pseudorange_m, one.pseudorange_sd_m, one.carrier_phase_cycles, one.cn0_db_hz) == (None,) * 4
    assert found.leap_seconds is None and not rejects


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (rawx(GOOD)[:-1], "short"),
        (b"", "short"),
        (rawx(GOOD) + b"\0", "short"),
        (rawx(GOOD, tow_s=604_800.0), "time_of_week"),
        (rawx(GOOD, tow_s=math.nan), "time_of_week"),
        (rawx(GOOD, tow_s=-1.0), "time_of_week"),
    ],
)
def test_an_impossible_epoch_is_rejected(payload: bytes, reason: str) -> None:
    with pytest.raises(UbxError, match=reason):
        raw.decode_raw(payload, Counter())


def sfrbx(system: int, number: int, words: tuple[int, ...], signal: int = 0) -> bytes:
    return struct.pack(f"<8B{len(words)}I", system, number, signal, 0, len(words), 3, 2, 0, *words)


def test_words_of_gps_and_galileo_equal_those_of_pyubx2_and_others_are_omitted() -> None:
    gps, galileo = tuple(range(0xFFFFFFF0, 0xFFFFFFFA)), tuple(range(8))
    for payload in (sfrbx(0, 5, gps), sfrbx(2, 11, galileo, signal=1)):
        found, read = raw.decode_navigation_bits(payload), independently("RXM-SFRBX", payload)
        assert found is not None
        assert found.number == read.svId
        assert found.words == tuple(getattr(read, f"dwrd_{k:02d}") for k in range(1, read.numWords + 1))
    assert raw.decode_navigation_bits(sfrbx(6, 1, (0,) * 4)) is None
    assert raw.decode_navigation_bits(sfrbx(2, 11, galileo, signal=5)) is None, "I/NAV of E5b"


@pytest.mark.parametrize(
    ("payload", "reason"),
    [(sfrbx(0, 5, (0,) * 9), "navigation_words"), (sfrbx(0, 5, (0,) * 10)[:-1], "short"), (b"\0" * 7, "short")],
)
def test_invalid_words_are_rejected(payload: bytes, reason: str) -> None:
    with pytest.raises(UbxError, match=reason):
        raw.decode_navigation_bits(payload)


@pytest.mark.parametrize(
    ("week", "recorded", "published"),
    [(WEEK - 1024, False, WEEK), (WEEK + 1024, False, WEEK), (WEEK - 1024, True, WEEK - 1024), (65535, False, None)],
)
def test_the_week_is_that_of_the_hosts_era_and_an_impossible_one_is_one_reject(
    week: int, recorded: bool, published: int | None
) -> None:
    process = Process(Config())
    host_ns = WEEK * 604_800 * NS + GPS_EPOCH_UTC_NS
    found = [
        item
        for k in range(2)  # the first waits for the stamp of its epoch
        for item in process.handle(
            GnssRaw(received_ns=host_ns + k, source="g", data=frame(0x15, rawx(GOOD, week=week)), recorded=recorded)
        )
    ]
    assert [
        gnss_raw_epoch.gps_time_ns // (604_800 * NS)
        for gnss_raw_epoch in found
        if isinstance(gnss_raw_epoch, GnssRawEpoch)
    ] == ([] if published is None else [published])
    assert process.rejects["ubx_date"] == (2 if published is None else 0)


@given(st.binary(max_size=200), st.sampled_from([0x13, 0x15]))
def test_any_payload_is_decoded_or_rejected(payload: bytes, kind: int) -> None:
    process = Process(Config())
    published = list(process.handle(GnssRaw(received_ns=NS, source="gnss0", data=frame(kind, payload))))
    published += list(process.handle(GnssRaw(received_ns=2 * NS, source="gnss0", data=frame(0x15, rawx(GOOD)))))
    assert all(isinstance(item, GnssRawEpoch | GnssNavigationBits) for item in published)


@given(st.lists(st.binary(min_size=32, max_size=32), max_size=5), st.binary(min_size=16, max_size=16))
def test_measurements_of_any_content_are_decoded_or_rejected(parts: list[bytes], head: bytes) -> None:
    payload = head[:11] + bytes((len(parts),)) + head[12:] + b"".join(parts)
    process = Process(Config())
    for k in range(2):  # the first waits for the stamp of its epoch
        list(process.handle(GnssRaw(received_ns=k * NS, source="gnss0", data=frame(0x15, payload))))
    try:
        found = raw.decode_raw(payload, Counter())
    except UbxError as fault:
        assert process.rejects[str(fault)] == 2
    else:
        assert len(found.measurements) == len(parts)
        assert process.rejects["ubx_date"] in (0, 2)


@pytest.mark.parametrize("first", [True, False])
def test_raw_measurements_have_the_stamp_of_their_epoch_whichever_comes_first(first: bool) -> None:
    itow_ms = round(TOW_S * 1000)
    pvt: dict[str, Any] = {
        "year": 2026,
        "month": 9,
        "day": 21,
        "validDate": 1,
        "validTime": 1,
        "fixType": 3,
        "gnssFixOk": 1,
    }
    fix = bytes(UBXMessage("NAV", "NAV-PVT", 0, iTOW=itow_ms, **pvt).serialize())
    fix += bytes(UBXMessage("NAV", "NAV-EOE", 0, iTOW=itow_ms).serialize())
    raw = frame(0x15, rawx(GOOD))
    data = raw + fix if first else fix + raw
    published = list(Process(Config()).handle(GnssRaw(received_ns=NS, source="gnss0", data=data)))
    (made,) = (gnss_fix for gnss_fix in published if isinstance(gnss_fix, GnssFix))
    (epoch,) = (gnss_raw_epoch for gnss_raw_epoch in published if isinstance(gnss_raw_epoch, GnssRawEpoch))
    assert epoch.sampled_ns == made.sampled_ns < NS
    assert epoch.gps_time_ns == WEEK * 604_800 * NS + round(TOW_S * NS)
