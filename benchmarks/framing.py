"""How fast bytes are framed that hold no frame: what noise, or somebody who wants to stop a parser, sends.

`python -m benchmarks.framing` measures processor time of this process alone, without a broker.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks import tables
from services.parsers.gnss.protocols import FRAMINGS
from shared.protocols.framing.finder import FrameFinder
from shared.protocols.framing.framer import Frame, Framer
from shared.protocols.xbus import XbusMessage, XbusReader

RESULTS = Path(__file__).parent / "results"
GOAL_MB_S = 1.0


def receiver() -> FrameFinder[Frame]:
    """Frames of all protocols of GNSS receivers."""
    return Framer(FRAMINGS)


PATTERNS: tuple[tuple[Callable[[], FrameFinder[Frame] | FrameFinder[XbusMessage]], bytes], ...] = (
    (receiver, bytes.fromhex("d303ff")),  # a header of RTCM every three bytes, each of 1029 bytes
    (receiver, bytes.fromhex("d303ffff")),  # the same with a message number that is possible
    (receiver, bytes.fromhex("b5620107f00f")),  # a header of UBX every six bytes, each of 4088 bytes
    (receiver, bytes.fromhex("b56201")),
    (receiver, bytes.fromhex("b562")),
    (receiver, b"$GPGSA,*00\n"),
    (receiver, b"$"),
    (receiver, bytes(16)),
    (XbusReader, bytes.fromhex("faff36ff07ff")),
    (XbusReader, bytes.fromhex("faff36f0")),
    (XbusReader, bytes.fromhex("faff")),
)
TITLE = """# Framing of bytes that hold no frame

By `python -m benchmarks.framing`: MB/s of processor time; bytes in parts of 64, of 1000, and all at once.

| bytes, repeated | reader | 64 | 1000 | at once |
| --- | --- | --- | --- | --- |
"""


def speed_mb_s(reader: FrameFinder[Frame] | FrameFinder[XbusMessage], data: bytes, part: int) -> float:
    """MB/s of processor time."""
    begin_s = time.process_time()
    for start in range(0, len(data), part):
        reader.feed(data[start : start + part])
    return len(data) / (time.process_time() - begin_s) * 1e-6


def main(arguments: Sequence[str]) -> int:
    """Measure, print and store the result; return 1 if a pattern is slower than the goal."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.framing", description=__doc__)
    parser.add_argument("--bytes", type=int, default=1_000_000, help="length of each stream")
    parser.add_argument("--no-store", action="store_true", help="print only")
    given = parser.parse_args(arguments)
    text, slowest = TITLE, float("inf")
    for make, pattern in PATTERNS:
        data = pattern * (given.bytes // len(pattern))
        speeds = [speed_mb_s(make(), data, part) for part in (64, 1000, len(data))]
        slowest = min(slowest, *speeds)
        cells = " | ".join(f"{speed:.1f}" for speed in speeds)
        text += f"| `{pattern.hex(' ')}` | {make().__class__.__name__} | {cells} |\n"
    print(text)
    if not given.no_store:
        tables.publish(RESULTS / "framing.md", text)
    return 0 if slowest >= GOAL_MB_S else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
