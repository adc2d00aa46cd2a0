"""Extracts UBX, NMEA and RTCM 3 messages from a byte stream that may hold invalid bytes."""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum, auto
from functools import reduce
from itertools import accumulate
from operator import xor

UBX_SYNC = b"\xb5\x62"
MAX_UBX_PAYLOAD = 4096  # RXM-RAWX of 120 signals is 3856
MAX_NMEA = 256  # the standard allows 82; proprietary sentences are longer


class Protocol(Enum):
    """Protocol of a frame."""

    UBX = auto()
    NMEA = auto()
    RTCM = auto()


@dataclass(frozen=True, slots=True)
class Frame:
    """One complete message with a valid checksum, framing included."""

    protocol: Protocol
    data: bytes


class _Incomplete(Exception):
    """The rest of the frame has not arrived yet."""


class _Bad(Exception):
    """No valid frame at this position; the text is the kind of reject, empty for a mere sync byte."""


class Framer:
    """Splits a stream into frames; bytes between frames are counted and dropped.

    `rejects` counts `garbage_bytes` and, for invalid frames, `ubx_checksum`, `ubx_length`, `nmea_checksum`,
    `nmea_form`, `rtcm_checksum` and `cut_frame`. After an invalid frame the search continues at its second byte,
    and a complete frame inside an incomplete one takes precedence: a corrupted length field neither suppresses nor
    delays the following messages. The stream readers of pyubx2 and pynmea2 are not used: they block, do not accept
    chunks, and raise on invalid bytes or accept a corrupted length.
    """

    def __init__(self, rejects: Counter[str] | None = None) -> None:
        self.rejects: Counter[str] = Counter() if rejects is None else rejects
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Frame]:
        """Process the next bytes; return the completed frames."""
        frames: list[Frame] = []
        for start in range(0, len(data), MAX_UBX_PAYLOAD):
            self._buffer += data[start : start + MAX_UBX_PAYLOAD]
            frames.extend(self._frames())
        return frames

    def _frames(self) -> Iterator[Frame]:
        buffer, position = self._buffer, 0
        while True:
            start = _next_start(buffer, position)
            self._pass_over(start - position)
            position = start
            if start == len(buffer):
                break
            try:
                frame = _frame_at(buffer, position)
            except _Bad as fault:
                if kind := str(fault):
                    self.rejects[kind] += 1
                self._pass_over(1)
                position += 1
                continue
            except _Incomplete:
                inner = _whole_frame_after(buffer, position + 1)
                if inner is None:
                    break
                self.rejects["cut_frame"] += 1
                self._pass_over(inner - position)
                position = inner
                continue
            yield frame
            position += len(frame.data)
        del buffer[:position]

    def _pass_over(self, n: int) -> None:
        if n:
            self.rejects["garbage_bytes"] += n


def _next_start(buffer: bytearray, position: int) -> int:
    """Index of the first byte at which a frame may begin."""
    candidates = (buffer.find(sync, position) for sync in (b"\xb5", b"$", b"\xd3"))
    return min((c for c in candidates if c >= 0), default=len(buffer))


def _frame_at(buffer: bytearray, start: int) -> Frame:
    first = buffer[start]
    if first == UBX_SYNC[0]:
        return _ubx(buffer, start)
    if first == ord("$"):
        return _nmea(buffer, start)
    return _rtcm(buffer, start)


def _whole_frame_after(buffer: bytearray, position: int) -> int | None:
    """Index of the first complete UBX or NMEA frame inside an incomplete one."""
    starts = (_first_whole(buffer, position, sync, read) for sync, read in ((UBX_SYNC, _ubx), (b"$G", _nmea)))
    return min((start for start in starts if start is not None), default=None)


def _first_whole(buffer: bytearray, position: int, sync: bytes, read: Callable[[bytearray, int], Frame]) -> int | None:
    while (position := buffer.find(sync, position)) >= 0:
        try:
            read(buffer, position)
        except (_Bad, _Incomplete):
            position += 1
        else:
            return position
    return None


def _ubx(buffer: bytearray, start: int) -> Frame:
    if len(buffer) < start + 2:
        raise _Incomplete
    if buffer[start + 1] != UBX_SYNC[1]:
        raise _Bad
    if len(buffer) < start + 6:
        raise _Incomplete
    size = int.from_bytes(buffer[start + 4 : start + 6], "little")
    if size > MAX_UBX_PAYLOAD:
        raise _Bad("ubx_length")
    end = start + 8 + size
    if len(buffer) < end:
        raise _Incomplete
    if ubx_checksum(bytes(buffer[start + 2 : end - 2])) != buffer[end - 2 : end]:
        raise _Bad("ubx_checksum")
    return Frame(Protocol.UBX, bytes(buffer[start:end]))


def _nmea(buffer: bytearray, start: int) -> Frame:
    end = buffer.find(b"\n", start, start + MAX_NMEA)
    sentence = bytes(buffer[start + 1 : len(buffer) if end < 0 else end])[:MAX_NMEA]
    if not sentence.rstrip(b"\r").isascii() or b"$" in sentence or any(c < 32 for c in sentence.rstrip(b"\r")):
        raise _Bad("nmea_form")
    if end < 0:
        if len(buffer) - start >= MAX_NMEA:
            raise _Bad("nmea_form")
        raise _Incomplete
    body, star, digits = sentence.rstrip(b"\r").rpartition(b"*")
    digits, _, arrival_ms = digits.partition(b",")  # Android's logs append the time of arrival
    if arrival_ms and not arrival_ms.strip().isdigit():
        raise _Bad("nmea_form")
    if not star or len(digits) != 2:
        raise _Bad("nmea_form")
    try:
        expected = int(digits, 16)
    except ValueError as error:
        raise _Bad("nmea_form") from error
    if reduce(xor, body, 0) != expected:
        raise _Bad("nmea_checksum")
    return Frame(Protocol.NMEA, bytes(buffer[start : end + 1]))


def _rtcm(buffer: bytearray, start: int) -> Frame:
    if len(buffer) < start + 3:
        raise _Incomplete
    if buffer[start + 1] & 0xFC:  # six reserved bits
        raise _Bad
    end = start + 6 + int.from_bytes(buffer[start + 1 : start + 3])
    if len(buffer) < end:
        raise _Incomplete
    if crc24q(bytes(buffer[start:end])):
        raise _Bad("rtcm_checksum")
    return Frame(Protocol.RTCM, bytes(buffer[start:end]))


def ubx_checksum(data: bytes) -> bytes:
    """8-bit Fletcher checksum (RFC 1145): the sums of the bytes and of their running sums, modulo 256."""
    running = list(accumulate(data))
    return bytes(((running[-1] if running else 0) & 0xFF, sum(running) & 0xFF))


def crc24q(data: bytes) -> int:
    """CRC-24Q of RTCM 3 (polynomial 0x1864CFB); 0 over a complete frame."""
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFFFFFF) ^ _CRC_TABLE[crc >> 16 ^ byte]
    return crc


def _crc_entry(value: int) -> int:
    crc = value << 16
    for _ in range(8):
        crc = crc << 1 ^ (0x1864CFB if crc & 0x800000 else 0)
    return crc


_CRC_TABLE = tuple(_crc_entry(value) for value in range(256))
