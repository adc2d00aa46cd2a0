"""`obu doctor` reports faults with their remedies."""

import os
import pty
import signal
import subprocess
import sys
import threading
import tty
from pathlib import Path

import pytest

from cli import doctor
from cli.demo.local import free_port, start_of_broker
from cli.doctor.corrections import corrections, corrections_set_up
from cli.doctor.devices import devices, socketcan_fault
from cli.doctor.host import host
from cli.doctor.unit import found, messages, receiver
from shared.messages.base import Message
from shared.messages.corrections import CorrectionsState, CorrectionStream, SourcePhase
from shared.messages.gnss import CarrierSolution, FixType, GnssConfiguration, GnssFix, GnssReceiver
from shared.messages.operation import (
    DeviceFound,
    DeviceState,
    MessageKind,
    MessageUse,
    Mode,
    ModeState,
    ProcessHealth,
    ProcessState,
)
from shared.runtime.config import BrokerAddress, parse_vehicle
from tests.support.bus import brokers
from tests.support.patience import HANGS_S


def test_a_missing_broker_is_reported_with_its_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    monkeypatch.setenv("OBU_BROKER", "mqtt://127.0.0.1:1")
    assert doctor.examine(None) == 1
    printed = capsys.readouterr().out
    assert "NO  broker at 127.0.0.1:1" in printed and "OBU_BROKER" in printed
    assert "ok  [core.fusion]" in printed


def test_a_broker_without_a_unit_is_reported_with_its_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broker = brokers.start(brokers.SIMULATED, tmp_path)
    try:
        monkeypatch.setenv("OBU_STATE", str(tmp_path))
        monkeypatch.setenv("OBU_BROKER", f"mqtt://127.0.0.1:{broker.port}")
        assert doctor.examine(None) == 1
    finally:
        broker.stop()
    assert "NO  processes of 'vehicle'" in capsys.readouterr().out


def test_an_invalid_setting_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    monkeypatch.setenv("OBU_BROKER", "mqtt://127.0.0.1:1")
    vehicle = tmp_path / "vehicle.toml"
    vehicle.write_text("[core.fusion]\nlever_arm_m = [0, 0, 0]\n")
    assert doctor.examine(vehicle) == 1
    assert "did you mean [vehicle.gnss] lever_arm_" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("sections", "faults"),
    [
        ("", set()),
        ("[sensors.v2x]\n[parsers.v2x]\n", set()),
        ("[sensors.v2x]\n", {"CAM codec"}),
        ("[sensors.v2x]\n[parsers.v2x]\n[controller.cam]\n", {"own CAM is sent"}),
        ('[sensors.v2x]\nsend_to = "udp://127.0.0.1:5"\n[parsers.v2x]\n[controller.cam]\n', set()),
        ('[sensors.v2x]\ndevice = "mqtt://127.0.0.1:5/a"\n[parsers.v2x]\n[controller.cam]\n', set()),
        ("[controller.cam]\n", {"CAM codec", "own CAM is sent"}),
        ('[sensors.v2x]\n[parsers.v2x.security]\ntrust_folder = "absent"\n', {"trust folder absent"}),
        ('[sensors.v2x]\n[parsers.v2x.security]\ntrust_folder = "deploy/trust"\n', set()),
    ],
)
def test_sections_of_v2x_that_do_not_fit_together_are_reported(
    sections: str,
    faults: set[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    monkeypatch.setenv("OBU_BROKER", "mqtt://127.0.0.1:1")
    vehicle = tmp_path / "vehicle.toml"
    vehicle.write_text(sections)
    doctor.examine(vehicle)
    printed = capsys.readouterr().out.splitlines()
    assert {
        what for what in ("CAM codec", "own CAM is sent", "trust folder absent") if f"NO  {what}" in printed
    } == faults


def test_a_store_that_the_broker_set_aside_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    monkeypatch.setenv("OBU_BROKER", "mqtt://127.0.0.1:1")
    (tmp_path / "broker").mkdir()
    (tmp_path / "broker" / "mosquitto.db.unreadable").write_bytes(bytes(8))
    assert doctor.examine(None) == 1
    assert "NO  the broker could not read its store, and started without it" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("section", "reason"),
    [
        ('[sensors.gnss]\ndevice = "serial:///dev/no-such-port"', "No such file"),
        ('[sensors.gnss]\ndevice = "serial://1546:01a9"', "no USB device 1546:01a9"),
        ('[sensors.imu]\ndevice = "tcp://127.0.0.1:1"', "Connection refused"),
        ('[sensors.imu]\ndevice = "file:///no/such/file"', "No such file"),
        ("[sensors.gnss]", "/dev/obu-gnss"),
    ],
)
def test_a_device_is_opened_as_its_driver_does_and_the_reason_of_its_failure_is_told(section: str, reason: str) -> None:
    [finding] = devices(parse_vehicle(section), probe=False)
    assert not finding.ok and reason in f"{finding.what} {finding.remedy}"


def test_a_device_that_can_be_opened_is_ok(tmp_path: Path) -> None:
    (tmp_path / "receiver.ubx").write_bytes(b"\xb5\x62")
    [finding] = devices(parse_vehicle(f'[sensors.gnss]\ndevice = "file://{tmp_path}/receiver.ubx"'), probe=False)
    assert finding.ok


def fix(*, located: bool) -> GnssFix:
    return GnssFix(
        sampled_ns=1, received_ns=1, source="gnss0", fix_type=FixType.THREE_D if located else FixType.NONE,
        latitude_deg=42.0 if located else None, longitude_deg=13.0 if located else None,
    )  # fmt: skip


SAID = GnssReceiver(
    received_ns=1, source="gnss0", messages=("UBX NAV-POSLLH",), received_bytes=36, other_bytes=0
)  # fmt: skip
MODE = ModeState(sampled_ns=1, mode=Mode.DETECTING, since_ns=1, reason="no data from the IMU yet")
ANSWER = GnssConfiguration(request_id=1, source="gnss0", accepted=True)


@pytest.mark.parametrize(
    ("heard", "results", "remedies"),
    [
        ([fix(located=True), ANSWER], [True, True], ""),
        ([fix(located=False), ANSWER, MODE], [False, True], "no data from the IMU yet"),
        ([SAID, MODE], [False, False], "gnss0 sends UBX NAV-POSLLH"),
        ([fix(located=True), ANSWER.model_copy(update={"accepted": False, "reason": "older"})], [True, False], "older"),
        ([], [False, False], "nothing is heard of it"),
    ],
)
def test_a_receiver_without_a_position_or_a_configuration_is_not_healthy(
    heard: list[Message], results: list[bool], remedies: str
) -> None:
    findings = list(receiver(heard, configured=True))
    assert [finding.ok for finding in findings] == results
    assert remedies in " ".join(finding.remedy for finding in findings)
    assert [finding.ok for finding in receiver(heard, configured=False)] == results[:1]


def test_the_command_that_starts_the_broker_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cli.demo.local.SERVICE", Path("/no/such/service"))
    assert start_of_broker(BrokerAddress()) == "start one with `obu broker`"
    assert start_of_broker(BrokerAddress(port=1884)) == "start one with `obu broker --port 1884`"
    assert start_of_broker(BrokerAddress.at(Path("/state/bus/socket"))) == "start one with `obu broker`"
    assert start_of_broker(BrokerAddress("10.0.0.7")) == "start the broker on 10.0.0.7"


def test_up_without_a_broker_says_one_line_and_waits_and_the_broker_command_ends_the_wait(tmp_path: Path) -> None:
    port = free_port()
    environment = {**os.environ, "OBU_STATE": str(tmp_path), "OBU_BROKER": f"mqtt://127.0.0.1:{port}"}

    def start(*arguments: str) -> "subprocess.Popen[str]":
        command = [sys.executable, "-m", "cli", *arguments]
        return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    with start("up") as unit:
        assert unit.stdout is not None
        line = unit.stdout.readline()
        assert line.startswith(f"no broker at 127.0.0.1:{port} (Connection refused); waiting for it: start one with")
        with start("broker", "--port", str(port), "--broker", "simulated") as broker:
            assert broker.stdout is not None and broker.stdout.readline().startswith("broker at mqtt://127.0.0.1:")
            assert "started" in unit.stdout.readline() or unit.poll() is None
            unit.send_signal(signal.SIGTERM)
            unit.communicate(timeout=HANGS_S)
            broker.send_signal(signal.SIGTERM)
            broker.communicate(timeout=HANGS_S)


CORRECTIONS = '[sensors.corrections]\nsources = ["ntrip://me@127.0.0.1/M"]\n'


@pytest.mark.parametrize(
    ("sections", "passed"),
    [
        ("", []),
        (CORRECTIONS + "[parsers.corrections]\n", [True]),
        (CORRECTIONS, [False]),
        ("[parsers.corrections]\n", [False]),
    ],
)
def test_sections_of_corrections_that_do_not_fit_together_are_reported(sections: str, passed: list[bool]) -> None:
    checks = list(corrections_set_up(parse_vehicle(sections)))
    assert [ok for ok, _, _ in checks] == passed and all(
        "add the section" in remedy for ok, _, remedy in checks if not ok
    )


def corrections_state(active: str | None, *streams: CorrectionStream) -> CorrectionsState:
    return CorrectionsState(sampled_ns=1, active=active, reason="why", frame_age_s=1.0, streams=streams)


def corrected(carrier: CarrierSolution, *, differential: bool) -> GnssFix:
    return GnssFix(
        sampled_ns=1, received_ns=1, source="gnss0", fix_type=FixType.THREE_D, carrier_solution=carrier,
        differential=differential,
    )  # fmt: skip


def test_corrections_that_arrive_and_are_used_are_told_with_their_source_and_others_with_a_remedy() -> None:
    vehicle = parse_vehicle(CORRECTIONS + "[parsers.corrections]\n")
    refused = CorrectionStream(source="b", phase=SourcePhase.REFUSED, reason="wrong password")
    heard = [corrections_state("a", refused), corrected(CarrierSolution.FIXED, differential=True)]
    found = list(corrections(vehicle, heard))
    assert [(ok, what) for ok, what, _ in found] == [
        (True, "corrections arrive from a, the last frame 1 s ago"), (False, "corrections from b"),
        (True, "the receiver uses corrections: RTK fixed"),
    ]  # fmt: skip
    unused = list(corrections(vehicle, [corrections_state("a"), corrected(CarrierSolution.NONE, differential=False)]))
    assert [ok for ok, _, _ in unused] == [True, False] and "RTCM 3" in unused[-1][2]
    assert list(corrections(vehicle, [corrections_state(None)])) == [(False, "corrections arrive", "why")]
    assert "see its log" in next(iter(corrections(vehicle, [])))[2] and not list(corrections(parse_vehicle(""), []))


def pipe(tmp_path: Path) -> tuple[int, str]:
    """A port with a far end: a pseudo-terminal in place of hardware; return the far end and the URL."""
    far, near = pty.openpty()
    tty.setraw(near)
    link = tmp_path / "port"
    link.symlink_to(os.ttyname(near))
    os.close(near)
    return far, f"serial://{link}?baud=9600"


def test_a_receiver_without_a_fix_is_recognised_by_listening(tmp_path: Path) -> None:
    far, url = pipe(tmp_path)
    stop = threading.Event()

    def speak() -> None:
        while not stop.wait(0.1):
            os.write(far, b"$GNRMC,,V,,,,,,,,,,N*4D\r\n")

    speaker = threading.Thread(target=speak)
    speaker.start()
    try:
        [finding] = devices(parse_vehicle(f'[sensors.gnss]\ndevice = "{url}"'), probe=False)
    finally:
        stop.set()
        speaker.join()
        os.close(far)
    assert finding.ok, finding
    assert "NMEA at 9600 baud" in finding.what and "messages a second" in finding.what


def test_an_interface_of_the_kernel_is_named_with_the_command_that_starts_it(tmp_path: Path) -> None:
    assert "there is no interface can0" in (socketcan_fault("can0", tmp_path) or "")
    (tmp_path / "can0").mkdir()
    (tmp_path / "can0" / "flags").write_text("0x40080\n")
    assert "sudo ip link set can0 up type can bitrate" in (socketcan_fault("can0", tmp_path) or "")
    (tmp_path / "can0" / "flags").write_text("0x40081\n")
    assert socketcan_fault("can0", tmp_path) is None


@pytest.mark.parametrize(
    ("temperature", "throttled", "faults"),
    [
        ("45000", "0", []),
        ("85000", "0x0", ["the processor has 85 °C"]),
        ("45000", "0x1", ["the supply voltage is too low"]),
        ("45000", "0x50000", ["the supply voltage was too low since the start"]),
        ("x", "x", []),
    ],
)
def test_heat_and_low_voltage_are_told(temperature: str, throttled: str, faults: list[str], tmp_path: Path) -> None:
    zone, firmware = tmp_path / "sys/class/thermal/thermal_zone0", tmp_path / "sys/devices/platform/soc/soc:firmware"
    zone.mkdir(parents=True)
    firmware.mkdir(parents=True)
    (zone / "temp").write_text(temperature)
    (firmware / "get_throttled").write_text(throttled)
    failed = [finding for finding in host(tmp_path, tmp_path) if not finding.ok and "clock" not in finding.what]
    assert [finding.what for finding in failed if "GB free" not in finding.what] == faults
    assert all(finding.remedy for finding in failed)


def test_what_drivers_found_and_what_became_of_messages_is_told() -> None:
    state = DeviceState(
        sampled_ns=1, source="gnss0", process="sensors.gnss", device="serial:///dev/obu-gnss", found=DeviceFound.NOISE,
        rate_baud=9600, sentence="bytes that are no message",
    )  # fmt: skip
    [finding] = found([state])
    assert not finding.ok and finding.remedy == "bytes that are no message"

    def health(second: int, count: int) -> ProcessHealth:
        kinds = (
            MessageKind(kind="UBX NAV-PVT", use=MessageUse.USED, count=count, rejected=count // 2, reason="ubx_date"),
            MessageKind(kind="UBX HNR-PVT", use=MessageUse.UNUSED, count=count),
            MessageKind(kind="UBX 77-01", use=MessageUse.UNKNOWN, count=1),
        )
        return ProcessHealth(
            process="parsers.gnss", state=ProcessState.READY, incarnation=1, sent_ns=second * 10**9, kinds=kinds
        )

    told = list(messages("parsers.gnss", [health(0, 10), health(2, 20)]))
    assert [finding.ok for finding in told] == [True, True, True, False]
    text = " ".join(finding.what for finding in told)
    assert "used: UBX NAV-PVT 5.0/s" in text and "unused: UBX HNR-PVT 5.0/s" in text and "unknown: UBX 77-01" in text
    assert "10 of 20 UBX NAV-PVT rejected (ubx_date)" in text
