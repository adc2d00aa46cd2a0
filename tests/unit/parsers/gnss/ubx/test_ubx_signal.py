"""NAV-STATUS, NAV-CLOCK, MON-RF and SEC-SIG against pyubx2 as an independent reader, and against invalid bytes."""

import struct
from collections import Counter
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyubx2.ubxmessage import UBXMessage
from pyubx2.ubxtypes_core import UBX_MSGIDS

from services.parsers.gnss.process import Config, Process
from services.parsers.gnss.protocols import FRAMINGS
from services.parsers.gnss.ubx import signal
from services.parsers.gnss.ubx.messages import UbxError
from shared.maths.crc import fletcher
from shared.messages.gnss import (
    GnssRaw,
    GnssSignalQuality,
    InterferenceState,
    RadioPath,
    ReceiverClock,
    ReceiverStatus,
    SignalFlags,
)
from shared.protocols.framing.framer import Framer
from shared.protocols.ubx import SYNC
from tests.support.cases import each
from tests.support.data import recording
from tests.support.gnss.ublox import parse_ubx

NS = 1_000_000_000
UNKNOWN, NONE, INDICATED, SEVERE = InterferenceState
ITOW_MS = 136_819_000


def frame(group: int, number: int, payload: bytes) -> bytes:
    body = struct.pack("<BBH", group, number, len(payload)) + payload
    return SYNC + body + fletcher(body)


def status(spoofing: int = 1) -> bytes:
    """Payload with all other bits set that a receiver may set."""
    return struct.pack("<I4B2I", ITOW_MS, 3, 0x0F, 0xC3, 0xC7 | spoofing << 3, 26_000, 90_000)


def clock(bias_ns: int = -4321, drift_ns_s: int = 87) -> bytes:
    return struct.pack("<I2i2I", ITOW_MS, bias_ns, drift_ns_s, 12, 345)


def radio(*jamming: int) -> bytes:
    paths = (
        struct.pack("<4BI4x2H5B3x", number, flags, 2, 1, 0, 90, 4096, 51, 3, 120, 4, 120)
        for number, flags in enumerate(jamming)
    )
    return struct.pack("<2B2x", 0, len(jamming)) + b"".join(paths)


def security(jamming: int = 3, spoofing: int = 3) -> bytes:
    """Version 1: bit 0 is "enabled", the state is in the bits above it."""
    return struct.pack("<B3xB3xB3x", 1, jamming, spoofing)


def independently(group: str, kind: str, payload: bytes) -> Any:
    return UBXMessage(group, kind, 0, payload=payload)


@given(st.integers(0, 3), st.integers(0, 255))
def test_the_spoofing_state_of_nav_status_is_what_pyubx2_reads(spoofing: int, rest: int) -> None:
    payload = struct.pack("<I4B2I", ITOW_MS, 3, 0x0F, 0, rest & 0xE7 | spoofing << 3, 26_000, 90_000)
    read = independently("NAV", "NAV-STATUS", payload)
    found = signal.decode("NAV-STATUS", payload)
    assert found == ReceiverStatus(
        spoofing=list(InterferenceState)[read.spoofDetState],
        time_to_first_fix_s=read.ttff / 1000,
    )


@given(*[st.integers(-(2**31), 2**31 - 1)] * 2, *[st.integers(0, 2**32 - 1)] * 2)
def test_every_field_of_nav_clock_is_what_pyubx2_reads(bias: int, drift: int, time: int, frequency: int) -> None:
    payload = struct.pack("<I2i2I", ITOW_MS, bias, drift, time, frequency)
    read = independently("NAV", "NAV-CLOCK", payload)
    found = signal.decode("NAV-CLOCK", payload)
    assert isinstance(found, ReceiverClock)
    assert found.bias_s == pytest.approx(read.clkB * 1e-9) and found.drift_ratio == pytest.approx(read.clkD * 1e-9)
    assert found.bias_sd_s == pytest.approx(read.tAcc * 1e-9)
    assert found.drift_sd_ratio == pytest.approx(read.fAcc * 1e-12)


@given(st.lists(st.binary(min_size=24, max_size=24), max_size=8))
def test_every_field_of_mon_rf_is_what_pyubx2_reads(paths: list[bytes]) -> None:
    payload = struct.pack("<2B2x", 0, len(paths)) + b"".join(paths)
    read = independently("MON", "MON-RF", payload)
    found = signal.decode("MON-RF", payload)
    assert isinstance(found, tuple) and len(found) == read.nBlocks
    for k, path in enumerate(found, 1):
        block = {name: getattr(read, f"{name}_{k:02d}") for name in
                 ("blockId", "jammingState", "noisePerMS", "agcCnt", "jamInd")}  # fmt: skip
        assert (path.number, path.noise_level) == (block["blockId"], block["noisePerMS"])
        assert path.jamming is list(InterferenceState)[block["jammingState"]]
        assert path.gain_ratio == pytest.approx(min(block["agcCnt"] / 8191, 1.0))
        assert path.narrowband_ratio == pytest.approx(block["jamInd"] / 255)


@given(st.integers(0, 255), st.integers(0, 255))
def test_the_flags_of_sec_sig_version_1_are_what_pyubx2_reads(jamming: int, spoofing: int) -> None:
    payload = security(jamming, spoofing)
    read = parse_ubx(frame(0x27, 9, payload))
    expected = (
        list(InterferenceState)[read.jammingState] if read.jamDetEnabled else UNKNOWN,
        (list(InterferenceState) + [UNKNOWN] * 4)[read.spoofingState] if read.spfDetEnabled else UNKNOWN,
    )
    found = signal.decode("SEC-SIG", payload)
    assert isinstance(found, SignalFlags) and (found.jamming, found.spoofing) == expected


@given(st.integers(0, 127), st.integers(0, 3))
def test_the_flags_of_sec_sig_version_2_are_what_pyubx2_reads(flags: int, frequencies: int) -> None:
    payload = struct.pack("<4B", 2, flags, 0, frequencies) + b"\1\2\3\1" * frequencies
    read = parse_ubx(frame(0x27, 9, payload))
    expected = (
        list(InterferenceState)[read.jammingState] if read.jamDetEnabled else UNKNOWN,
        (list(InterferenceState) + [UNKNOWN] * 4)[read.spoofingState] if read.spfDetEnabled else UNKNOWN,
    )
    found = signal.decode("SEC-SIG", payload)
    assert isinstance(found, SignalFlags) and (found.jamming, found.spoofing) == expected


QUIET = {(1, 3): status(), (1, 0x22): clock(), (10, 0x38): radio(1, 1), (0x27, 9): security()}
RAISED: tuple[tuple[tuple[int, int], bytes, str], ...] = (
    ((1, 3), status(2), "status.spoofing"),
    ((1, 3), status(3), "status.spoofing"),
    ((10, 0x38), radio(2, 1), "radio_paths.0.jamming"),
    ((10, 0x38), radio(1, 3), "radio_paths.1.jamming"),
    ((0x27, 9), security(jamming=5), "security.jamming"),
    ((0x27, 9), security(jamming=7), "security.jamming"),
    ((0x27, 9), security(spoofing=5), "security.spoofing"),
    ((0x27, 9), security(spoofing=7), "security.spoofing"),
    ((1, 0x22), clock(bias_ns=100_000), "clock.bias_s"),
    ((1, 0x22), clock(drift_ns_s=-300), "clock.drift_ratio"),
)


def published(payloads: dict[tuple[int, int], bytes]) -> GnssSignalQuality:
    """What one epoch publishes: the parts collected before the next message of a kind arrives."""
    process = Process(Config())
    data = b"".join(frame(key[0], key[1], payload) for key, payload in payloads.items())
    first = list(process.handle(GnssRaw(received_ns=NS, source="gnss0", data=data)))
    assert not first
    (message,) = process.handle(GnssRaw(received_ns=2 * NS, source="gnss0", data=frame(1, 3, status())))
    assert isinstance(message, GnssSignalQuality) and not process.rejects
    return message


def leaves(value: object, name: str = "") -> dict[str, object]:
    """Every value of a nested document, by its dotted name."""
    if isinstance(value, dict):
        return {k: v for key, inner in value.items() for k, v in leaves(inner, f"{name}.{key}".strip(".")).items()}
    if isinstance(value, list | tuple):
        return {k: v for key, inner in enumerate(value) for k, v in leaves(inner, f"{name}.{key}").items()}
    return {name: value}


@each(("message", "payload", "field"), RAISED)
def test_each_flag_raised_alone_changes_exactly_its_own_field(
    message: tuple[int, int], payload: bytes, field: str
) -> None:
    before = leaves(published(QUIET).model_dump())
    after = leaves(published({**QUIET, message: payload}).model_dump())
    assert {name for name in before if before[name] != after[name]} == {field}


@each(
    ("kind", "payload", "reason"),
    [
        ("SEC-SIG", b"\3" + security()[1:], "version"),
        ("SEC-SIG", b"\0" + security()[1:], "version"),
        ("MON-RF", b"\1" + radio(1)[1:], "version"),
        ("MON-RF", b"", "short"),
        ("SEC-SIG", b"", "short"),
        ("SEC-SIG", security()[:11], "short"),
        ("SEC-SIG", b"\2\3", "short"),
        ("MON-RF", radio(1, 1)[:-1], "short"),
        ("MON-RF", b"\0\x09\0\0" + bytes(9 * 24), "short"),
        ("NAV-STATUS", status()[:-1], "short"),
        ("NAV-CLOCK", clock()[:-1], "short"),
    ],
)
def test_an_unknown_version_or_a_truncated_message_is_rejected_and_counted(
    kind: str, payload: bytes, reason: str
) -> None:
    with pytest.raises(UbxError, match=reason):
        signal.decode(kind, payload)
    key = next(key for key, name in UBX_MSGIDS.items() if name == kind)
    process = Process(Config())
    assert not list(process.handle(GnssRaw(received_ns=NS, source="gnss0", data=frame(key[0], key[1], payload))))
    assert process.rejects == Counter({f"ubx_{reason}": 1})


def test_a_disabled_detector_is_unknown_for_any_state() -> None:
    off = signal.decode("SEC-SIG", security(jamming=6, spoofing=6))
    assert off == SignalFlags(jamming=UNKNOWN, spoofing=UNKNOWN)


@given(st.sampled_from(list(signal.FIELDS)), st.binary(max_size=240))
def test_any_payload_is_decoded_or_rejected(kind: str, payload: bytes) -> None:
    try:
        signal.decode(kind, payload)
    except UbxError as fault:
        assert str(fault) in ("ubx_short", "ubx_version")


@pytest.mark.recording
@pytest.mark.parametrize(
    ("folder", "name", "least"),
    [
        ("gpsd_receiver_logs", "ublox-zed-f9r.log", 37),
        ("gpsd_receiver_logs", "u-blox-m8t-time.log", 151),
        ("pyubx2_logs", "pygpsdata-MIXED.log", 32),
    ],
)
def test_a_recorded_receivers_signal_quality_is_what_pyubx2_reads(folder: str, name: str, least: int) -> None:
    frames = [frame.data for frame in Framer(FRAMINGS).feed((recording(folder) / name).read_bytes()) if
              frame.protocol == "UBX"]  # fmt: skip
    found = 0
    for data in frames:
        kind = UBX_MSGIDS.get(data[2:4])
        if kind not in signal.FIELDS:
            continue
        found += 1
        part, read = signal.decode(kind, data[6:-2]), parse_ubx(data)
        match part:
            case SignalFlags():
                assert part.spoofing is list(InterferenceState)[read.spoofDetState]
            case ReceiverClock():
                assert (round(part.bias_s * 1e9), round(part.drift_ratio * 1e9)) == (read.clkB, read.clkD)
            case (RadioPath(), *_):
                assert len(part) == read.nBlocks  # pyubx2 reads blocks of 24 bytes, this receiver sends 20
                assert part[0].gain_ratio == pytest.approx(read.agcCnt_01 / 8191)
                assert [path.number for path in part] == [0, 1]
                assert all(path.gain_ratio is not None and 0.5 < path.gain_ratio < 0.7 for path in part)
    assert found == least
