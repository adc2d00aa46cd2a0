"""Whatever a frame with a valid checksum holds is decoded or rejected by name, and its neighbours are kept."""

import struct
from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from operator import xor
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.parsers.can import process as can
from services.parsers.can.standards import StandardSpeeds
from services.parsers.gnss import process as gnss
from services.parsers.imu import process as imu
from services.parsers.v2x import process as v2x
from shared.errors import TooManyFaults
from shared.faults import FAULT, RANGE
from shared.maths.crc import fletcher
from shared.messages.base import Message
from shared.messages.gnss import GnssFix, GnssRaw
from shared.messages.imu import ImuRaw, ImuSamples
from shared.messages.v2x import CamList
from shared.messages.vehicle import CanRaw, VehicleSpeed, WheelSpeeds
from shared.protocols import xbus
from shared.protocols.ubx import SYNC
from shared.v2x import cam, geonetworking, its_time
from tests.support.v2x import cams

NOW_NS = 1_795_000_000 * 10**9
NAV = (0x03, 0x04, 0x07, 0x14, 0x22, 0x35, 0x36, 0x3C, 0x43)
UBX = [(0x01, kind) for kind in NAV] + [(0x02, 0x13), (0x02, 0x15), (0x0A, 0x38), (0x27, 0x09), (0x06, 0x8B)]
WORDS = st.sampled_from(
    ["", "A", "V", "1", "0", "-1", "nan", "inf", "1e308", "9" * 40, "N", "S", "E", "W", "3", "250060.00", "235960.99",
     "9000.0000", "18000.0000", "-9.9.9", "é", "010180", "311299", "%", " "],
) | st.text(st.characters(min_codepoint=32, max_codepoint=126, exclude_characters="$*,"), max_size=8)  # fmt: skip


def ubx(kind: tuple[int, int], payload: bytes) -> bytes:
    body = struct.pack("<BBH", *kind, len(payload)) + payload
    return SYNC + body + fletcher(body)


def sentence(kind: str, fields: Sequence[str]) -> bytes:
    body = ",".join((kind, *fields)).encode("ascii", "replace")
    return b"$%s*%02X\r\n" % (body, reduce(xor, body, 0))


def fed(process: gnss.Process, *frames: bytes) -> list[Message]:
    return [
        item
        for k, data in enumerate(frames)
        for item in process.handle(GnssRaw(received_ns=NOW_NS + k * 10**8, source="g", data=data))
    ]


def good_sentences(second: int) -> bytes:
    return sentence(
        "GNRMC", [f"0102{second:02}.00", "A", "4230.0", "N", "01315.0", "E", "1.0", "9.0", "211126", "", ""]
    )


@given(st.sampled_from(UBX), st.binary(max_size=140), st.sampled_from([0, 8, 12, 16, 18, 44, 64, 84, 92, 100]))
@settings(max_examples=300, deadline=None)
def test_any_ubx_payload(kind: tuple[int, int], payload: bytes, size: int) -> None:
    process = gnss.Process(gnss.Config())
    itow = struct.pack("<I", 1000)
    filled = payload if kind[0] != 1 else itow + payload.ljust(size, payload[-1:] or b"\xff")
    fed(process, ubx(kind, filled), ubx((1, 0x61), itow))
    assert process.rejects[FAULT] == process.rejects[RANGE] == 0, process.rejects


@given(
    st.lists(st.tuples(st.sampled_from(["GNRMC", "GNGGA", "GNGSA", "GNGST"]), st.lists(WORDS, max_size=18)), max_size=4)
)
@settings(max_examples=300, deadline=None)
def test_any_sentence(sentences: list[tuple[str, list[str]]]) -> None:
    process = gnss.Process(gnss.Config())
    found = fed(process, *(sentence(*pair) for pair in sentences), good_sentences(58), good_sentences(59))
    assert process.rejects[FAULT] == process.rejects[RANGE] == 0, process.rejects
    assert any(isinstance(message, GnssFix) and message.utc_ns is not None for message in found)


FIELDS = (xbus.TEMPERATURE, xbus.BARO_PRESSURE, xbus.MAGNETIC_FIELD, xbus.ACCELERATION, xbus.RATE_OF_TURN, xbus.DELTA_V,
          xbus.DELTA_Q, xbus.SAMPLE_TIME_FINE, xbus.PACKET_COUNTER, xbus.STATUS_WORD)  # fmt: skip


@given(st.dictionaries(st.sampled_from(FIELDS), st.binary(min_size=32, max_size=32), max_size=10), st.integers(0, 3))
@settings(max_examples=300, deadline=None)
def test_any_measurement_of_an_imu(content: dict[int, bytes], number_format: int) -> None:
    process = imu.Process(imu.Config())
    data = b""
    for kind, value in content.items():
        name = kind | (number_format if kind in xbus._REALS else 0)
        size = xbus._layout(name)[0].size
        data += struct.pack(">HB", name, size) + value[:size]
    good = {xbus.SAMPLE_TIME_FINE: (5,), xbus.ACCELERATION: (0, 0, 9.8), xbus.RATE_OF_TURN: (0, 0, 0)}
    frames = xbus.encode_message(xbus.MTDATA2, data)
    frames += xbus.encode_mtdata2({kind: xbus.encode_field(kind, *values) for kind, values in good.items()})
    found = list(process.handle(ImuRaw(received_ns=NOW_NS, source="i", data=frames)))
    assert process.rejects[FAULT] == process.rejects[RANGE] == 0, process.rejects
    assert isinstance(found[0], ImuSamples)


@given(st.lists(st.tuples(st.integers(0, 2**29 - 1), st.booleans(), st.binary(max_size=8)), max_size=5))
def test_any_can_frame(frames: list[tuple[int, bool, bytes]]) -> None:
    process = can.Process(can.Config())
    lines = [
        f"({NOW_NS // 10**9}.000000) can0 {n:08X}#{data.hex()}"
        if extended
        else f"(9999999999.9) c {n % 2048:03X}#{data.hex()}"
        for n, extended, data in frames
    ]
    text = "\n".join([*lines, f"({NOW_NS // 10**9}.000001) can0 7E8#03410D32AAAAAAAA", ""]).encode()
    found = list(process.handle(CanRaw(received_ns=NOW_NS + 10**6, source="can0", data=text)))
    assert isinstance(found[-1], VehicleSpeed)
    assert process.rejects[FAULT] == process.rejects[RANGE] == 0, process.rejects


def test_a_signal_of_any_scale_costs_its_own_frame(tmp_path: Path) -> None:
    """1e300 km/h a bit, an offset that is not a number: what cantools makes of it is a reject."""
    for scale, offset in (("1e300", "0"), ("1", "1e308"), ("1e-320", "0")):
        path = tmp_path / "wheels.dbc"
        path.write_text(f'VERSION ""\nBU_: E\nBO_ 20 W: 8 E\n SG_ FL : 0|64@1+ ({scale},{offset}) [0|0] "km/h" E\n')
        config = can.Config(
            dbc_file=path, wheel_speed_signals=can.WheelSignals(front_left="FL"), wheel_speed_period_s=0
        )
        process = can.Process(config)
        lines = b"(1795000000.000000) can0 014#FFFFFFFFFFFFFFFF\n" * 5
        found = list(process.handle(CanRaw(received_ns=NOW_NS, source="can0", data=lines)))
        assert all(isinstance(item, WheelSpeeds) for item in found)
        assert process.rejects[FAULT] == 0


def packet(path_time: int | None = None, station_id: int = 1) -> bytes:
    time_ms = its_time.its_time_ms(NOW_NS) % its_time.CYCLE_MS
    payload = cam.encode(cams.BRAKING.model_copy(update={"station_id": station_id}), time_ms)
    if path_time is not None:
        record = cam.specification().decode("CAM", payload)
        low = record["cam"]["camParameters"]["lowFrequencyContainer"][1]
        low["pathHistory"][0]["pathDeltaTime"] = path_time
        payload = bytes(cam.specification().encode("CAM", record))
    return geonetworking.encode_packet(payload, replace(cams.SENDER, its_time_ms=its_time.its_time_ms(NOW_NS)))


@pytest.mark.parametrize("path_time", [0, -5, 65_536, 70_000, 2**63, 10**400])
def test_a_path_time_outside_its_range_is_unavailable_and_costs_neither_its_cam_nor_those_behind_it(
    path_time: int,
) -> None:
    process = v2x.Process(v2x.Config())
    batch = cams.batch([packet(station_id=1), packet(path_time, station_id=2), packet(station_id=3)], NOW_NS)
    (found,) = process.handle(batch)
    assert isinstance(found, CamList)
    assert [cam.station_id for cam in found.cams] == [1, 2, 3]
    times = [cam.low_frequency.path[0].delta_time_s for cam in found.cams if cam.low_frequency]
    assert times == [1.5, None, 1.5]
    assert not process.rejects


@given(st.lists(st.tuples(st.integers(40, 400), st.integers(0, 255)), min_size=1, max_size=12))
@settings(max_examples=200, deadline=None)
def test_any_damaged_cam_costs_itself_only(damage: list[tuple[int, int]]) -> None:
    process, damaged = v2x.Process(v2x.Config()), bytearray(packet())
    for place, value in damage:
        damaged[place % len(damaged)] = value
    (found,) = process.handle(cams.batch([packet(), bytes(damaged), packet()], NOW_NS))
    assert isinstance(found, CamList)
    assert len(found.cams) >= 2 and process.rejects[FAULT] == 0, process.rejects


@pytest.mark.parametrize(
    "error", [ValueError("x"), OverflowError("x"), KeyError("x"), struct.error("x"), TypeError("x")]
)
def test_an_error_that_no_decoder_foresaw_costs_its_item_and_the_third_in_ten_seconds_ends_the_process(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    process, faulty = v2x.Process(v2x.Config()), [False, True, False]
    decode = v2x.Process._decode

    def fails_at_times(self: v2x.Process, *frame: object) -> object:
        if faulty.pop(0):
            raise error
        return decode(self, *frame)  # type: ignore[arg-type]

    monkeypatch.setattr(v2x.Process, "_decode", fails_at_times)
    (found,) = process.handle(cams.batch([packet()] * 3, NOW_NS))
    assert isinstance(found, CamList) and len(found.cams) == 2
    assert process.rejects == {FAULT: 1}
    faulty += [True, True]
    with pytest.raises(TooManyFaults):
        list(process.handle(cams.batch([packet()] * 2, NOW_NS + 9 * 10**9)))


@pytest.mark.parametrize("kind", ["gnss", "can", "imu"])
def test_a_fault_of_one_frame_leaves_those_beside_it(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    process, batch, method = _three_items(kind)
    calls = iter((False, True, False))
    original = getattr(method[0], method[1])

    def second_fails(*arguments: object) -> object:
        if next(calls):
            raise OverflowError("too large")
        return original(*arguments)

    monkeypatch.setattr(method[0], method[1], second_fails)
    found = list(process.handle(batch))
    assert process.rejects[FAULT] == 1
    samples = [ns for imu_samples in found if isinstance(imu_samples, ImuSamples) for ns in imu_samples.sampled_ns]
    assert len(samples + [item for item in found if isinstance(item, GnssFix | VehicleSpeed)]) == 2


def _three_items(kind: str) -> tuple[gnss.Process | can.Process | imu.Process, Message, tuple[object, str]]:
    if kind == "gnss":
        data = b"".join(good_sentences(second) for second in (1, 2, 3))
        from services.parsers.gnss.nmea.dialect import NmeaDialect

        return gnss.Process(gnss.Config()), GnssRaw(received_ns=NOW_NS, source="g", data=data), (NmeaDialect, "_fix")
    if kind == "can":
        data = b"(1795000000.000000) can0 7E8#03410D32AAAAAAAA\n" * 3
        return (
            can.Process(can.Config()),
            CanRaw(received_ns=NOW_NS, source="c", data=data),
            (StandardSpeeds, "decode"),
        )
    from services.parsers.imu import xsens

    fields = [
        {xbus.SAMPLE_TIME_FINE: (100 * k,), xbus.ACCELERATION: (0, 0, 9.8), xbus.RATE_OF_TURN: (0, 0, 0)}
        for k in range(3)
    ]
    data = b"".join(xbus.encode_mtdata2({i: xbus.encode_field(i, *v) for i, v in field.items()}) for field in fields)
    return imu.Process(imu.Config()), ImuRaw(received_ns=NOW_NS, source="i", data=data), (xsens, "inertial_data")
