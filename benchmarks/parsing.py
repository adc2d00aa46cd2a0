"""Measures how fast the bytes of a receiver become messages, beside pyubx2 on the same bytes.

Each stream is a simulated drive whose epochs hold one kind of message, or all of them.
"""

import argparse
import struct
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from pyubx2.ubxreader import UBXReader
from pyubx2.ubxtypes_core import UBX_MSGIDS

from benchmarks import tables
from services.parsers.gnss.process import Config, Process
from services.parsers.gnss.protocols import FRAMINGS
from services.sensors.simulator.world import messages
from shared.messages.gnss import GnssRaw
from shared.protocols.framing.framer import Framer
from shared.protocols.ubx import ubx_frame

RESULTS = Path(__file__).parent / "results"
GOAL_MB_S = 2.0  # 1 MB/s on half a core
STREAMS = (("NAV-PVT",), ("RXM-RAWX",), ("NAV-SAT",), ("NAV-PVT", "NAV-DOP", "NAV-COV", "NAV-SAT", "RXM-RAWX"))
STEP_NS = 50_000_000
TITLE = """# Bytes of a receiver to messages

By `python -m benchmarks.parsing`: MB of UBX for each second of processor time, framing included; pyubx2 only parses the
same frames. The goal is 2 MB/s, half a core for 1 MB/s.

| messages of an epoch | bytes | unit, MB/s | pyubx2, MB/s | ratio |
| --- | --- | --- | --- | --- |
"""


def longest_frames() -> dict[str, bytes]:
    """The longest frame of each kind that the simulated receiver sends in a minute."""
    data = b"".join(message.data for message in messages("urban", 1, 60.0) if isinstance(message, GnssRaw))
    found: dict[str, bytes] = {}
    for frame in Framer(FRAMINGS).feed(data):
        name = UBX_MSGIDS.get(frame.data[2:4], "") if frame.protocol == "UBX" else ""
        if len(frame.data) > len(found.get(name, b"")):
            found[name] = frame.data
    return found


def at(frame: bytes, itow_ms: int) -> bytes:
    """The frame at another time of week."""
    raw = frame[2] == 0x02  # RXM: a double in seconds
    time_field = struct.pack("<d", itow_ms * 1e-3) if raw else struct.pack("<I", itow_ms)
    payload = time_field + frame[6 + len(time_field) : -2]
    return ubx_frame(frame[2], frame[3], payload)


def epochs_of(frames: Sequence[bytes], size: int) -> list[bytes]:
    """As many epochs as have about a number of bytes."""
    number = size // sum(map(len, frames))
    return [b"".join(at(frame, 100_000 + k * 50) for frame in frames) for k in range(number)]


def unit_mb_s(epochs: Sequence[bytes]) -> float:
    """Speed of `parsers.gnss`."""
    process, begin_s = Process(Config()), time.process_time()
    for k, epoch in enumerate(epochs):
        raw = GnssRaw(received_ns=1_795_000_000_000_000_000 + k * STEP_NS, source="gnss0", data=epoch, recorded=True)
        for _ in process.handle(raw):
            pass
    return sum(map(len, epochs)) / (time.process_time() - begin_s) * 1e-6


def pyubx2_mb_s(epochs: Sequence[bytes]) -> float:
    """Speed of pyubx2 for the frames of these epochs."""
    frames = [frame.data for epoch in epochs for frame in Framer(FRAMINGS).feed(epoch)]
    begin_s = time.process_time()
    for frame in frames:
        UBXReader.parse(frame)
    return sum(map(len, frames)) / (time.process_time() - begin_s) * 1e-6


def main(arguments: Sequence[str]) -> int:
    """Measure, print and store the result; return 1 if a stream is slower than the goal."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.parsing", description=__doc__)
    parser.add_argument("--bytes", type=int, default=600_000, help="length of each stream")
    parser.add_argument("--no-store", action="store_true", help="print only")
    given = parser.parse_args(arguments)
    frames, text, slowest = longest_frames(), TITLE, float("inf")
    for names in STREAMS:
        epochs = epochs_of([frames[name] for name in names], given.bytes)
        ours, theirs = unit_mb_s(epochs), pyubx2_mb_s(epochs[: len(epochs) // 4])
        slowest = min(slowest, ours)
        text += f"| {', '.join(names)} | {len(epochs[0])} | {ours:.1f} | {theirs:.2f} | {ours / theirs:.0f} |\n"
    print(text)
    if not given.no_store:
        tables.publish(RESULTS / "parsing.md", text)
    return 0 if slowest >= GOAL_MB_S else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
