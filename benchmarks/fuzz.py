"""Feeds damaged bytes to the parsers: none may raise, loop, grow, or count a fault of the program.

`make fuzz` gives each parser 60 s (SECONDS) from a seed (SEED) that is printed. The bytes are those of the recordings
where OBU_DATA holds them, else of the simulated golden drive; some are cut, repeated, exchanged, or replaced. An input
that fails is stored in .obu/fuzz, and `python -m benchmarks.fuzz PARSER --input FILE` repeats it.
"""

import argparse
import importlib
import random
import re
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from math import inf
from operator import xor
from pathlib import Path
from typing import Any

from shared.faults import FAULT
from shared.maths.crc import crc24q, fletcher
from shared.messages.base import Message, RawBytes
from shared.messages.corrections import CorrectionBytes
from shared.messages.gnss import GnssRaw
from shared.messages.imu import ImuRaw
from shared.messages.v2x import CamFrames, Encapsulation
from shared.messages.vehicle import CanRaw
from shared.runtime.config import load_vehicle
from shared.v2x import frames
from shared.v2x.its_time import its_time_ms
from shared.v2x.security.issuing.signing import sign_packet
from shared.v2x.security.issuing.simulated import ticket
from tests.support.data import REPOSITORY, data_folder
from tests.support.gnss.captures import read_pcapng
from tests.support.gnss.frames import rtcm
from tests.support.v2x import cams
from tests.support.v2x.signing import Ticket, signed

NOW_NS = 1_795_000_000_000_000_000
SLOWEST_S = 2.0  # of processor time, for one input of at most MOST_BYTES; the mean is below 0.01 s
MAX_BYTES = 16_384  # of one input: what a driver reads at once
LONG_PSID = 1 << 8 * 1_790 - 2
MAX_PACKET = 1500  # a seed of at most so many bytes is damaged as a whole
MAX_PACKETS = 500  # of each capture
ETHERNET_HEADER = 14  # [bytes]
FRAME = re.compile(
    rb"\xb5\x62..(?P<ubx>..)|\$(?P<nmea>[^$*]{1,120})\*..|\xd3(?P<rtcm>[\x00-\x03].)|\xfa\xff.(?P<xbus>[\x00-\xfe])",
    re.S,
)
REPAIRED = 0.5  # share of the inputs whose checksums are right
VEHICLES = REPOSITORY / "deploy" / "vehicles"
YOUNG_NS = 1_500_000_000
SEED_BYTES = 4_000_000  # of the recordings, of each file
GROWTH_INPUTS = 200  # through one process: its buffers must have found their bounds
MAX_HELD_BYTES = 4_000_000  # in all containers of a parser
STRETCH = (1, 2, 4, 8, 40, 300)  # bytes of one mutation
WORDS = (
    b"\x00", b"\xff", b"\x7f", b"\x80", b"\r\n", b"\n", b"$", b"*", b",", b"-", b"9" * 40, b"nan", b"\xb5\x62",
    b"\xd3\x00", b"\xfa\xff", b"#", b"##", b"#R", b"(", b")", b"\xff" * 4, b"\x00\x00\x00\x80",
)  # fmt: skip


@dataclass(frozen=True)
class Target:
    """One parser: its input message, and where its bytes are."""

    make: Callable[[bytes, int], Message]
    recordings: tuple[str, ...]  # patterns of files below OBU_DATA
    simulated: Callable[[], list[bytes]]  # where there are none
    is_packets: bool = False  # the recordings are captures, of which each packet is a seed
    vehicle: str = "simulated.toml"  # of deploy/vehicles, with the parser's settings

    def seeds(self) -> list[bytes]:
        """Bytes of the recordings, else of the simulator; packets of both, since those of captures are old."""
        root, found = data_folder(), list[bytes]()
        for path in (path for pattern in self.recordings for path in sorted(root.glob(pattern))):
            if self.is_packets:
                found += [frame[ETHERNET_HEADER:] for _, frame in read_pcapng(path)][:MAX_PACKETS]
                continue
            with path.open("rb") as file:
                found.append(file.read(SEED_BYTES))
        return found + self.simulated() if self.is_packets or not found else found


def _stream(kind: type[RawBytes]) -> Callable[[bytes, int], Message]:
    return lambda data, at_ns: kind(received_ns=at_ns, source="fuzz", data=data)


def _packets(data: bytes, at_ns: int) -> Message:
    """A batch of one frame of the radio, while the seeds of our own are young enough to be verified."""
    at_ns = NOW_NS + (at_ns - NOW_NS) % YOUNG_NS
    return CamFrames(
        received_ns=at_ns, source="fuzz", encapsulation=Encapsulation.GEONETWORKING, data=frames.pack([(at_ns, data)])
    )


def _cams() -> list[bytes]:
    """A CAM without a signature, and signed by a ticket that is trusted, with its certificate and with its digest.

    The last one states a service whose number has more digits than Python writes.
    """
    time_ms = its_time_ms(NOW_NS)
    plain = cams.packet(cams.BRAKING, time_ms)
    holder = ticket(b"fuzz", time_ms // 1000)
    own = [sign_packet(plain, holder, time_ms * 1000, with_certificate=whole) for whole in (True, False)]
    return [plain, *own, signed(plain, Ticket(), time_ms, with_certificate=False, header={"psid": LONG_PSID})]


def _golden(name: str) -> Callable[[], list[bytes]]:
    return lambda: [(REPOSITORY / "tests" / "golden" / name).read_bytes()]


TARGETS = {
    "gnss": Target(
        _stream(GnssRaw),
        ("gpsd_receiver_logs/*.log", "pyubx2_logs/*.log", "pyubx2_logs/*.ubx", "gsdc_samples/*GnssLog.txt",
         "gsdc_samples/android_measurements*.txt"),
        _golden("gnss.ubx"),
    ),
    "imu": Target(_stream(ImuRaw), ("xsens_xbus/*/output.bin",), _golden("imu.xbus")),
    "can": Target(
        _stream(CanRaw),
        ("j1939_truck_can/*.log", "can_toyobaru_wheelspeed/*.log", "canedge_obd_gnss/*/candump.log"),
        _golden("can.log"),
    ),
    "corrections": Target(
        _stream(CorrectionBytes), ("gpsd_receiver_logs/*rtcm3.log", "spartn_logs/d9s*", "spartn_logs/*.log"),
        lambda: [b"".join(rtcm(number) for number in (1005, 1077, 1087, 1097, 1230))],
    ),
    "v2x": Target(
        _packets, ("cam_secured/*.pcapng", "etsi_cam_pcap/*.pcapng"), _cams, is_packets=True, vehicle="rsu.toml",
    ),
}  # fmt: skip


def mutated(seeds: Sequence[bytes], chance: random.Random) -> bytes:
    """A piece of a seed, with up to eight places damaged."""
    seed = chance.choice(seeds)
    size = chance.choice((512, 4096)) if len(seed) <= MAX_PACKET else chance.choice((64, 512, 4096))
    start = chance.randrange(max(len(seed) - size, 1))
    data = bytearray(seed[start : start + size])
    for _ in range(chance.randrange(9)):
        place, length = chance.randrange(len(data) + 1), chance.choice(STRETCH)
        match chance.randrange(6):
            case 0:
                del data[place : place + length]
            case 1:
                data[place:place] = chance.choice(WORDS)
            case 2:
                data[place : place + length] = chance.randbytes(length)
            case 3:
                data[place:place] = data[place : place + length] * chance.choice((1, 3, 50))
            case 4 if data:
                data[place % len(data)] ^= 1 << chance.randrange(8)
            case _:
                other = chance.choice(seeds)
                at = chance.randrange(len(other))
                data[place : place + length] = other[at : at + length]
    return bytes(repaired(data[:MAX_BYTES]) if chance.random() < REPAIRED else data[:MAX_BYTES])


def repaired(data: bytearray) -> bytearray:
    """Make the checksums of UBX, NMEA, RTCM 3 and Xbus right, so that damaged content gets behind them."""
    place = 0
    while (match := FRAME.search(data, place)) is not None:
        place = match.start() + 1
        if match["nmea"] is not None:
            data[match.end() - 2 : match.end()] = b"%02X" % reduce(xor, match["nmea"], 0)
            place = match.end()
        elif match["ubx"] is not None:
            end = match.end() + int.from_bytes(match["ubx"], "little")
            place = _closed(data, end, fletcher(bytes(data[match.start() + 2 : end])), place)
        elif match["rtcm"] is not None:
            end = match.end() + int.from_bytes(match["rtcm"], "big")
            place = _closed(data, end, crc24q(bytes(data[match.start() : end])).to_bytes(3, "big"), place)
        else:
            end = match.end() + match["xbus"][0]
            place = _closed(data, end, bytes((-sum(data[match.start() + 1 : end]) & 0xFF,)), place)
    return data


def _closed(data: bytearray, end: int, checksum: bytes, place: int) -> int:
    """Write a checksum, and return the place behind it; `place` where the frame reaches beyond the data."""
    if end + len(checksum) > len(data):
        return place
    data[end : end + len(checksum)] = checksum
    return end + len(checksum)


def parser_of(name: str) -> Any:
    """A new process of a parser, as in a simulated unit; `rejects` and `handle` are all that is used of it."""
    module = importlib.import_module(f"services.parsers.{name}.process")
    file = load_vehicle(VEHICLES / TARGETS[name].vehicle)
    return module.Process(file.section(f"parsers.{name}", module.Config))


def held_bytes(thing: object, seen: set[int] | None = None, depth: int = 12) -> int:
    """Bytes in the strings, bytes and containers of an object of the project, and of those that it holds."""
    seen = set() if seen is None else seen
    if id(thing) in seen or depth == 0 or isinstance(thing, type):
        return 0
    seen.add(id(thing))
    total = sys.getsizeof(thing) if isinstance(thing, str | bytes | bytearray | list | dict | tuple | set) else 0
    if isinstance(thing, dict):
        children: list[object] = [*thing.keys(), *thing.values()]
    elif isinstance(thing, list | tuple | set | frozenset):
        children = list(thing)
    elif type(thing).__module__.startswith(("services.", "shared.", "collections")):
        slots = [getattr(thing, name, None) for kind in type(thing).__mro__ for name in getattr(kind, "__slots__", ())]
        children = [*getattr(thing, "__dict__", {}).values(), *slots]
    else:
        children = []
    return total + sum(held_bytes(child, seen, depth - 1) for child in children)


def failure_of(parser: Any, name: str, data: bytes, at_ns: int, *, slowest_s: float = inf) -> str | None:
    """Give one input to a parser; what it did that it may not, or None."""
    begin_s = time.thread_time()
    faults = parser.rejects[FAULT]
    try:
        for _ in parser.handle(TARGETS[name].make(data, at_ns)):
            pass
    except Exception as error:  # noqa: BLE001  # whatever it raises is what is looked for
        return f"{type(error).__name__}: {error}"
    if parser.rejects[FAULT] > faults:
        last = [fault.last for fault in vars(parser).values() if hasattr(fault, "last")]
        return f"a fault of the program: {last}"
    taken_s = time.thread_time() - begin_s
    return f"{taken_s:.1f} s for {len(data)} bytes" if taken_s > slowest_s else None


def fuzz(
    name: str, seed: int, seconds: float, folder: Path, least: int = 0, *, slowest_s: float = inf
) -> tuple[int, list[str]]:
    """Feed one parser for some seconds and `least` inputs; return their number, and what failed, with its files.

    An input fails as well if its parser takes more than `slowest_s` of processor time.
    """
    chance, seeds = random.Random(f"{name} {seed}"), TARGETS[name].seeds()
    parser, inputs, failures = parser_of(name), 0, []
    until = time.monotonic() + seconds
    while inputs < least or time.monotonic() < until:
        data = mutated(seeds, chance)
        at_ns = NOW_NS + inputs * 100_000_000
        if (failure := failure_of(parser, name, data, at_ns, slowest_s=slowest_s)) is not None:
            folder.mkdir(parents=True, exist_ok=True)
            path = folder / f"{name}-{seed}-{inputs}.bin"
            path.write_bytes(data)
            failures.append(f"{name}: {failure}; input: {path}")
            parser = parser_of(name)
        inputs += 1
        if inputs % GROWTH_INPUTS == 0:
            if (held := held_bytes(parser)) > MAX_HELD_BYTES:
                failures.append(f"{name}: holds {held} bytes after {inputs} inputs of seed {seed}")
            parser = parser_of(name)
    return inputs, failures


def main() -> None:
    """Read the command line, and exit with 1 where a parser has failed."""
    reader = argparse.ArgumentParser(description=__doc__)
    reader.add_argument("parser", nargs="*", help=f"parsers to feed: {', '.join(TARGETS)}; all where none is named")
    reader.add_argument("--seed", type=int, default=1)
    reader.add_argument("--seconds", type=float, default=60.0, help="time for each parser")
    reader.add_argument("--input", type=Path, help="file of one input, to repeat it")
    options = reader.parse_args()
    if unknown := set(options.parser) - TARGETS.keys():
        reader.error(f"there is no parser {', '.join(unknown)}: choose of {', '.join(TARGETS)}")
    names = options.parser or list(TARGETS)
    failed = False
    for name in names:
        if options.input is not None:
            failure = failure_of(parser_of(name), name, options.input.read_bytes(), NOW_NS, slowest_s=SLOWEST_S)
            print(f"{name}: {failure or 'no failure'}")
            failed = failed or failure is not None
            continue
        folder = REPOSITORY / ".obu" / "fuzz"
        inputs, found = fuzz(name, options.seed, options.seconds, folder, slowest_s=SLOWEST_S)
        print(
            f"{name}: seed {options.seed}, {inputs} inputs in {options.seconds:g} s, {len(found)} failures", flush=True
        )
        for item in found:
            print(f"  {item}")
        failed = failed or bool(found)
    sys.exit(failed)


if __name__ == "__main__":
    main()
