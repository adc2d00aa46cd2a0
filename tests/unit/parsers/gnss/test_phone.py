"""Lines of Android's GnssLogger: over TCP at their own pace, in pieces, and damaged."""

import math
import random
import socket
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import pytest

from cli.import_drive.import_drive import body_from_phone
from cli.import_drive.readers.gnss_logger import messages_of, read_log
from services.core.cooperative.broadcast.galileo_inav import decode_ephemeris, decode_page
from services.core.cooperative.measurements import Constellation as Satellites
from services.core.cooperative.measurements import SatelliteId
from services.parsers.gnss.process import Config as GnssConfig
from services.parsers.gnss.process import Process as GnssParser
from services.parsers.imu.process import Config as ImuConfig
from services.parsers.imu.process import Process as ImuParser
from services.sensors.simulator.gnss.navigation_words import inav_page
from shared.devices.device import DeviceLost, open_device
from shared.messages.base import Message
from shared.messages.gnss import Constellation, GnssFix, GnssNavigationBits, GnssRaw, GnssRawEpoch
from shared.messages.imu import ImuRaw, ImuSamples
from shared.protocols.recognition import recognise
from tests.support.data import recording
from tests.support.gnss.constellation import TOE_NS, elements, ephemeris

T = TypeVar("T", bound=Message)
NS, MS = 1_000_000_000, 1_000_000
UTC_MS, ELAPSED_NS = 1_764_000_000_000, 16_000 * NS
GPS_NS = (UTC_MS - 315_964_800_000) * MS + 18 * NS
HEADER = (
    "# Fix,Provider,LatitudeDegrees,LongitudeDegrees,AltitudeMeters,SpeedMps,AccuracyMeters,BearingDegrees,"
    "UnixTimeMillis,SpeedAccuracyMps,BearingAccuracyDegrees,elapsedRealtimeNanos,VerticalAccuracyMeters",
    "# UncalAccel,utcTimeMillis,elapsedRealtimeNanos,UncalAccelXMps2,UncalAccelYMps2,UncalAccelZMps2",
)


def fix(second: float) -> str:
    return (
        f"Fix,GPS,42.37,13.35,700.0,12.0,4.5,90.0,{UTC_MS + round(1000 * second)},0.3,2.0,"
        f"{ELAPSED_NS + round(second * NS)},3.0"
    )


def raw(second: float, satellite: int, state: int = 0x09, phase_state: int = 9) -> str:
    """A satellite of GPS 22,000 km away, whose range falls by 100 m a second; its phase is valid and resolved."""
    clock_ns = 5_000 * NS + round(second * NS)
    bias_ns = clock_ns - GPS_NS - round(second * NS)
    range_m = 22_000_000.0 + 1000.0 * satellite - 100.0 * second
    sent_ns = (GPS_NS + round(second * NS) - round(range_m / 299_792_458.0 * 1e9)) % (604_800 * NS)
    return (
        f"Raw,{UTC_MS + round(1000 * second)},{clock_ns},18,5.0,{bias_ns},0.0,5.0,,,0,{satellite},0.0,{state},"
        f"{sent_ns},20,41.5,-100.0,0.05,{phase_state},{range_m},0.002,1575420030.0,,,,0,,1,"
    )


def sensor(kind: str, second: float, *values: float) -> str:
    stamps = f"{UTC_MS + round(1000 * second)},{ELAPSED_NS + round(second * NS)}"
    return f"{kind},{stamps}," + ",".join(f"{value:.6f}" for value in values) + ",0.0,0.0,0.0"


def log(seconds: float, rate_hz: float = 50.0) -> list[tuple[float, str]]:
    """Lines and when each is sent: a phone that lies flat, turned at 0.1 rad/s, with a barometer and a magnetometer."""
    rows = [(0.0, line) for line in HEADER]
    for k in range(round(seconds * rate_hz)):
        t = k / rate_hz
        rows.append((t, sensor("UncalAccel", t, 0.0, 0.0, 9.81)))
        rows.append((t + 0.001, sensor("UncalGyro", t + 0.001, 0.0, 0.0, 0.1)))
        if k % 10 == 0:
            rows += [(t, sensor("UncalMag", t, 0.0, 25.0, -40.0)), (t, sensor("Pressure", t, 930.0))]
    for k in range(math.ceil(seconds)):
        rows += [(k + 0.05, raw(k, satellite)) for satellite in (3, 7, 9)] + [(k + 0.06, fix(k))]
    return sorted(rows, key=lambda row: row[0])


def parsed(pieces: Sequence[tuple[int, bytes]]) -> tuple[list[Message], Counter[str]]:
    """What both parsers make of bytes and their arrivals [ns]."""
    gnss, imu = GnssParser(GnssConfig(use_receiver_imu=True)), ImuParser(ImuConfig())
    found: list[Message] = []
    for received_ns, data in pieces:
        for message in gnss.handle(GnssRaw(received_ns=received_ns, source="phone", data=data)):
            found.append(message)
            if isinstance(message, ImuRaw):
                found += imu.handle(message)
    return found, gnss.rejects + imu.rejects


def played(rows: Sequence[tuple[float, str]], server: socket.socket) -> None:
    """Send each line at its time, as an app does."""
    peer, _ = server.accept()
    with peer:
        start = time.monotonic()
        for at_s, line in rows:
            time.sleep(max(0.0, start + at_s - time.monotonic()))
            peer.sendall(f"{line}\n".encode())


def received_over_tcp(rows: Sequence[tuple[float, str]]) -> list[tuple[int, bytes]]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        sender = threading.Thread(target=played, args=(rows, server))
        sender.start()
        device = open_device(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        pieces = []
        try:
            while True:
                if data := device.read(0.05):
                    pieces.append((UTC_MS * MS + time.monotonic_ns() % (1000 * NS), data))
        except DeviceLost:
            sender.join()
        device.close()
        return pieces


def of_kind(found: Sequence[Message], kind: type[T]) -> list[T]:
    return [message for message in found if isinstance(message, kind)]


def test_a_log_that_is_played_over_tcp_at_its_own_pace_is_fixes_phases_and_samples() -> None:
    found, rejects = parsed(received_over_tcp(log(3.0)))
    fixes, epochs = of_kind(found, GnssFix), of_kind(found, GnssRawEpoch)
    samples = of_kind(found, ImuSamples)
    assert len(fixes) == 3 and fixes[0].latitude_deg == 42.37 and fixes[0].utc_ns == UTC_MS * MS
    assert len(epochs) >= 2 and [len(epoch.measurements) for epoch in epochs] == [3] * len(epochs)
    assert epochs[0].gps_time_ns == GPS_NS and epochs[0].leap_seconds == 18
    assert abs(epochs[0].sampled_ns - fixes[0].sampled_ns) < 1 * MS, "one clock for both"
    one = epochs[0].measurements[0]
    assert one.constellation is Constellation.GPS and one.half_cycle_resolved and one.lock_time_s is None
    assert one.carrier_phase_cycles == pytest.approx(22_003_000.0 * 1575420030.0 / 299_792_458.0)
    assert sum(len(batch.sampled_ns) for batch in samples) >= 145
    stamps = [stamp for batch in samples for stamp in batch.sampled_ns]
    assert all(later > earlier for earlier, later in pairwise(stamps))
    assert abs((stamps[-1] - stamps[0]) / NS - (len(stamps) - 1) * 0.02) < 0.05
    batch = samples[0]
    assert batch.specific_force_body_m_s2[0][2] == -9.81 and batch.angular_rate_body_rad_s[0][2] == -0.1, "up is down"
    assert any(one.pressure_pa == 93_000.0 and one.magnetic_field_body for one in samples)
    assert not rejects


def pieces_of(lines: Sequence[str], size: int) -> Iterator[tuple[int, bytes]]:
    data = "".join(f"{line}\r\n" for line in lines).encode()
    for k in range(0, len(data), size):
        yield UTC_MS * MS + k * 10_000, data[k : k + size]


def test_pieces_of_any_size_give_the_same() -> None:
    lines = [line for _, line in log(2.0)]
    whole, _ = parsed(list(pieces_of(lines, 1 << 20)))
    for size in (1, 7, 997):
        found, rejects = parsed(list(pieces_of(lines, size)))
        for kind in (GnssFix, GnssRawEpoch, ImuRaw):
            assert len(of_kind(found, kind)) >= len(of_kind(whole, kind)) - (kind is GnssRawEpoch)
        assert not {reason for reason in rejects if reason != "phone_epoch"}


def test_a_reset_a_slip_and_an_invalid_phase_are_told_by_their_flags() -> None:
    states = {3: 9, 7: 1 | 2 | 8, 9: 1 | 4, 11: 8}  # valid and resolved, reset, slip unresolved, not valid
    lines = [raw(0, satellite, phase_state=state) for satellite, state in states.items()] + [raw(1, 3)]
    epoch = of_kind(parsed(list(pieces_of(lines, 1 << 20)))[0], GnssRawEpoch)[0]
    by_number = {one.number: one for one in epoch.measurements}
    assert [by_number[n].lock_time_s for n in (3, 7, 9)] == [None, 0.0, 0.0]
    assert [by_number[n].half_cycle_resolved for n in (3, 7, 9)] == [True, True, False]
    assert by_number[11].carrier_phase_cycles is None


@pytest.mark.parametrize("early_s", [-0.0005, 0.0, 0.0005])
def test_an_epoch_beside_the_millisecond_of_its_fix_resets_no_clock(early_s: float) -> None:
    """Delays of the network up to 0.15 s: fixes stay on one line, which the least delay gives."""
    rng, gnss, offsets, epochs = random.Random(1), GnssParser(GnssConfig()), [], []
    for k in range(60):
        received_ns = UTC_MS * MS + round((k + 0.1 + 0.15 * rng.random()) * NS)
        data = f"{raw(k - early_s, 5)}\n{fix(float(k))}\n".encode()
        for message in gnss.handle(GnssRaw(received_ns=received_ns, source="phone", data=data)):
            if isinstance(message, GnssFix):
                offsets.append((message.sampled_ns - UTC_MS * MS) / NS - k)
            elif isinstance(message, GnssRawEpoch):
                epochs.append((message.sampled_ns - UTC_MS * MS) / NS - round((message.gps_time_ns - GPS_NS) / NS))
    assert len(offsets) == 60 and len(epochs) >= 58
    for found in (offsets[10:], epochs[10:]):
        assert max(found) - min(found) < 0.025


@pytest.mark.parametrize("utc_ms", ["9999999999999", "4611686018428", "1e13", "9e18", "-1"])
def test_a_fix_whose_time_no_clock_holds_is_rejected(utc_ms: str) -> None:
    line = fix(0.0).replace(str(UTC_MS), utc_ms)
    found, rejects = parsed(list(pieces_of([line, fix(1.0)], 1 << 20)))
    assert len(of_kind(found, GnssFix)) == 1 and rejects == {"phone_fix": 1}


def test_after_a_step_of_the_receivers_clock_all_phases_of_the_epoch_begin_again() -> None:
    def counted(second: float, satellite: int, count: str) -> str:
        parts = raw(second, satellite).split(",")
        parts[10] = count
        return ",".join(parts)

    counts = ["4", "4", "5", "5", "", "5"]
    lines = [counted(k, satellite, count) for k, count in enumerate(counts) for satellite in (3, 7)]
    epochs = of_kind(parsed(list(pieces_of([*lines, raw(6, 3)], 1 << 20)))[0], GnssRawEpoch)
    locks = [[one.lock_time_s for one in epoch.measurements] for epoch in epochs]
    assert locks == [[None, None], [None, None], [0.0, 0.0], *[[None, None]] * 3]


@pytest.mark.parametrize("kept", ["Accel", "Gyro"])
def test_a_calibrated_sensor_is_used_again_after_a_second_without_the_other(kept: str) -> None:
    """One line of the uncalibrated sensor does not silence the calibrated one for good."""
    imu, times = ImuParser(ImuConfig()), []
    for k in range(300):
        t = k / 100
        lines = [sensor("Accel", t, 0.0, 0.0, 9.81), sensor("Gyro", t, 0.0, 0.0, 0.1)]
        if k == 50:
            lines.append(sensor(f"Uncal{kept}", t + 0.001, 0.0, 0.0, 9.81 if kept == "Accel" else 0.1))
        data = "".join(f"{line}\n" for line in lines).encode()
        for message in imu.handle(ImuRaw(received_ns=UTC_MS * MS + round(t * NS), source="phone/imu", data=data)):
            if isinstance(message, ImuSamples):
                times += [t] * len(message.sampled_ns)
    assert sum(t < 0.5 for t in times) >= 48
    assert not [t for t in times if 0.6 < t < 1.4], "the other one is in use"
    assert sum(t > 1.6 for t in times) >= 135


def test_words_of_a_subframe_are_those_of_a_receiver() -> None:
    words = [0x22C00000 + 12345 * k & 0x3FFFFFFF for k in range(10)]
    data = ",".join(str(byte - 256 if byte > 127 else byte) for word in words for byte in word.to_bytes(4, "big"))
    found, rejects = parsed(list(pieces_of([f"Nav,7,257,1,-1,1,{data}", f"Nav,7,257,1,-1,1,{data},5"], 1 << 20)))
    (bits,) = of_kind(found, GnssNavigationBits)
    assert (bits.number, bits.signal, bits.words) == (7, "1C", tuple(words)) and rejects == {"phone_nav": 1}


def nav_line(svid: int, words: Sequence[int]) -> str:
    """Line of a page of I/NAV: both halves without their tails, and four bits that are not used."""
    even, odd = (int.from_bytes(b"".join(word.to_bytes(4, "big") for word in half)) >> 14 for half in
                 (words[:4], words[4:]))  # fmt: skip
    content = ((even << 114 | odd) << 4).to_bytes(29, "big")
    return f"Nav,{svid},1537,1,-1,1," + ",".join(str(byte - 256 if byte > 127 else byte) for byte in content)


def test_pages_of_galileo_are_those_of_a_receiver_and_give_its_ephemeris() -> None:
    sent = ephemeris(SatelliteId(Satellites.GALILEO, 11), 1.0, 0.5)
    pages = [inav_page(elements(sent), kind, TOE_NS // NS + 2 * kind) for kind in range(1, 6)]
    found, rejects = parsed(list(pieces_of([nav_line(11, page) for page in pages], 1 << 20)))
    bits = of_kind(found, GnssNavigationBits)
    assert [one.words for one in bits] == pages and not rejects
    words = {word.number: word for one in bits if (word := decode_page(one.words)) is not None}
    decoded = decode_ephemeris(11, words, TOE_NS)
    assert decoded is not None and decoded.healthy and (decoded.issue, decoded.toe_ns) == (sent.issue, sent.toe_ns)
    assert decoded.sqrt_a == pytest.approx(sent.sqrt_a, abs=2.0**-19)

    broken = nav_line(11, pages[0]).rsplit(",", 1)[0], nav_line(37, pages[0])
    assert parsed(list(pieces_of(broken, 1 << 20)))[1] == {"phone_nav": 2}


HOSTILE = [
    b"Raw," + b"9" * 3000 + b"\n", b"Raw,,,,,,\n" * 50, b"Fix,GPS,1e999,nan,,,,,inf,\n", b"Raw," + b"," * 2000 + b"\n",
    b"UncalGyro,1,99999999999999999999999999,1,1,1\n", b"UncalAccel,1,2,1e30,nan,x\n", b"# Raw," + b"a," * 900 + b"\n",
    b"Nav,1,257,1,1,1," + b"1," * 900 + b"\n", b"Fix,GPS,91,0,0,0,0,0,1,\n", b"# Raw,,,,,,,,,,,\n", b"Gyro,\n",
    b"Pressure,1,2,-5\n", b"Fix,GPS,1,1,1e308,1e308,1e308,1e308,1764000000000,\n",
]  # fmt: skip


def test_hostile_lines_cost_a_reject_and_never_a_fault() -> None:
    rng = random.Random(1)
    lines = [f"{line}\n".encode() for _, line in log(1.0)]
    data = b"".join(rng.choice([*HOSTILE, *lines]) for _ in range(2000))
    damaged = bytearray(data)
    for _ in range(2000):
        damaged[rng.randrange(len(damaged))] = rng.randrange(256)
    for content in (data, bytes(damaged)):
        found, rejects = parsed([(UTC_MS * MS + k * MS, content[k : k + 4096]) for k in range(0, len(content), 4096)])
        assert found and "fault" not in rejects and sum(rejects.values()) > 100


def test_a_recorded_log_gives_the_epochs_that_its_import_gives() -> None:
    path = recording("gsdc_samples") / "android_measurements_pixel6.txt"
    text = path.read_text()
    imported = [
        m for m in messages_of(read_log(text.splitlines()), body_from_phone("y,x,-z")) if isinstance(m, GnssRawEpoch)
    ]
    pieces = [(imported[0].sampled_ns + k, line.encode() + b"\n") for k, line in enumerate(text.splitlines())]
    epochs = of_kind(parsed(pieces)[0], GnssRawEpoch)
    times = {epoch.gps_time_ns: epoch.measurements for epoch in imported}
    assert len(epochs) >= len(imported) - 1
    assert all(times[epoch.gps_time_ns] == epoch.measurements for epoch in epochs)


def test_a_phone_is_recognised_and_a_text_of_another_device_is_not(tmp_path: Path) -> None:
    assert recognise("".join(f"{line}\n" for _, line in log(1.0)).encode()).names[0] == "GnssLogger"
    assert "GnssLogger" not in recognise(b"1000,0.01,-0.02,9.81,0.1,0.0,-0.1\r\n" * 50).names
