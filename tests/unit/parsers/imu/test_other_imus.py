"""IMUs beside Xsens: that of a u-blox receiver, and any that sends lines of text."""

import math
import struct
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from pyubx2.ubxreader import UBXReader

from services.parsers.gnss.process import Config as GnssConfig
from services.parsers.gnss.process import Process as GnssProcess
from services.parsers.gnss.ubx.wheel_ticks import WheelTicks
from services.parsers.imu.lines import LineForm
from services.parsers.imu.process import Config, Process
from shared.messages.gnss import GnssRaw
from shared.messages.imu import ImuRaw, ImuSamples
from shared.messages.operation import MessageUse
from shared.messages.vehicle import VehicleSpeed
from shared.protocols.ubx import ubx_frame
from tests.support.cases import each
from tests.support.data import recording
from tests.support.gnss.ublox import parse_ubx

NS = 1_000_000_000
START_NS = 1_795_000_000 * NS
LEVEL = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def config(line: LineForm | None = None) -> Config:
    return Config.model_validate({"line": line, "vehicle": {"imu": {"body_from_sensor": LEVEL}}})


def esf_raw(tags: list[int], force: tuple[float, ...] = (0.5, -0.25, 9.75), rate_deg_s: float = 10.0) -> bytes:
    """A frame as a receiver sends it: seven values a time tag."""
    payload = bytes(4)
    for tag in tags:
        for kind, value in ((5, rate_deg_s), (13, 0.0), (14, -rate_deg_s)):
            payload += struct.pack("<II", kind << 24 | round(value * 4096) & 0xFFFFFF, tag)
        for kind, value in ((16, force[0]), (17, force[1]), (18, force[2])):
            payload += struct.pack("<II", kind << 24 | round(value * 1024) & 0xFFFFFF, tag)
        payload += struct.pack("<II", 12 << 24 | 2500, tag)  # temperature
    return ubx_frame(0x10, 0x03, payload)


def drive(process: Process, tick_s: float, seconds: float, source: str = "gnss0/imu") -> list[ImuSamples]:
    """Ten samples a tenth of a second, as a receiver sends them."""
    found: list[ImuSamples] = []
    for k in range(round(seconds * 10)):
        tags = [round((k * 0.1 + i * 0.01) / tick_s) + (1 << 32) - round(1.0 / tick_s) for i in range(10)]
        data = esf_raw([tag % (1 << 32) for tag in tags])
        found += process.handle(ImuRaw(received_ns=START_NS + round((k + 1) * 0.1 * NS), source=source, data=data))
    return found


@pytest.mark.parametrize("tick_s", [1e-3, 25.6e-6, 1 / 65536, 3.3e-5])
def test_a_receivers_imu_is_read_whatever_the_unit_of_its_time_tag(tick_s: float) -> None:
    process = Process(config())
    found = drive(process, tick_s, 8.0)
    assert not process.rejects.total()
    sample = found[-1]
    assert len(sample.sampled_ns) == 10
    assert sample.specific_force_body_m_s2[0] == pytest.approx((0.5, -0.25, 9.75), abs=1e-3)
    assert sample.angular_rate_body_rad_s[0] == pytest.approx((-math.radians(10), 0.0, math.radians(10)), abs=1e-4)
    steps = [b - a for a, b in zip(sample.sampled_ns, sample.sampled_ns[1:], strict=False)]
    assert steps == pytest.approx([10_000_000] * 9, rel=0.05)
    assert found[0].received_ns >= START_NS + 3 * NS, "its unit is found out first"


def test_frames_of_a_receivers_imu_are_what_pyubx2_reads() -> None:
    message = UBXReader.parse(esf_raw([1000]))
    assert message.identity == "ESF-RAW"


def test_the_parser_of_the_receiver_passes_inertial_frames_on_only_where_it_should() -> None:
    raw = GnssRaw(received_ns=START_NS, source="gnss0", data=esf_raw([1000]))
    assert not list(GnssProcess(GnssConfig()).handle(raw))
    (passed,) = GnssProcess(GnssConfig(use_receiver_imu=True)).handle(raw)
    assert isinstance(passed, ImuRaw) and (passed.source, passed.data) == ("gnss0/imu", raw.data)


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (ubx_frame(0x10, 0x03, bytes(9)), "ubx_short"),
        (ubx_frame(0x10, 0x03, bytes(4) + struct.pack("<II", 5 << 24, 7)), "incomplete_sample"),
        (esf_raw([1000])[:-1] + b"\x00" * 2, "ubx_checksum"),
    ],
)
def test_a_damaged_frame_is_one_counted_reject(data: bytes, kind: str) -> None:
    process = Process(config())
    drive(process, 1e-3, 0.2)
    list(process.handle(ImuRaw(received_ns=START_NS + NS, source="gnss0/imu", data=data)))
    assert process.rejects[kind] == 1


CSV = LineForm(
    acceleration=("2", "3", "4"), acceleration_unit_m_s2=9.80665, rate=("5", "6", "7"),
    rate_unit_rad_s=math.radians(1.0), time="1", time_unit_s=1e-3,
)  # fmt: skip
JSON = LineForm(
    form="json", time="t", time_unit_s=1.0, acceleration=("acc.0", "acc.1", "acc.2"),
    rate=("gyro.x", "gyro.y", "gyro.z"),
)  # fmt: skip


def fed(process: Process, *lines: bytes) -> list[ImuSamples]:
    found: list[ImuSamples] = []
    for k, line in enumerate(lines):
        found += process.handle(ImuRaw(received_ns=START_NS + k * NS // 100, source="imu0", data=line))
    return found


def test_csv_lines_are_read_by_their_mapping_also_in_parts() -> None:
    process = Process(config(CSV))
    found = fed(process, b"1000,0,0,-1,10,0,0\r\n1010,0,", b"0,-1,10,0,0\n")
    assert [len(imu_samples.sampled_ns) for imu_samples in found] == [1, 1]
    assert found[0].specific_force_body_m_s2[0] == pytest.approx((0.0, 0.0, -9.80665))
    assert found[0].angular_rate_body_rad_s[0] == pytest.approx((math.radians(10), 0.0, 0.0))
    assert found[1].sampled_ns[0] - found[0].sampled_ns[0] == pytest.approx(10_000_000, abs=100_000)
    assert not process.rejects.total()


def test_json_lines_are_read_by_the_names_of_their_fields() -> None:
    process = Process(config(JSON))
    line = b'{"t": 1.5, "acc": [0, 0, 9.8], "gyro": {"x": 0.1, "y": 0, "z": "0.2"}}\n'
    (sample,) = fed(process, line)
    assert sample.specific_force_body_m_s2 == ((0.0, 0.0, 9.8),)
    assert sample.angular_rate_body_rad_s == ((0.1, 0.0, 0.2),)


@each(
    ("form", "line", "kind"),
    [
        (CSV, b"1000,0,0\n", "line_column"), (CSV, b"1000,0,0,x,0,0,0\n", "line_column"),
        (CSV, b"1000,0,0,nan,0,0,0\n", "not_finite"), (CSV, b"1000,0,0,1e9,0,0,0\n", "out_of_range"),
        (CSV, b"1e300,0,0,1,0,0,0\n", "out_of_range"), (CSV, b"1" * 5000, "line_length"),
        (JSON, b"{\n", "line_form"), (JSON, b"[1]\n", "line_form"), (JSON, b'{"t": true}\n', "line_column"),
        (JSON, b"[" * 900 + b"\n", "line_form"),
    ],
)  # fmt: skip
def test_a_line_that_is_not_of_the_form_is_one_counted_reject(form: LineForm, line: bytes, kind: str) -> None:
    process = Process(config(form))
    assert not fed(process, line)
    assert process.rejects == {kind: 1}


def test_lines_that_begin_otherwise_are_counted_as_not_used() -> None:
    process = Process(config(CSV.model_copy(update={"begins": "$IMU,"})))
    (sample,) = fed(process, b"$TEMP,21\n$IMU,1000,0,0,1,0,0,0\n")
    assert sample.specific_force_body_m_s2[0][2] == pytest.approx(9.80665)
    assert {kind.kind: kind.count for kind in process.kinds.table()} == {"line that begins otherwise": 1, "line": 1}


@pytest.mark.parametrize("columns", [("0", "2", "3"), ("x", "2", "3"), ("1", "2", "201")])
def test_a_column_of_csv_that_is_no_number_is_an_error_of_the_vehicles_file(columns: tuple[str, str, str]) -> None:
    with pytest.raises(ValidationError, match="columns of csv lines are numbers"):
        LineForm(acceleration=columns)


@given(st.lists(st.binary(max_size=300), max_size=5), st.sampled_from([None, CSV, JSON]))
def test_any_bytes_are_read_without_an_error(chunks: list[bytes], form: LineForm | None) -> None:
    process = Process(config(form))
    drive(process, 1e-3, 0.1)
    for chunk in chunks:
        for source in ("gnss0/imu", "imu0"):
            list(process.handle(ImuRaw(received_ns=START_NS, source=source, data=chunk + b"\n")))


def esf_meas(tag_ms: int, *fields: tuple[int, int]) -> bytes:
    words = b"".join(struct.pack("<I", kind << 24 | field) for kind, field in fields)
    payload = struct.pack("<IHH", tag_ms, len(fields) << 11, 0) + words
    read = parse_ubx(ubx_frame(0x10, 0x02, payload))
    assert (read.numMeas, read.dataType_01, read.dataField_01) == (len(fields), *fields[0])
    return payload


def test_wheel_ticks_and_speeds_of_a_receiver_are_speeds_of_the_vehicle() -> None:
    ticks = WheelTicks(metres_per_tick=0.05)
    assert ticks.take(esf_meas(1000, (10, 8_388_600))) is None
    assert ticks.take(esf_meas(1500, (10, 92))) == pytest.approx(0.05 * 100 / 0.5), "the count has wrapped"
    assert ticks.take(esf_meas(2000, (10, 92 + 100 | 1 << 23))) == pytest.approx(-10.0)
    assert ticks.take(esf_meas(2500, (11, 0xFFFC18))) == pytest.approx(-1.0)
    assert ticks.take(esf_meas(99_000, (10, 5))) is None, "a pause tells no speed"
    assert WheelTicks(0.0).take(esf_meas(1000, (8, 1), (9, 1))) is None


@pytest.mark.recording
def test_recorded_wheel_ticks_at_standstill_are_no_speed() -> None:
    process = GnssProcess(GnssConfig(metres_per_wheel_tick=0.1))
    data = (recording("gpsd_receiver_logs/ublox-neo-m8l.log")).read_bytes()
    found = list(process.handle(GnssRaw(received_ns=START_NS, source="gnss0", data=data)))
    speeds = [vehicle_speed.speed_m_s for vehicle_speed in found if isinstance(vehicle_speed, VehicleSpeed)]
    assert len(speeds) > 50 and set(speeds) == {0.0}


WITHOUT_TIME = LineForm(time="", acceleration=("1", "2", "3"), rate=("4", "5", "6"))
LINE = b"0.01,-0.02,9.81,0.1,0.0,-0.1"
PERIOD_NS = NS // 200


@each("line_end", [b"\r\n", b"\n", b"\r"])
@each("waits_ms", [(5,), (20,), (20, 21, 19), (4, 12, 20, 50), (3, 100)])
def test_lines_without_a_time_are_stamped_evenly_however_many_come_in_one_read(
    waits_ms: tuple[int, ...], line_end: bytes
) -> None:
    """Reads begin and end anywhere within a line."""
    process, stamps, now_ns, sent = Process(config(WITHOUT_TIME)), list[int](), START_NS, 0
    stream, size = (LINE + line_end) * 4000, len(LINE + line_end)
    for k in range(500):
        now_ns += waits_ms[k % len(waits_ms)] * NS // 1000
        until = min((now_ns - START_NS) * size // PERIOD_NS, len(stream))
        for message in process.handle(ImuRaw(received_ns=now_ns, source="imu0", data=stream[sent:until])):
            stamps += message.sampled_ns
            assert message.sampled_ns[-1] <= now_ns
        sent = until
    assert len(stamps) == sent // size and not process.rejects.total()
    steps = [later - earlier for earlier, later in pairwise(stamps[200:])]
    assert steps == pytest.approx([PERIOD_NS] * len(steps), abs=0.5 * PERIOD_NS)


def test_a_pause_of_lines_without_a_time_is_a_gap_and_does_not_change_the_period() -> None:
    process, stamps = Process(config(WITHOUT_TIME)), list[int]()
    arrivals_ns = [START_NS + k * 20_000_000 + (3 * NS if k >= 100 else 0) for k in range(200)]
    for at_ns in arrivals_ns:
        for message in process.handle(ImuRaw(received_ns=at_ns, source="imu0", data=(LINE + b"\n") * 4)):
            stamps += message.sampled_ns
    steps = [later - earlier for earlier, later in pairwise(stamps)]
    assert max(steps) == pytest.approx(3 * NS + PERIOD_NS, rel=0.01) and steps.count(max(steps)) == 1
    assert steps[500:] == pytest.approx([PERIOD_NS] * len(steps[500:]), rel=0.01)


@pytest.mark.parametrize("begins", ["#IMU,", "$IMU,", "!", ""])
def test_what_begins_with_a_hash_is_read_where_that_is_configured_and_counted_where_not(begins: str) -> None:
    process = Process(config(LineForm(begins=begins)))
    lines = [begins.encode() + b"%d," % (1000 + 10 * k) + LINE for k in range(5)]
    found = fed(process, b"\n".join([*lines, b"# a comment", b""]))
    assert sum(len(imu_samples.sampled_ns) for imu_samples in found) == 5
    (other,) = [kind for kind in process.kinds.table() if kind.use is MessageUse.UNUSED]
    assert other.count == 1


def test_lines_that_are_not_described_are_a_reject_that_says_so() -> None:
    process = Process(config())
    assert not fed(process, b"$IMU,1,2\r\n" * 5, b"$IMU,3,4\r\n")
    assert process.rejects == {"line_not_described": 6}
