"""Device files are recognised, aligned and become a recording that the unit reads."""

import struct
from pathlib import Path

import pytest

from cli.import_drive.devices import alignment
from cli.import_drive.devices.can_log import read_asc, read_candump
from cli.import_drive.devices.device_files import Form, import_devices, kind_of, shifts_of
from cli.import_drive.devices.stamped import WITHOUT_DATE_NS, ClockKind, FileKind
from cli.import_drive.import_drive import import_drive
from cli.recordings.common import open_recording
from services.sensors.simulator.scenarios import BY_NAME
from services.sensors.simulator.world import Equipment, World
from shared.errors import UserError
from shared.maths.crc import crc16_ccitt
from shared.messages.base import RawBytes
from shared.messages.gnss import GnssRaw
from shared.messages.imu import ImuRaw
from shared.messages.vehicle import CanRaw
from tests.support.gnss.frames import rtcm

NS = 1_000_000_000
START_NS = 1_700_000_000 * NS
DRIVE_S = 90
VEHICLE = Path("deploy/vehicles/simulated.toml")
ASC = """date Fri Sep 17 09:15:14.717 am 2021
base hex  timestamps absolute
internal events logged
   0.100000 1  7E8             Rx   d 8 03 41 0D 32 00 00 00 00
   0.250000 1  18FEF100x       Rx   d 8 FF 00 50 FF FF FF FF FF
   0.300000 1  ErrorFrame
"""


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the bytes of a simulated drive, the log of the CAN bus in seconds since its start."""
    folder = tmp_path_factory.mktemp("drive")
    files = {GnssRaw: "rover.ubx", ImuRaw: "mti.bin", CanRaw: "can.log"}
    written: dict[str, list[bytes]] = {name: [] for name in files.values()}
    for due_ns, message in World(BY_NAME["urban"], 1, START_NS, Equipment(protocols=("ubx",))):
        if due_ns > START_NS + DRIVE_S * NS:
            break
        if isinstance(message, RawBytes) and type(message) in files:
            written[files[type(message)]].append(message.data)
    for name, parts in written.items():
        (folder / name).write_bytes(b"".join(parts).replace(b"(1700", b"("))
    return folder


def stamps(path: Path, topic: str) -> list[int]:
    with open_recording(path) as recording:
        return [envelope.received_ns for envelope in recording if envelope.topic == topic]


def test_files_are_recognised_by_their_bytes(drive: Path, tmp_path: Path) -> None:
    (tmp_path / "a.asc").write_text(ASC)
    (tmp_path / "a.csv").write_text("t,x\n0,1\n")
    (tmp_path / "empty").write_text("")
    found = [kind_of(path) for path in (drive / "rover.ubx", drive / "mti.bin", drive / "can.log", tmp_path / "a.asc")]
    assert found == [Form(kind) for kind in (FileKind.RECEIVER, FileKind.TRACKER, FileKind.CAN)] + [
        Form(FileKind.CAN, asc=True)
    ]
    assert kind_of(tmp_path / "a.csv") is None and kind_of(tmp_path / "empty") is None


def test_clocks_without_a_date_are_aligned_by_the_motion(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def too_few_turns(*_: object) -> None:
        raise UserError("too few turns")

    monkeypatch.setattr(alignment, "delay_of_fixes", too_few_turns)  # the filter takes minutes
    out = tmp_path / "out.mcap"
    files = [drive / name for name in ("rover.ubx", "mti.bin", "can.log")]
    assert import_devices(files, out, VEHICLE, {}) == 0
    assert abs(stamps(out, "imu/raw")[0] - START_NS) < 0.3 * NS
    assert abs(stamps(out, "can/raw")[0] - START_NS) < 0.3 * NS
    said = capsys.readouterr().out
    assert said.count("tells no date; its stamps were moved by") == 2
    with open_recording(out) as recording:
        line = next(envelope.decode() for envelope in recording if envelope.topic == "can/raw")
    assert isinstance(line, CanRaw) and line.data.startswith((b"(1700000000", b"(1699999999")), "its lines follow"


def test_a_shift_that_is_given_is_taken(drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    files = [drive / "rover.ubx", drive / "can.log"]
    shift_s = START_NS / NS - WITHOUT_DATE_NS / NS + 5.0
    assert import_devices(files, out, VEHICLE, shifts_of([f"can.log={shift_s}"], files)) == 0
    assert stamps(out, "can/raw")[0] == pytest.approx(START_NS + 5 * NS, abs=0.2 * NS)


def test_a_file_without_motion_in_common_is_not_aligned(drive: Path, tmp_path: Path) -> None:
    (tmp_path / "idle.log").write_text("".join(f"({n / 10:.6f}) can0 123#00\n" for n in range(900)))
    with pytest.raises(UserError, match=r"--shift idle.log=SECONDS"):
        import_devices([drive / "rover.ubx", tmp_path / "idle.log"], tmp_path / "out.mcap", None, {})
    assert not (tmp_path / "out.mcap").exists()


def test_one_file_alone_begins_in_2000_and_says_so(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert import_drive(drive / "mti.bin", None, tmp_path / "out.mcap") == 0
    assert "begins on 2000-01-01" in capsys.readouterr().out
    assert WITHOUT_DATE_NS <= stamps(tmp_path / "out.mcap", "imu/raw")[0] < WITHOUT_DATE_NS + NS


@pytest.mark.parametrize("text", ["can.log", "can.log=x", "other.log=1", "can.log=inf", "=1"])
def test_a_shift_that_is_none_says_what_to_write(text: str) -> None:
    with pytest.raises(UserError, match=r"such as mti.bin=12.5"):
        shifts_of([text], [Path("can.log")])


def test_several_files_that_are_none_of_devices_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,x\n0,1\n")
    with pytest.raises(UserError, match="obu import --help"):
        import_drive(tmp_path / "a.csv", None, tmp_path / "out.mcap")
    (tmp_path / "m.toml").write_text("")
    with pytest.raises(UserError, match="files of devices only"):
        import_drive(tmp_path / "m.toml", tmp_path, tmp_path / "out.mcap", more=[tmp_path / "a.csv"])


def test_an_asc_log_has_the_frames_of_its_lines(tmp_path: Path) -> None:
    (tmp_path / "a.asc").write_text(ASC)
    found = read_asc(tmp_path / "a.asc")
    assert found.clock is ClockKind.FREE and found.rows == 2
    lines = b"".join(portion.data for portion in found.portions).decode().splitlines()
    assert [line.split(" ", 1)[1] for line in lines] == ["can0 7E8#03410D3200000000", "can0 18FEF100#FF0050FFFFFFFFFF"]
    assert found.portions[-1].time_ns - found.portions[0].time_ns == 150_000_000


def asc_log(head: str, *, decimal: bool = False, relative: bool = False, start_s: float = 0.0) -> str:
    """Twelve frames at 10 Hz, with a line that is no frame 40 ms behind the sixth."""
    frame = "1  2024  Rx   d 8 3 65 13 {} 0 0 0 0" if decimal else "1  7E8  Rx   d 8 03 41 0D {:02X} 00 00 00 00"
    events = [(start_s + k / 10, frame.format(k)) for k in range(12)]
    events.insert(6, (start_s + 0.54, "1  Statistic: D 10 R 0 XD 0 XR 0 E 0 O 0 B 1.0%"))
    before = [0.0, *(at for at, _ in events)]
    shown = [(at - before[k] if relative else at, rest) for k, (at, rest) in enumerate(events)]
    return head + "".join(f"{at:11.6f} {rest}\n" for at, rest in shown) + "End TriggerBlock\n"


TRIGGER = "Begin Triggerblock Mon Sep 21 10:20:00 2026\n   0.000000 Start of measurement\n"


@pytest.mark.parametrize(
    "text",
    [
        asc_log("base hex  timestamps absolute\ninternal events logged\n" + TRIGGER),
        asc_log("base hex  timestamps relative\ninternal events logged\n" + TRIGGER, relative=True),
        asc_log("  Base Dec  Timestamps Relative\n" + TRIGGER, relative=True, decimal=True),
        asc_log("date Mon Sep 21 2026\nbase hex  no internal events logged\n// version 7.1.0\n", start_s=37_200.0),
        asc_log("base dec timestamps absolute\n", decimal=True),
        asc_log("base hex timestamps absolute\ninternal events logged\n").replace(".", ","),
    ],
)
def test_frames_of_an_asc_log_are_as_far_apart_as_they_were(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.asc").write_text(text)
    assert kind_of(tmp_path / "a.asc") == Form(FileKind.CAN, asc=True)
    lines = b"".join(portion.data for portion in read_asc(tmp_path / "a.asc").portions).decode().splitlines()
    times_s = [float(line[1 : line.index(")")]) for line in lines]
    assert [round(at - times_s[0], 3) for at in times_s] == [k / 10 for k in range(12)]
    assert [line.split("#")[1] for line in lines] == [f"03410D{k:02X}00000000" for k in range(12)]


@pytest.mark.parametrize("differences_s", [[0.1] * 30, [0.05, 0.15] * 15])
def test_differences_of_candump_are_added_up(differences_s: list[float]) -> None:
    shown = [f" ({step:010.6f})  can0  7E8   [2]  03 {k:02X}" for k, step in enumerate([0.0, *differences_s])]
    found = read_candump(shown)
    assert found.portions[-1].time_ns - WITHOUT_DATE_NS == round(sum(differences_s) * NS)
    assert "times since the frame before" in found.notes[0] and found.rows == 31
    since_start = read_candump([f" ({k / 10:010.6f})  can0  7E8   [2]  03 00" for k in range(31)])
    assert not since_start.notes and since_start.portions[-1].time_ns - WITHOUT_DATE_NS == 3 * NS


def test_a_log_without_stamps_says_so_and_lines_that_are_none_are_counted() -> None:
    found = read_candump(["can0  7E8   [8]  03 41 0D 32 00 00 00 00", "hello", ""])
    assert found.rejects["line"] == 1 and found.rows == 2 and "no time stamps" in found.notes[0]


def test_absolute_stamps_are_utc() -> None:
    found = read_candump(["(1436509052.249713) can0 7E8#03410D3200000000"])
    assert (found.clock, found.portions[0].time_ns) == (ClockKind.UTC, 1_436_509_052_249_713_000)


def test_corrections_alone_say_what_is_missing(tmp_path: Path) -> None:
    (tmp_path / "base.rtcm3").write_bytes(rtcm(1005) * 3)
    with pytest.raises(UserError, match="give the file of its receiver as well"):
        import_devices([tmp_path / "base.rtcm3"], tmp_path / "out.mcap", None, {})


def test_corrections_go_with_their_receiver(drive: Path, tmp_path: Path) -> None:
    (tmp_path / "base.rtcm3").write_bytes(rtcm(1005) * 3)
    out = tmp_path / "out.mcap"
    assert import_devices([tmp_path / "base.rtcm3", drive / "rover.ubx"], out, None, {}) == 0
    assert stamps(out, "corrections/raw") and stamps(out, "gnss/raw")


def test_a_file_of_a_protocol_that_is_not_decoded_is_named_with_what_to_do(tmp_path: Path) -> None:
    rest = struct.pack("<HH", 4007, 96) + bytes(88)
    path = tmp_path / "rover.sbf"
    path.write_bytes((b"$@" + struct.pack("<H", crc16_ccitt(rest)) + rest) * 10)
    with pytest.raises(UserError, match="holds Septentrio SBF, which is not decoded; convert it"):
        import_drive(path, None, tmp_path / "drive.mcap")
