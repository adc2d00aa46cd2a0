"""Packet captures: reads Ethernet frames of a pcapng file, and dissects frames with tshark in a process of its own."""

import json
import shutil
import struct
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.support.patience import HANGS_S

ETHERTYPE_GEONETWORKING = bytes.fromhex("8947")
ENHANCED_PACKET_BLOCK, INTERFACE_DESCRIPTION_BLOCK = 6, 1
NANOSECONDS = 9
RAW = 5  # values of a field's bytes: they, offset, length, mask, type


def read_pcapng(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield (UTC in ns, frame) of a little-endian pcapng file with one interface."""
    data, position, exponent = path.read_bytes(), 0, 6
    while position < len(data):
        kind, length = struct.unpack_from("<II", data, position)
        body = data[position + 8 : position + length - 4]
        if kind == INTERFACE_DESCRIPTION_BLOCK:
            exponent = _resolution(body[8:])
        elif kind == ENHANCED_PACKET_BLOCK:
            _, high, low, size, _ = struct.unpack_from("<IIIII", body)
            yield (high << 32 | low) * 10 ** (9 - exponent), body[20 : 20 + size]
        position += length


def _resolution(options: bytes) -> int:
    position = 0
    while position + 4 <= len(options):
        code, size = struct.unpack_from("<HH", options, position)
        if code == NANOSECONDS:  # the number of the option if_tsresol happens to be 9 as well
            return options[position + 4]
        position += 4 + (size + 3) // 4 * 4
    return 6


def packets(path: Path) -> list[tuple[int, bytes]]:
    """List the GeoNetworking packets of a capture, from the basic header on, with their UTC in ns."""
    return [(utc_ns, frame[14:]) for utc_ns, frame in read_pcapng(path) if frame[12:14] == ETHERTYPE_GEONETWORKING]


class Dissection:
    """The fields of one frame dissected by tshark: values by the name of the field, at any depth."""

    def __init__(self, layers: object) -> None:
        self._layers = layers

    def all(self, field: str) -> list[str]:
        """List the values of a field in order."""
        return list(_find(self._layers, field))

    def number(self, field: str) -> int:
        """Read the only value of a field."""
        (value,) = self.all(field)
        return int(value, 0)

    def cut(self, field: str) -> list[bytes]:
        """List the bytes of a field by their offset in the frame, of a dissection with bytes."""
        values: list[Any] = list(_find(self._layers, f"{field}_raw"))
        flat = [part for value in values for part in (value if isinstance(value, list) else [value])]
        found = zip(flat[1::RAW], flat[::RAW], strict=True)  # offset, and bytes in hexadecimal
        return [bytes.fromhex(data) for _, data in sorted(found)]

    @property
    def malformed(self) -> bool:
        """Whether tshark could not dissect all of it."""
        return bool(list(_find(self._layers, "_ws.malformed")))


def _find(node: object, field: str) -> Iterator[str]:
    if isinstance(node, dict):
        for name, value in node.items():
            if name == field:
                yield from value if isinstance(value, list) else [value]
            else:
                yield from _find(value, field)
    elif isinstance(node, list):
        for part in node:
            yield from _find(part, field)


def dissect(frames: Sequence[bytes], folder: Path, *, with_bytes: bool = False) -> list[Dissection]:
    """Dissect GeoNetworking packets as Ethernet frames with tshark; skips the test where it is not installed."""
    path = folder / "frames.pcap"
    with path.open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1))  # microseconds, Ethernet
        for number, packet in enumerate(frames):
            frame = b"\xff" * 6 + b"\x02" + bytes(5) + ETHERTYPE_GEONETWORKING + packet
            file.write(struct.pack("<IIII", number, 0, len(frame), len(frame)) + frame)
    return dissect_file(path, with_bytes=with_bytes)


def dissect_file(path: Path, *, with_bytes: bool = False) -> list[Dissection]:
    """Dissect the frames of a capture with tshark; skips the test where it is not installed."""
    executable = shutil.which("tshark")
    if executable is None:
        pytest.skip("tshark is not installed: apt-get install tshark, or deploy/install_test_programs.sh")
    command = [executable, "-n", "-r", str(path), "-T", "json", "--no-duplicate-keys", *(["-x"] if with_bytes else [])]
    result = subprocess.run(command, capture_output=True, text=True, timeout=HANGS_S, check=True)
    shown: list[dict[str, Any]] = json.loads(result.stdout)
    return [Dissection(frame["_source"]["layers"]) for frame in shown]
