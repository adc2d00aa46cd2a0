import math
import re
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from services.parsers.can.process import Config, Process
from shared.errors import UserError
from shared.messages.base import Message
from shared.messages.operation import MessageUse
from shared.messages.vehicle import CanRaw, VehicleSignal, VehicleSpeed, WheelSpeeds
from tests.support.data import recording

NS = 1_000_000_000
NOW_NS = 1_795_000_000 * NS
DBC = """VERSION ""
BU_: ECU
BO_ 208 MOTION: 8 ECU
 SG_ STEER : 0|16@1- (0.1,0) [-450|450] "deg" ECU
 SG_ YAW : 16|16@1- (0.01,0) [-150|150] "deg/s" ECU
 SG_ TICKS : 32|16@1+ (1,0) [0|1] "" ECU
 SG_ SPEED : 48|16@1+ (0.01,0) [0|300] "km/h" ECU
BO_ 209 BODY: 8 ECU
 SG_ MUX M : 0|8@1+ (1,0) [0|3] "" ECU
 SG_ GEAR m1 : 8|8@1+ (1,0) [0|8] "" ECU
 SG_ ODO m2 : 8|32@1+ (0.1,0) [0|400000000] "km" ECU
BO_ 211 MIXED: 8 ECU
 SG_ TEMP : 7|16@0+ (0.01,0) [0|650] "degC" ECU
 SG_ LOAD : 23|32@0- (1,0) [0|100] "" ECU
BO_ 210 OTHER: 8 ECU
 SG_ SPEED : 0|16@1+ (0.01,0) [0|300] "mph" ECU
SIG_VALTYPE_ 211 LOAD : 1;
"""


def process(tmp_path: Path, **signals: Any) -> Process:
    path = tmp_path / "car.dbc"
    path.write_text(DBC)
    entries = {name: {"signal": s} if isinstance(s, str) else s for name, s in signals.items()}
    return Process(Config.model_validate({"dbc_file": path, "signals": entries}))


def fed(parser: Process, *frames: str, step_s: float = 0.1) -> list[Message]:
    found: list[Message] = []
    for k, frame in enumerate(frames):
        at_ns = NOW_NS + round(k * step_s * NS)
        line = f"({at_ns // NS}.{at_ns % NS // 1000:06d}) can0 {frame}\n".encode()
        found += parser.handle(CanRaw(received_ns=at_ns, source="can0", data=line))
    return found


def values(found: list[Message]) -> dict[str, tuple[object, str]]:
    return {message.name: (message.value, message.unit) for message in found if isinstance(message, VehicleSignal)}


def test_named_signals_are_published_in_si(tmp_path: Path) -> None:
    parser = process(tmp_path, steering_angle="STEER", yaw_rate="MOTION.YAW", vehicle_speed="MOTION.SPEED")
    found = fed(parser, "0D0#64009CFF00008813")
    assert values(found) == {
        "steering_angle": (pytest.approx(math.radians(10)), "rad"),
        "yaw_rate": (pytest.approx(math.radians(-1)), "rad/s"),
    }
    (speed,) = [message for message in found if isinstance(message, VehicleSpeed)]
    assert speed.speed_m_s == pytest.approx(50 / 3.6) and speed.source == "can0/dbc"
    assert speed.resolution_m_s == pytest.approx(0.01 / 3.6)


@pytest.mark.parametrize("delay_s", [0.0, 0.05])
def test_a_signal_is_as_old_as_the_vehicle_is_said_to_need_for_it(tmp_path: Path, delay_s: float) -> None:
    parser = process(tmp_path, steering_angle="STEER", vehicle_speed="MOTION.SPEED")
    parser._config = parser._config.model_copy(update={"wheel_speed_delay_s": delay_s})
    found = [
        message for message in fed(parser, "0D0#64009CFF00008813") if isinstance(message, VehicleSignal | VehicleSpeed)
    ]
    assert len(found) == 2
    assert {(item.received_ns, item.received_ns - item.sampled_ns) for item in found} == {(NOW_NS, round(delay_s * NS))}


def test_multiplexed_signals_are_published_when_they_come(tmp_path: Path) -> None:
    parser = process(tmp_path, gear="GEAR", odometer="ODO")
    found = fed(parser, "0D1#0103000000000000", "0D1#02E80300", "0D1#02E8030000000000", "0D1#0900000000000000")
    assert values(found) == {"gear": (3.0, ""), "odometer": (pytest.approx(100_000.0), "m")}
    (kind,) = parser.kinds.table()
    assert (kind.kind, kind.use, kind.count) == ("CAN 0D1 BODY", MessageUse.USED, 4)
    assert kind.rejected == parser.rejects["dbc_frame"] == 2 and kind.reason == "dbc_frame"  # too short, unknown value


@pytest.mark.parametrize(
    ("frame", "wanted", "rejected"),
    [
        ("0D0#64009CFF", {"steering_angle", "yaw_rate"}, 1),  # the speed is behind its end
        ("0D0#64009C", {"steering_angle"}, 1),
        ("0D0#640000000000881300AA", {"steering_angle", "yaw_rate", "vehicle_speed"}, 0),
        ("0D0#", set(), 1),
        ("0D1#0103", {"gear"}, 0),  # the odometer is of another value of the multiplexer
        ("0D1#02E8030000", {"odometer"}, 0),
        ("0D1#02E80300", set(), 1),
        ("0D1#", set(), 1),
        ("0D3#40A0", {"temperature"}, 1),  # a big-endian signal in bytes 0 and 1, and a float in bytes 2 to 5
        ("0D3#40A041200000", {"temperature", "load"}, 0),
        ("0D3#40", set(), 1),
    ],
)
def test_a_short_frame_gives_the_signals_that_are_whole_in_it(
    frame: str, wanted: set[str], rejected: int, tmp_path: Path
) -> None:
    parser = process(tmp_path, steering_angle="STEER", yaw_rate="YAW", vehicle_speed="MOTION.SPEED", gear="GEAR",
                     odometer="ODO", temperature="TEMP", load="LOAD")  # fmt: skip
    frame = frame if len(frame) <= 20 else f"{frame[:3]}##0{frame[4:]}"
    found = {"vehicle_speed" if isinstance(message, VehicleSpeed) else message.name for message in fed(parser, frame)
             if isinstance(message, VehicleSpeed | VehicleSignal)}  # fmt: skip
    assert found == wanted and parser.rejects.total() == parser.rejects["dbc_frame"] == rejected


J1939 = """VERSION ""
BU_: ECU
BO_ 2566832126 EBC2: 8 ECU
 SG_ SPEED : 0|16@1+ (0.00390625,0) [0|250.996] "km/h" ECU
BO_ 2348810494 TSC1: 8 ECU
 SG_ TORQUE : 24|8@1+ (1,-125) [-125|125] "%" ECU
BO_ 2566834443 DIAG_0B: 8 ECU
 SG_ LAMP : 0|8@1+ (1,0) [0|255] "" ECU
BO_ 2566834686 DIAG: 8 ECU
 SG_ CODE : 0|8@1+ (1,0) [0|255] "" ECU
BO_ 2566837502 PLAIN: 8 ECU
 SG_ LEVEL : 0|8@1+ (1,0) [0|255] "" ECU
"""
BY_DEFAULT = """BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
BA_ "VFrameFormat" BO_ 2566837502 1;
"""
BY_MESSAGE = """BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "ExtendedCAN";
""" + "".join(f'BA_ "VFrameFormat" BO_ {n} 3;\n' for n in (2566832126, 2348810494, 2566834443, 2566834686))
BY_NETWORK = """BA_DEF_ "ProtocolType" STRING ;
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "ProtocolType" "";
BA_ "ProtocolType" "J1939";
BA_ "VFrameFormat" BO_ 2566837502 1;
"""


def truck(tmp_path: Path, marks: str) -> Process:
    path = tmp_path / "truck.dbc"
    path.write_text(J1939 + marks)
    names = {"vehicle_speed": "SPEED", "torque": "TORQUE", "lamp": "LAMP", "code": "CODE", "level": "LEVEL"}
    return Process(Config.model_validate({"dbc_file": path, "signals": {k: {"signal": v} for k, v in names.items()}}))


@pytest.mark.parametrize("marks", [BY_DEFAULT, BY_MESSAGE, BY_NETWORK])
@pytest.mark.parametrize(
    ("frame", "name", "source"),
    [
        ("18FEBF0B#0050FFFFFFFFFFFF", "vehicle_speed", "can0/0B/dbc"),
        ("0CFEBFFE#0050FFFFFFFFFFFF", "vehicle_speed", "can0/dbc"),  # another priority
        ("18FEBFFE#0050FFFFFFFFFFFF", "vehicle_speed", "can0/dbc"),
        ("19FEBF0B#0050FFFFFFFFFFFF", None, None),  # another data page
        ("1AFEBF0B#0050FFFFFFFFFFFF", None, None),  # extended data page
        ("0C000017#FFFFFF8CFFFFFFFF", "torque", "can0/17"),  # to the engine, and below to the retarder
        ("0C000F17#FFFFFF8CFFFFFFFF", "torque", "can0/17"),
        ("18FEC90B#01FFFFFFFFFFFFFF", "lamp", "can0"),  # the sender has a message of its own
        ("08FEC90B#01FFFFFFFFFFFFFF", "lamp", "can0"),
        ("18FEC93E#01FFFFFFFFFFFFFF", "code", "can0/3E"),
        ("18FED4FE#01FFFFFFFFFFFFFF", "level", "can0"),  # a plain identifier of 29 bits
        ("18FED40B#01FFFFFFFFFFFFFF", None, None),
    ],
)
def test_messages_of_j1939_are_found_by_their_parameter_group(
    frame: str, name: str | None, source: str | None, marks: str, tmp_path: Path
) -> None:
    parser = truck(tmp_path, marks)
    found = [("vehicle_speed" if isinstance(message, VehicleSpeed) else message.name, message.source)
             for message in fed(parser, frame) if isinstance(message, VehicleSpeed | VehicleSignal)]  # fmt: skip
    assert found == ([] if name is None else [(name, source)]) and not parser.rejects
    assert parser.kinds.table()[0].use is (MessageUse.UNKNOWN if name is None else MessageUse.USED)


def test_senders_of_one_group_are_decoded_apart(tmp_path: Path) -> None:
    found = fed(truck(tmp_path, BY_DEFAULT), "18FEBF0B#0050FFFFFFFFFFFF", "18FEBF3E#0028FFFFFFFFFFFF", step_s=0.01)
    speeds = {message.source: message.speed_m_s for message in found if isinstance(message, VehicleSpeed)}
    assert speeds == {"can0/0B/dbc": pytest.approx(80 / 3.6), "can0/3E/dbc": pytest.approx(40 / 3.6)}


def test_a_unit_or_a_scale_of_the_vehicle_file_overrides_the_file(tmp_path: Path) -> None:
    parser = process(
        tmp_path, vehicle_speed={"signal": "TICKS", "scale": 0.5}, yaw_rate={"signal": "YAW", "unit": "rad/s"},
        temperature={"signal": "STEER", "unit": "degC", "scale": 2.0},
    )  # fmt: skip
    found = fed(parser, "0D0#640064001E000000")
    assert values(found) == {"yaw_rate": (pytest.approx(1.0), "rad/s"), "temperature": (pytest.approx(20.0), "degC")}
    assert [message.speed_m_s for message in found if isinstance(message, VehicleSpeed)] == [15.0]


def test_values_out_of_range_are_rejects(tmp_path: Path) -> None:
    parser = process(tmp_path, steering_angle="STEER")
    assert not fed(parser, "0D0#FF7F000000000000")
    assert parser.rejects == {"signal_value": 1}


@pytest.mark.parametrize(
    ("signals", "said"),
    [
        ({"vehicle_speed": "SPEED"}, "is in several messages: write one of MOTION.SPEED, OTHER.SPEED"),
        ({"yaw_rate": "NOTHING"}, "there is no signal 'NOTHING'; the file has GEAR"),
        ({"vehicle_speed": "TICKS"}, "has no unit: .*or state its factor to m/s as scale"),
        ({"yaw_rate": {"signal": "YAW", "unit": "furlong"}}, r"deg.*unit of \[parsers.can.signals.yaw_rate\]"),
        ({"front_left": "YAW"}, "into wheel_speed_signals"),
    ],
)
def test_errors_say_what_to_write(signals: dict[str, Any], said: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=said):
        process(tmp_path, **signals)


def test_names_are_bounded(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="32"):
        process(tmp_path, **{f"s{k}": "YAW" for k in range(33)})
    with pytest.raises(ValueError, match="pattern"):
        process(tmp_path, **{"A b": "YAW"})


def test_a_vin_of_several_frames_is_published(tmp_path: Path) -> None:
    frames = ["7E8#1014490201575030", "7E8#215A5A5A39395A54", "7E8#2253333932313234"]
    (vin,) = fed(Process(Config()), *frames)
    assert isinstance(vin, VehicleSignal) and (vin.name, vin.text) == ("vin", "WP0ZZZ99ZTS392124")


def test_every_frame_and_line_is_counted_by_kind() -> None:
    parser = Process(Config())
    fed(parser, "7E8#03410D32", "123#00", "123#00", "123#R", "20000080#0000000000000000", "rubbish", "7DF#02010D",
        "18FEF100#F700500FFFFFFFFF")  # fmt: skip
    table = {kind.kind: (kind.use.value, kind.count, kind.rejected) for kind in parser.kinds.table()}
    assert table == {
        "CAN 7E8": ("used", 1, 0), "CAN 123": ("unknown", 2, 0), "CAN remote frame": ("unused", 1, 0),
        "CAN error frame": ("unused", 1, 0), "unusable line": ("unknown", 1, 1), "CAN 7DF": ("unused", 1, 0),
        "CAN 18FEF100": ("used", 1, 0),
    }  # fmt: skip


def test_error_frames_are_told_behind_any_number_of_identifiers() -> None:
    parser = Process(Config())
    fed(parser, *(f"{k:03X}#00" for k in range(200)), "20000080#00", step_s=0.001)
    table = {kind.kind: kind.count for kind in parser.kinds.table()}
    assert len(table) <= 64 and table["CAN error frame"] == 1 and table["others"] > 100


@pytest.mark.parametrize("frame", ["0CFE6CEE#FFFFFFFFFFFF0032", "18FEF100#FF0032FFFFFFFFFF", "7E8#03410D32AAAAAAAA"])
def test_what_is_used_is_listed_by_its_name_behind_any_number_of_identifiers(frame: str) -> None:
    parser = Process(Config())
    fed(parser, *(f"{k:03X}#00" for k in range(200)), "023#00", *[frame] * 20, "20000080#00", step_s=0.001)
    table = {kind.kind: (kind.use, kind.count) for kind in parser.kinds.table()}
    assert table[f"CAN {frame.split('#', maxsplit=1)[0]}"] == (MessageUse.USED, 20)
    assert len(table) <= 64 and sum(count for _, count in table.values()) == 222
    assert table["CAN 023"][1] == 2 and table["CAN error frame"] == (MessageUse.UNUSED, 1)


def test_speeds_are_read_behind_any_number_of_identifiers() -> None:
    parser = Process(Config())
    frames = b"".join(b"(1795000000.000000) can0 %08X#00\n" % (k << 8) for k in range(5000))
    frames += b"(1795000000.000000) can0 7E8#03410D32\n"
    (speed,) = parser.handle(CanRaw(received_ns=NOW_NS, source="can0", data=frames))
    assert isinstance(speed, VehicleSpeed) and len(parser._names) == 4096


@pytest.mark.recording
@pytest.mark.parametrize(
    ("folder", "file", "outputs"),
    [
        ("j1939_truck_can", "truck_gb_tco1_gnss_stationary.log", {VehicleSpeed: 1000}),
        ("can_toyobaru_wheelspeed", "can_sample.log", {WheelSpeeds: 400, VehicleSignal: 800, VehicleSpeed: 400}),
        ("canedge_obd_gnss", "drive164/candump.log", {VehicleSpeed: 200}),
    ],
)
def test_recordings_are_read_with_every_line_accounted_for(
    folder: str, file: str, outputs: dict[type[Message], int]
) -> None:
    root = recording(folder)
    text = b"".join((root / file).read_bytes().splitlines(keepends=True)[:40_000])
    config: dict[str, Any] = {}
    if (dbc := root / "sample_can_spec.dbc").exists():
        signals = {"vehicle_speed": {"signal": "SPEED"}, "yaw_rate": {"signal": "ID_D0.GYRO_YAW"},
                   "steering_angle": {"signal": "STEER_ANGLE"}}  # fmt: skip
        config = {"dbc_file": dbc, "wheel_speed_signals": {"rear_left": "WS_RL", "rear_right": "WS_RR"},
                  "signals": signals}  # fmt: skip
    parser, found = Process(Config.model_validate(config)), Counter[type[Message]]()
    for place in range(0, len(text), 50_000):
        piece = text[place : place + 50_000]
        stamps = re.findall(rb"\n\((\d+)\.", piece)
        message = CanRaw(received_ns=(int(stamps[-1]) + 1) * NS, source="can0", data=piece)
        found.update(type(item) for item in parser.handle(message))
    counted = sum(kind.count for kind in parser.kinds.table())
    assert counted == text.count(b"\n")
    assert not parser.rejects["line"] and not parser.rejects["fault"] and not parser.rejects["range"]
    for kind, least in outputs.items():
        assert found[kind] >= least, found
