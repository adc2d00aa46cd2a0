import csv
import pickle
from collections import Counter
from pathlib import Path

import can
import cantools
import pytest
from can.io import CanutilsLogReader
from hypothesis import given
from hypothesis import strategies as st

from services.parsers.can.candump import MAX_LINE, LineReader, parse_line
from services.parsers.can.process import Config, Process, WheelSignals
from services.parsers.can.standards import parameter_group
from shared.chosen import ChosenSource
from shared.errors import UserError
from shared.kinds import Kinds
from shared.messages.imu import ImuRaw
from shared.messages.vehicle import CanRaw, VehicleSignal, VehicleSpeed, WheelSpeeds
from tests.support.cases import each
from tests.support.data import recording

NS = 1_000_000_000
START_NS = 1_764_000_000 * NS
DBC = """VERSION ""
BU_: ECU
BO_ 212 WHEELS: 8 ECU
 SG_ FL : 0|16@1+ (0.01,0) [0|300] "km/h" ECU
 SG_ FR : 16|16@1+ (0.01,0) [0|300] "km/h" ECU
 SG_ RL : 32|16@1+ (0.01,0) [0|300] "km/h" ECU
 SG_ TEMPERATURE : 48|8@1+ (1,0) [0|255] "degC" ECU
BO_ 2566845182 REAR: 2 ECU
 SG_ RR : 0|16@1+ (0.01,0) [0|300] "mph" ECU
"""
WHEELS = WheelSignals(front_left="FL", front_right="FR", rear_left="RL", rear_right="RR")


def line(text: str, at_s: float = 0.0, bus: str = "can0") -> bytes:
    time_us = START_NS // 1000 + round(at_s * 1e6)
    return f"({time_us // 10**6}.{time_us % 10**6:06d}) {bus} {text}\n".encode()


def feed(process: Process, data: bytes, at_s: float = 0.05) -> list[VehicleSpeed | WheelSpeeds]:
    found = process.handle(CanRaw(received_ns=START_NS + round(at_s * NS), source="can0", data=data))
    return [item for item in found if not isinstance(item, VehicleSignal)]


@pytest.fixture
def dbc(tmp_path: Path) -> Path:
    path = tmp_path / "car.dbc"
    path.write_text(DBC)
    return path


@pytest.mark.parametrize("identifier", ["7E8", "18DAF110"])
def test_an_obd_response_gives_a_speed_stamped_with_the_configured_delay(identifier: str) -> None:
    (speed,) = feed(Process(Config(vehicle_speed_delay_s=0.1)), line(f"{identifier}#03410D3200000000", 0.02))
    assert isinstance(speed, VehicleSpeed)
    assert speed.speed_m_s == pytest.approx(50 / 3.6)
    assert speed.resolution_m_s == pytest.approx(1 / 3.6)
    assert speed.source == "can0/obd"
    assert (speed.received_ns, speed.sampled_ns) == (START_NS + NS // 50, START_NS - 8 * NS // 100)


@each(
    ("identifier", "source"),
    [
        *((f"7E{k:X}", f"can0/obd/7E{k:X}") for k in range(9, 16)),
        ("18DAF11D", "can0/obd/18DAF11D"), ("18DAF128", "can0/obd/18DAF128"),
    ],
)  # fmt: skip
@each("padding", ["AAAAAAAA", "55555555", ""])
def test_the_answer_of_any_control_unit_is_a_speed_of_its_own_source(
    identifier: str, source: str, padding: str
) -> None:
    (speed,) = feed(Process(Config()), line(f"{identifier}#03410D32{padding}"))
    assert isinstance(speed, VehicleSpeed)
    assert speed.source == source and speed.speed_m_s == pytest.approx(50 / 3.6)


@pytest.mark.parametrize(
    "frames",
    [
        ["7E8#06410C1AF80D3200"],  # engine speed, then speed
        ["7E8#05410D320F5A0000"],  # speed, then intake temperature
        ["7E8#07410401055A0D32"],
        ["7E8#100941000D0D0D0D", "7E8#210D3200000000"],  # supported PIDs, whose value is no PID
        ["7E8#100C4120000D000D", "7E8#210C0D0D0D325555"],
    ],
)
def test_the_speed_of_an_answer_to_several_pids_is_found(frames: list[str]) -> None:
    data = b"".join(line(text, 0.001 * k) for k, text in enumerate(frames))
    (found,) = feed(Process(Config()), data)
    assert isinstance(found, VehicleSpeed) and found.speed_m_s == pytest.approx(50 / 3.6)


def test_answers_of_several_frames_are_joined_by_sender_and_lost_with_a_missing_frame() -> None:
    first, second = "100B410000000000", "210C1AF80D325555"
    mixed = line(f"7E8#{first}") + line(f"7E9#{first}") + line(f"7E9#{second}") + line(f"7E8#{second}")
    assert [m.source for m in feed(Process(Config()), mixed)] == ["can0/obd/7E9", "can0/obd"]
    assert not feed(Process(Config()), line(f"7E8#{first}") + line("7E8#220C1AF80D325555"))
    assert not feed(Process(Config()), line(f"7E8#{second}"))


def test_two_senders_of_a_speed_are_two_sources_of_which_one_is_chosen() -> None:
    process, chosen = Process(Config()), ChosenSource()
    frames = [("18FEF10B#F700000FFFFFFFFF", 0.0), ("18FEF100#F700500FFFFFFFFF", 80 / 3.6)] * 5
    found = feed(process, b"".join(line(text, 0.01 * k) for k, (text, _) in enumerate(frames)), 0.1)
    speeds: dict[str, set[float]] = {}
    for speed in found:
        assert isinstance(speed, VehicleSpeed)
        speeds.setdefault(speed.source, set()).add(round(speed.speed_m_s * 3.6, 3))
    assert speeds == {"can0/j1939/0B": {0.0}, "can0/j1939/00": {80.0}}
    used = [speed.source for speed in found if chosen.takes(speed.source, speed.received_ns)]
    assert set(used[1:]) == {"can0/j1939/00"}


def test_the_frames_of_two_interfaces_in_one_file_are_two_sources() -> None:
    text = "18FEF100#F700500FFFFFFFFF"
    found = feed(Process(Config()), line(text) + line(text, 0.001, "can1"))
    assert [speed.source for speed in found] == ["can0/j1939/00", "can0/can1/j1939/00"]


def test_error_frames_are_counted() -> None:
    process = Process(Config())
    assert not feed(process, line("20000088#0000000000000000") + line("20000000#"))
    assert process.rejects == {"error_frame": 2}


@pytest.mark.parametrize(
    ("signal", "data", "speed_m_s"),
    [
        ('0|16@1+ (0.01,0) [0|1] "km/h"', "8813", 50 / 3.6),
        ('0|16@1+ (0.01,0) [0|0] "km/h"', "8813", 50 / 3.6),
        ('0|16@1+ (0.01,0) [1|0] "km/h"', "8813", 50 / 3.6),
        ('0|16@1+ (0.01,0) [700|900] "km/h"', "8813", 50 / 3.6),
        ('0|16@1- (0.01,0) [-1|1] "km/h"', "78EC", -50 / 3.6),
        ('0|16@1+ (0.01,0) [0|1] "KPH"', "8813", 50 / 3.6),
        ('0|16@1+ (0.01,0) [0|655.35] "km / h"', "8813", 50 / 3.6),
        ('0|16@1+ (0.01,0) [0|300] "MPH"', "8813", 50 * 0.44704),
        ('0|16@1+ (0.01,0) [0|300] "knots"', "8813", 50 * 1852 / 3600),
        ('0|8@1+ (1,0) [0|1] "km/h"', "32", 50 / 3.6),
        ('0|16@1+ (0.01,0) [0|300] "km/h"', "FF9C", None),  # 401.91 km/h, above a range that is believed
        ('0|12@1+ (0.1,0) [0|1] "km/h"', "FF0F", None),  # all bits: there is no value
    ],
)  # fmt: skip
def test_a_range_that_contradicts_the_bits_is_ignored(
    signal: str, data: str, speed_m_s: float | None, tmp_path: Path
) -> None:
    path = tmp_path / "car.dbc"
    path.write_text(f'VERSION ""\nBU_: ECU\nBO_ 212 WHEELS: {len(data) // 2} ECU\n SG_ WS : {signal} ECU\n')
    process = Process(Config(dbc_file=path, wheel_speed_signals=WheelSignals(rear_left="WS")))
    found = [
        wheel_speeds.rear_left_m_s
        for wheel_speeds in feed(process, line(f"0D4#{data}"))
        if isinstance(wheel_speeds, WheelSpeeds)
    ]
    assert found == ([] if speed_m_s is None else [pytest.approx(speed_m_s)])
    assert process.rejects["wheel_speed"] == (speed_m_s is None)


@pytest.mark.parametrize("unit", ["", "Speed", "deg"])
def test_the_unit_can_be_set_where_the_file_has_none_that_is_known(unit: str, tmp_path: Path) -> None:
    path = tmp_path / "car.dbc"
    path.write_text(f'VERSION ""\nBU_: ECU\nBO_ 212 W: 2 ECU\n SG_ WS : 0|16@1+ (0.01,0) [0|300] "{unit}" ECU\n')
    signals = WheelSignals(rear_left="WS")
    with pytest.raises(UserError, match="state it as `wheel_speed_unit`"):
        Process(Config(dbc_file=path, wheel_speed_signals=signals))
    process = Process(Config(dbc_file=path, wheel_speed_signals=signals, wheel_speed_unit="km/h"))
    (speeds,) = feed(process, line("0D4#8813"))
    assert isinstance(speeds, WheelSpeeds) and speeds.rear_left_m_s == pytest.approx(50 / 3.6)
    with pytest.raises(UserError, match="has the unit 'furlong'"):
        Process(Config(dbc_file=path, wheel_speed_signals=signals, wheel_speed_unit="furlong"))


@pytest.mark.parametrize(
    "text",
    [
        "7E8#037F0111",  # negative response
        "7E8#03410C1AF8",  # engine speed
        "7E8#02410D",  # too short to hold a speed
        "7E8#100841000D320000",  # first of several frames
        "000007E8#03410D32",  # a 29-bit identifier of the same value
        "7E8#R",
        "7DF#02010D0000000000",  # the request
    ],
)
def test_other_frames_give_no_speed_and_no_reject(text: str) -> None:
    process = Process(Config())
    assert not feed(process, line(text))
    assert not process.rejects


@pytest.mark.parametrize(
    ("text", "source", "speed_m_s"),
    [
        ("18FEF100#F7803E0FFFFFFFFF", "can0/j1939/00", 62.5 / 3.6),
        ("0CFE6CEE#0000C0C0FFFF003C", "can0/tachograph/EE", 60 / 3.6),
    ],
)
def test_j1939_gives_the_wheel_based_and_the_tachograph_speed(text: str, source: str, speed_m_s: float) -> None:
    (speed,) = feed(Process(Config()), line(text))
    assert isinstance(speed, VehicleSpeed)
    assert speed.source == source
    assert speed.speed_m_s == pytest.approx(speed_m_s)


@pytest.mark.parametrize("raw", ["FFFF", "00FE", "00FB"])
def test_a_j1939_speed_marked_not_available_is_omitted(raw: str) -> None:
    assert not feed(Process(Config()), line(f"18FEF100#F7{raw}0FFFFFFFFF"))


def test_a_line_that_does_not_end_is_one_reject_and_the_next_one_is_read() -> None:
    process = Process(Config())
    assert not feed(process, b"x" * (MAX_LINE + 1))
    assert process.rejects["line"] == 1
    (speed,) = feed(process, b"\n" + line("18FEF100#F7803E", 0.1))
    assert isinstance(speed, VehicleSpeed) and process.rejects["line"] == 1


@pytest.mark.parametrize(("identifier", "group"), [
    (0x0CF00400, 0xF004), (0x18FEF100, 0xFEF1), (0x18EFFF00, 0xEF00), (0x0CEF2100, 0xEF00), (0x18FF2127, 0xFF21),
])  # fmt: skip
def test_the_group_of_an_identifier_leaves_out_the_receiver_below_format_240(identifier: int, group: int) -> None:
    """EEC1 (PGN 61444) is of the first format without a receiver; proprietary A (61184) has one."""
    assert parameter_group(identifier) == group


def test_a_j1939_speed_is_read_from_a_frame_that_ends_behind_it_and_not_from_one_that_ends_within_it() -> None:
    (speed,) = feed(Process(Config()), line("18FEF100#F7803E"))
    assert isinstance(speed, VehicleSpeed) and speed.speed_m_s == pytest.approx(62.5 / 3.6)
    assert not feed(Process(Config()), line("18FEF100#F780"))


def test_wheel_speeds_are_decoded_by_the_dbc_file_to_m_s(dbc: Path) -> None:
    process = Process(Config(dbc_file=dbc, wheel_speed_signals=WHEELS, wheel_speed_delay_s=0.01))
    front, rear = feed(process, line("0D4#E803D007B80B2800") + line("18FEF2FE#E803", 0.001))
    assert isinstance(front, WheelSpeeds)
    assert isinstance(rear, WheelSpeeds)
    assert (front.front_left_m_s, front.front_right_m_s, front.rear_left_m_s) == pytest.approx(
        (10 / 3.6, 20 / 3.6, 30 / 3.6)
    )
    assert front.rear_right_m_s is None
    assert rear.rear_right_m_s == pytest.approx(10 * 0.44704)
    assert (front.sampled_ns, front.source) == (START_NS - NS // 100, "can0")


def test_of_a_multiplexed_message_the_wheel_speed_is_decoded_and_other_values_give_none(tmp_path: Path) -> None:
    path = tmp_path / "multiplexed.dbc"
    path.write_text(
        'VERSION ""\nBU_: ECU\nBO_ 212 WHEELS: 3 ECU\n SG_ KIND M : 0|8@1+ (1,0) [0|255] "" ECU\n'
        ' SG_ FL m1 : 8|16@1+ (0.01,0) [0|300] "km/h" ECU\n SG_ TEMPERATURE m2 : 8|8@1+ (1,0) [0|255] "degC" ECU\n'
    )
    process = Process(Config(dbc_file=path, wheel_speed_signals=WheelSignals(front_left="FL")))
    assert not feed(process, line("0D4#02E803"))
    assert not feed(process, line("0D4#07E803"))
    assert process.rejects["dbc_frame"] == 1, "no signal has the value 7 of the multiplexer"
    (speeds,) = feed(process, line("0D4#01E803"))
    assert isinstance(speeds, WheelSpeeds) and speeds.front_left_m_s == pytest.approx(10 / 3.6)


def test_wheel_speeds_are_decimated_to_the_configured_period(dbc: Path) -> None:
    process = Process(Config(dbc_file=dbc, wheel_speed_signals=WHEELS, wheel_speed_period_s=0.1))
    found = [m for k in range(200) for m in feed(process, line("0D4#E803D007B80B2800", k * 0.01), k * 0.01)]
    assert len(found) == pytest.approx(20, abs=3)


def test_an_invalid_wheel_speed_is_omitted_and_the_others_are_published(dbc: Path) -> None:
    process = Process(Config(dbc_file=dbc, wheel_speed_signals=WHEELS))
    (speeds,) = feed(process, line("0D4#FFFFD007B80B2800"))  # 655.35 km/h
    assert isinstance(speeds, WheelSpeeds)
    assert speeds.front_left_m_s is None
    assert speeds.front_right_m_s == pytest.approx(20 / 3.6)
    (speeds,) = feed(process, line("0D4#E803D007", 1.0), 1.0)  # two of the four are whole in it
    assert isinstance(speeds, WheelSpeeds)
    assert speeds.front_right_m_s == pytest.approx(20 / 3.6) and speeds.rear_left_m_s is None
    assert process.rejects == {"wheel_speed": 1, "dbc_frame": 1}


@pytest.mark.parametrize(
    ("signals", "text", "reason"),
    [
        (WheelSignals(front_left="XX"), DBC, "there is no signal 'XX'; the file has FL, FR"),
        (WheelSignals(front_left="TEMPERATURE"), DBC, "has the unit 'degC'"),
        (WheelSignals(front_left="FL"), "this is no DBC file", "not a DBC file"),
        (WheelSignals(), DBC, "name the signal of each wheel"),
    ],
)
def test_an_invalid_dbc_file_is_reported_at_the_start(
    signals: WheelSignals, text: str, reason: str, tmp_path: Path
) -> None:
    path = tmp_path / "car.dbc"
    path.write_text(text)
    with pytest.raises(UserError, match=reason):
        Process(Config(dbc_file=path, wheel_speed_signals=signals))


def test_a_missing_dbc_file_is_reported_at_the_start() -> None:
    with pytest.raises(UserError, match=r"nowhere\.dbc.*No such file"):
        Process(Config(dbc_file=Path("nowhere.dbc"), wheel_speed_signals=WHEELS))


def test_the_stamp_of_a_line_is_used_if_it_is_consistent_with_its_batch() -> None:
    process = Process(Config(vehicle_speed_delay_s=0.0))
    messages = feed(process, b"(12.5) can0 7E8#03410D32\n" + line("7E8#03410D32", 0.01) + line("7E8#03410D32", 9.0))
    assert [message.received_ns - START_NS for message in messages] == [NS // 20, NS // 100, NS // 20]
    assert process.rejects == {"line_stamp": 2}


def test_lines_are_parsed_from_chunks_of_any_size() -> None:
    process = Process(Config())
    data = line("7E8#03410D32") * 3
    assert sum(len(feed(process, data[i : i + 7])) for i in range(0, len(data), 7)) == 3
    assert not process.rejects


def test_an_invalid_line_is_counted_and_the_next_one_is_parsed() -> None:
    process = Process(Config())
    messages = feed(process, b"rubbish\n(1.0) can0 7E8#123\n" + line("7E8#03410D32") + b"\xff" * 1000 + b"\n")
    assert len(messages) == 1
    assert process.rejects == {"line": 3}
    feed(process, b"x" * 10_000)
    assert len(pickle.dumps(process)) < 8_000, "bytes without an end of line are dropped"


def test_other_messages_are_ignored_and_excess_sources_are_rejected() -> None:
    process = Process(Config())
    assert not list(process.handle(ImuRaw(received_ns=1, source="x", data=b"")))
    for k in range(10):
        list(process.handle(CanRaw(received_ns=1, source=f"can{k}", data=b"")))
    assert process.rejects == {"too_many_sources": 2}


@given(st.lists(st.one_of(st.binary(max_size=60), st.text(max_size=60).map(str.encode), st.just(line("7E8#03410D00"))),
                max_size=8), st.integers(1, 100))  # fmt: skip
def test_a_valid_line_after_invalid_bytes_is_parsed(parts: list[bytes], size: int) -> None:
    process, stream = Process(Config()), b"".join(parts)
    for i in range(0, len(stream), size):
        feed(process, stream[i : i + size])
    (speed,) = feed(process, b"\n" + line("7E8#03410D32"))[-1:]
    assert isinstance(speed, VehicleSpeed)
    assert speed.speed_m_s == pytest.approx(50 / 3.6)


@given(st.integers(0, 2**29 - 1), st.booleans(), st.binary(max_size=8))
def test_any_frame_is_parsed_without_error(identifier: int, extended: bool, data: bytes) -> None:
    identifier &= 0x1FFFFFFF if extended else 0x7FF
    name = f"{identifier:08X}" if extended else f"{identifier:03X}"
    frame = parse_line(line(f"{name}#{data.hex().upper()}").strip())
    assert frame is not None
    assert (frame.identifier, frame.extended, frame.data) == (identifier, extended, data)
    for speed in feed(Process(Config()), line(f"{name}#{data.hex()}")):
        assert isinstance(speed, VehicleSpeed)
        assert 0 <= speed.speed_m_s < 80


@pytest.mark.recording
def test_recorded_obd_speeds_equal_the_decoded_speeds_of_the_recording() -> None:
    folder = recording("canedge_obd_gnss/drive164")
    process, found = Process(Config(vehicle_speed_delay_s=0.0)), []
    with (folder / "candump.log").open("rb") as file:
        for text in file:
            if b" 7E8#" in text:
                frame = parse_line(text.strip())
                assert frame is not None
                found += list(process.handle(CanRaw(received_ns=frame.time_ns, source="can0", data=text)))
    with (folder / "obd_speed.csv").open() as table:
        expected = [(float(row["t"]), float(row["obd_speed_kmh"])) for row in csv.DictReader(table)]
    assert len(found) == len(expected) > 4000
    for speed, (t, speed_km_h) in zip(found, expected, strict=True):
        assert isinstance(speed, VehicleSpeed)
        assert speed.sampled_ns * 1e-9 == pytest.approx(t, abs=1e-5)
        assert speed.speed_m_s * 3.6 == pytest.approx(speed_km_h)


@pytest.mark.recording
def test_recorded_wheel_speeds_equal_those_decoded_by_cantools_and_python_can() -> None:
    folder = recording("can_toyobaru_wheelspeed")
    names = {"front_left": "WS_FL", "front_right": "WS_FR", "rear_left": "WS_RL", "rear_right": "WS_RR"}
    process = Process(
        Config(
            dbc_file=folder / "sample_can_spec.dbc",
            wheel_speed_signals=WheelSignals(**names),
            wheel_speed_period_s=0.0,
        )
    )
    lines = (folder / "can_sample.log").read_bytes().splitlines(keepends=True)[:20_000]
    database = cantools.database.load_file(folder / "sample_can_spec.dbc")
    assert isinstance(database, cantools.database.can.Database)
    frames: list[can.Message] = [m for m in CanutilsLogReader(folder / "can_sample.log") if m.arbitration_id == 0xD4]
    found = []
    for text in lines:
        frame = parse_line(text.strip())
        assert frame is not None
        found += list(process.handle(CanRaw(received_ns=frame.time_ns, source="can0", data=text)))
    assert len(found) > 900
    for speeds, message in zip(found, frames, strict=False):
        theirs = database.decode_message(0xD4, bytes(message.data))
        assert isinstance(theirs, dict)
        for wheel, name in names.items():
            assert getattr(speeds, f"{wheel}_m_s") == pytest.approx(theirs[name])


@pytest.mark.recording
def test_a_parked_truck_has_zero_wheel_and_tachograph_speed() -> None:
    path = recording("j1939_truck_can/truck_gb_tco1_gnss_stationary.log")
    process, found, reader = Process(Config()), Counter[tuple[str, float]](), LineReader(Counter(), Kinds())
    for text in path.read_bytes().splitlines(keepends=True):
        if b"FEF1" in text or b"FE6C" in text:
            for frame in reader.feed(text):
                for speed in process.handle(CanRaw(received_ns=frame.time_ns, source="can0", data=text)):
                    assert isinstance(speed, VehicleSpeed)
                    found[speed.source, speed.speed_m_s] += 1
    assert found == {("can0/can1/j1939/00", 0.0): 3993, ("can0/can1/tachograph/EE", 0.0): 215}
