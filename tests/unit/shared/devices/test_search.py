"""What a device speaks is found out by its bytes, at whatever rate of the port, with or without a fix."""

import struct
from collections.abc import Callable
from functools import reduce
from operator import xor

import pytest

from shared.devices.search import RATES, Search
from shared.maths.crc import crc16_ccitt, fletcher
from shared.messages.operation import DeviceFound
from shared.protocols import xbus
from shared.protocols.recognition import recognise
from tests.support.data import recording

VERSION = bytes.fromhex("b5620a04") + (40).to_bytes(2, "little") + bytes(40)
VERSION += fletcher(VERSION[2:])
WITHOUT_FIX = b"$GNRMC,,V,,,,,,,,,,N*4D\r\n$GNGGA,,,,,,0,00,99.99,,,,,,*56\r\n"
INERTIAL = xbus.encode_mtdata2({xbus.SAMPLE_TIME_FINE: xbus.encode_field(xbus.SAMPLE_TIME_FINE, 100)})
GOTO_CONFIG, GOTO_MEASUREMENT = bytes.fromhex("faff3000d1"), bytes.fromhex("faff1000f1")


class FakePort:
    """A serial port, with a device at its true rate: a fake, since no hardware is here. At other rates it is noise."""

    def __init__(self, device: Callable[[bytes], bytes], rate_baud: int, says: bytes = b"") -> None:
        self.device, self.true_baud, self.says = device, rate_baud, says
        self.rate_baud = 0
        self.written: list[tuple[int, bytes]] = []
        self._answer = b""

    def run(self, search: Search, duration_s: float) -> list[DeviceFound]:
        """Let time pass in steps of 0.1 s; the device says its own once a second. Give what was found in each step."""
        self.rate_baud = search.rate_baud or 0
        found = []
        for k in range(round(duration_s * 10)):
            data, self._answer = self._answer + (self.says if k % 10 == 0 else b""), b""
            heard = data if self.rate_baud == self.true_baud else bytes(b ^ 0xA5 for b in data[::3])
            step = search.take(heard, k * 0.1)
            if step is not None:
                self._write(step.before)
                self.rate_baud = step.rate_baud or self.rate_baud
                self._write(step.write)
            found.append(search.found)
        return found

    def _write(self, data: bytes) -> None:
        if data:
            self.written.append((self.rate_baud, data))
            if self.rate_baud == self.true_baud:
                self._answer += self.device(data)


def mute(_: bytes) -> bytes:
    return b""


@pytest.mark.parametrize("rate_baud", RATES)
def test_a_receiver_without_a_fix_is_found_at_any_rate_by_listening_alone(rate_baud: int) -> None:
    search = Search("gnss", 115200, may_write=False)
    port = FakePort(mute, rate_baud, WITHOUT_FIX)
    found = port.run(search, 10.0)
    assert (search.found, search.rate_baud, search.protocols) == (DeviceFound.WORKING, rate_baud, ("NMEA",))
    assert found.index(DeviceFound.WORKING) <= 90, "it takes no longer than the rates before it"
    assert not port.written
    assert ("write baud=" in search.sentence()) == (rate_baud != 115200)


@pytest.mark.parametrize("rate_baud", [9600, 230400])
def test_a_silent_receiver_is_found_by_a_question_within_30_s(rate_baud: int) -> None:
    search = Search("gnss", 38400, may_write=True)
    port = FakePort(lambda _: VERSION, rate_baud)
    found = port.run(search, 13.0)
    assert (search.protocols, search.rate_baud) == (("UBX",), rate_baud)
    assert DeviceFound.WORKING in found
    assert all(data == bytes.fromhex("b5620a0400000e34") for _, data in port.written)


def test_nothing_is_written_where_it_is_not_allowed() -> None:
    port = FakePort(lambda _: VERSION, 9600)
    search = Search("gnss", 38400, may_write=False)
    port.run(search, 9.0)
    assert not port.written
    assert search.found is DeviceFound.SILENT
    assert "no bytes at 9600, 38400, 115200, 230400, 460800, 921600 baud" in search.sentence()


def test_a_tracker_in_its_configuration_mode_is_found_and_measures_again() -> None:
    measuring = [False]

    def tracker(data: bytes) -> bytes:
        measuring[0] = data == GOTO_MEASUREMENT
        return bytes.fromhex("faff3100d0") if data == GOTO_CONFIG else b""

    search = Search("imu", 115200, may_write=True)
    port = FakePort(tracker, 921600)
    port.run(search, 13.0)
    assert search.rate_baud == 921600 and measuring == [True]
    asked = [pair for pair in port.written if pair[1] == GOTO_CONFIG]
    assert len(port.written) == 2 * len(asked), "each question is taken back at its rate"


def test_a_tracker_that_measures_is_never_asked() -> None:
    port = FakePort(mute, 115200, INERTIAL)
    search = Search("imu", 115200, may_write=True)
    port.run(search, 30.0)
    assert search.found is DeviceFound.WORKING and not port.written


@pytest.mark.parametrize("says", [bytes(range(128, 250)) * 3])
def test_noise_is_named_as_noise(says: bytes) -> None:
    search = Search("gnss", 38400, may_write=True)
    FakePort(mute, 1200, says).run(search, 15.0)
    assert search.found is DeviceFound.NOISE
    assert "bytes that are no message at 9600, 38400" in search.sentence()


def test_another_protocol_is_named_and_its_bytes_stay() -> None:
    search = Search("gnss", 38400, may_write=True)
    FakePort(mute, 115200, INERTIAL * 3).run(search, 20.0)
    assert (search.found, search.protocols, search.rate_baud) == (DeviceFound.OTHER, ("Xbus",), 115200)
    assert "speaks Xbus at 115200 baud, which is not read here: set the device to send UBX or NMEA" in search.sentence()


def sbf(number: int = 4007, size: int = 96) -> bytes:
    rest = struct.pack("<HH", number, size) + bytes(size - 8)
    return b"$@" + struct.pack("<H", crc16_ccitt(rest)) + rest


def test_a_protocol_that_is_not_decoded_is_named_with_what_to_switch_on() -> None:
    search = Search("gnss", 115200, may_write=False)
    FakePort(mute, 115200, sbf() * 3).run(search, 10.0)
    assert (search.found, search.protocols) == (DeviceFound.OTHER, ("SBF",))
    assert search.sentence().startswith("Septentrio SBF at 115200 baud: not decoded; switch NMEA on at this port")


def test_sentences_between_blocks_of_sbf_are_read() -> None:
    search = Search("gnss", 115200, may_write=False)
    FakePort(mute, 115200, sbf() + WITHOUT_FIX + sbf()).run(search, 2.0)
    assert (search.found, search.protocols) == (DeviceFound.WORKING, ("NMEA",))


def checked(body: str) -> bytes:
    return f"${body}*{reduce(xor, body.encode(), 0):02X}\r\n".encode()


@pytest.mark.parametrize(
    "line",
    [
        b"0.1,0.2,9.81,0.0,0.0,0.1\r\n", b"$IMU,1000,0.01,-0.02,9.81,0.1,0.0,-0.1\r\n", b"#IMU,1,2,3\r",
        checked("VNIMU,-00.4,+00.1,-00.3,-00.02,+00.01,-09.8,+00.0,-00.0,+00.0,+20,+101"), b'{"acc": [0, 0, 9.8]}\n',
        b'{"acc": [0, 0, 9.8], "comment": "' + b"x" * 400 + b'"}\n',
    ],
)  # fmt: skip
def test_lines_of_an_imu_are_read_whatever_they_begin_with(line: bytes) -> None:
    search = Search("imu", 115200, may_write=True)
    port = FakePort(mute, 115200, line * 10)
    port.run(search, 30.0)
    assert (search.found, search.protocols, search.rate_baud) == (DeviceFound.WORKING, ("text lines",), 115200)
    assert not port.written


@pytest.mark.parametrize("says", [WITHOUT_FIX * 5, b"$GPGGA,1,2,3\r\n" * 10, b"t7E8803410D\r" * 10])
def test_sentences_of_a_receiver_and_lines_of_an_adapter_are_no_lines_of_an_imu(says: bytes) -> None:
    assert "text lines" not in recognise(says).names


def test_a_device_that_changes_its_rate_is_found_again() -> None:
    search = Search("gnss", 38400, may_write=True)
    port = FakePort(mute, 38400, WITHOUT_FIX)
    port.run(search, 5.0)
    assert search.found is DeviceFound.WORKING
    port.true_baud, later = 9600, 0

    for k in range(400):
        data = WITHOUT_FIX if k % 10 == 0 else b""
        heard = data if port.rate_baud == 9600 else bytes(b ^ 0xA5 for b in data[::3])
        if (step := search.take(heard, 5.0 + k * 0.1)) is not None:
            port.rate_baud = step.rate_baud or port.rate_baud
        later += search.found is DeviceFound.WORKING
    assert search.found is DeviceFound.WORKING and search.rate_baud == 9600


def test_a_silent_device_is_searched_for_again_and_found_when_it_speaks() -> None:
    search = Search("gnss", None, may_write=True)
    port = FakePort(mute, 0)
    port.run(search, 3.0)
    assert search.sentence() == "no bytes: check cable, power, and that TX and RX are not exchanged"
    for k in range(30):
        search.take(WITHOUT_FIX if k % 10 == 0 else b"", 40.0 + k * 0.1)
    assert search.found is DeviceFound.WORKING


@pytest.mark.recording
@pytest.mark.parametrize(
    ("folder", "name", "protocols"),
    [
        ("gpsd_receiver_logs", "ublox-neo-m8t.log", {"UBX"}),
        ("gpsd_receiver_logs", "ublox-zed-f9p-nmea.log", {"NMEA"}),
        ("spartn_logs", "d9s_spartn_data.bin", {"SPARTN"}),
    ],
)
def test_recorded_devices_are_recognised(folder: str, name: str, protocols: set[str]) -> None:
    assert protocols <= set(recognise((recording(folder) / name).read_bytes()).names)


def test_protocols_that_are_not_read_are_told_from_noise() -> None:
    sbf = bytes.fromhex("2440") + (0).to_bytes(2, "little")
    body = (4007).to_bytes(2, "little") + (16).to_bytes(2, "little") + bytes(8)
    crc = 0
    for byte in body:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    sbf = sbf[:2] + crc.to_bytes(2, "little") + body
    assert recognise(b"xx" + sbf + b"yy").names == ("SBF",)
    assert recognise(sbf[:-1] + b"z").names == ()
    sirf = b"\xa0\xa2\x00\x03\x02\x10\x20" + (0x32).to_bytes(2, "big") + b"\xb0\xb3"
    assert recognise(sirf).names == ("SiRF",)
    assert recognise(bytes(range(256)) * 8).names == ()
