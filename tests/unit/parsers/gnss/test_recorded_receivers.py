"""Recordings of receivers that others made: read to the end, and compared with what gpsd reads from the same bytes."""

import json
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from services.parsers.gnss.process import Config, Process
from shared.messages.gnss import FixType, GnssFix, GnssRaw
from shared.messages.operation import MessageUse
from tests.support.data import recording

START_NS = 1_795_000_000 * 10**9
NEAR_DEG = 2e-7  # a digit of gpsd's output, and of UBX
NEAR_M = 0.02
# By name: gpsd's solutions that are made of messages that are not used here (HNR), between those of NAV-PVT.
WITH_HNR = ("ublox-neo-m8l.log", "ublox-neo-m8u-hnr.log")
TWICE = ("ublox-zed-f9r.log",)  # gpsd reads its NMEA, with fewer digits, as well as UBX
LOGS = (
    ("u-blox-m8t-time.log", 150), ("ublox-8.log", 70), ("ublox-glo.log", 10), ("ublox-neo-m8t.log", 39),
    ("ublox-zed-f9p-hp.log", 28), ("ublox-zed-f9p-nmea.log", 29), ("ublox-zed-f9p-rtk.log", 9),
    ("ublox-zed-f9r.log", 29), ("ublox-zed-f9t-rtcm3.log", 22),
)  # fmt: skip


def read(path: Path, part: int = 64) -> tuple[Process, list[GnssFix]]:
    """Parse a log in parts, as a serial port gives it."""
    process, fixes, data = Process(Config()), list[GnssFix](), path.read_bytes()
    for k, start in enumerate(range(0, len(data), part)):
        raw = GnssRaw(
            received_ns=START_NS + k * 5_000_000, source="gnss0", data=data[start : start + part], recorded=True
        )
        fixes += [gnss_fix for gnss_fix in process.handle(raw) if isinstance(gnss_fix, GnssFix)]
    return process, fixes


def reports(path: Path) -> Iterator[dict[str, Any]]:
    """Positions of gpsd with their time; where it says that there is none, ours has none either."""
    for line in path.read_text(errors="replace").splitlines():
        if line.startswith('{"class":"TPV"'):
            report = json.loads(line)
            if report.get("mode", 1) >= 2 and "time" in report and "lat" in report:
                yield report


@pytest.mark.recording
@pytest.mark.parametrize(("name", "least"), LOGS)
def test_positions_are_those_that_gpsd_reads(name: str, least: int) -> None:
    folder = recording("gpsd_receiver_logs")
    _, fixes = read(folder / name)
    ours = {round(fix.utc_ns / 1e7): fix for fix in fixes if fix.utc_ns is not None}
    compared = 0
    for report in reports(folder / f"{name}.chk"):
        fix = ours.get(round(datetime.fromisoformat(report["time"]).timestamp() * 100))
        if fix is None or fix.latitude_deg is None or fix.longitude_deg is None:
            assert name == "ublox-glo.log", f"no position at {report['time']}"  # gnssFixOK is 0, which gpsd ignores
            continue
        compared += 1
        assert abs(fix.latitude_deg - report["lat"]) <= NEAR_DEG
        assert abs(fix.longitude_deg - report["lon"]) <= NEAR_DEG
        if "altMSL" in report and fix.height_msl_m is not None and fix.fix_type is not FixType.TWO_D:
            assert abs(fix.height_msl_m - report["altMSL"]) <= (0.06 if name in TWICE else NEAR_M)
        if "speed" in report and fix.ground_speed_m_s is not None and name not in TWICE:
            assert abs(fix.ground_speed_m_s - report["speed"]) <= NEAR_M
    assert compared >= least


@pytest.mark.recording
@pytest.mark.parametrize("name", [name for name, _ in LOGS] + list(WITH_HNR))
def test_every_byte_of_a_log_is_in_a_message_or_counted(name: str) -> None:
    path = recording(f"gpsd_receiver_logs/{name}")
    process, _ = read(path)
    table = process.kinds.table()
    lines = path.read_bytes().splitlines(keepends=True)
    text = sum(len(line) for line in lines if line.startswith((b"#", b'{"class"')))  # of the person, and of gpsd
    assert 0 < process.rejects["garbage_bytes"] <= text + 200, "beside that there is next to nothing"
    assert all(kind.use is not MessageUse.UNKNOWN for kind in table), table
    if name in WITH_HNR:
        assert {"UBX HNR-PVT", "UBX HNR-INS"} <= {kind.kind for kind in table if kind.use is MessageUse.UNUSED}
