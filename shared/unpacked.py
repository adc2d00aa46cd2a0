"""Unpacks compressed bytes up to a limit: a file of a megabyte may hold a hundred gigabytes of zeros."""

import zlib
from typing import Literal

Form = Literal["gzip", "zlib", "zstd", "lz4"]
MAX_TIMES = 100  # times their size to which bytes of telemetry may unpack; JSON reaches 30
MIN_LIMIT_BYTES = 1 << 26  # that any file may unpack to
ZSTD_WINDOW_BYTES = 1 << 25  # memory of the decompressor
BLOCK = 1 << 16
MAGIC: dict[bytes, str] = {
    b"\x1f\x8b": "gzip", b"PK\x03\x04": "zip", b"\x28\xb5\x2f\xfd": "zstd", b"\x04\x22\x4d\x18": "lz4",
    b"BZh": "bzip2", b"\xfd7zXZ": "xz",
}  # fmt: skip


class BadPack(ValueError):
    """Compressed bytes that are damaged, or that unpack to too much."""


def check_size(packed_bytes: int, unpacked_bytes: int) -> None:
    """Raise `BadPack` for a file that unpacks to far more than its data can mean."""
    if unpacked_bytes > max(MIN_LIMIT_BYTES, MAX_TIMES * packed_bytes):
        raise BadPack(
            f"{packed_bytes} bytes unpack to {unpacked_bytes / 1e6:.0f} MB or more, over {MAX_TIMES} times their "
            "size: no data of a vehicle do"
        )


def compression_of(begin: bytes) -> str | None:
    """Name of the compression of a file that begins with these bytes; None if it is of no known one."""
    return next((name for magic, name in MAGIC.items() if begin.startswith(magic)), None)


def unpacked(data: bytes, form: Form, limit: int, *, whole: bool = True) -> bytes:
    """Unpack at most `limit` bytes.

    Parameters
    ----------
    data : bytes
        Compressed bytes.
    form : {"gzip", "zlib", "zstd", "lz4"}
        Their format; zstd and lz4 are frames.
    limit : int
        [bytes] That may come of them.
    whole : bool
        Whether the bytes must be complete and sound; otherwise what can be unpacked of them is returned.

    Raises
    ------
    BadPack
        Damaged bytes, or more than `limit` bytes would come of them.
    """
    found = bytearray()
    try:
        complete = _UNPACKERS[form](data, limit + 1, found)
    except (zlib.error, EOFError, RuntimeError, OSError, MemoryError) as error:
        if whole:
            raise BadPack(f"its {form} data are damaged ({error})") from error
        complete = False
    if whole and len(found) > limit:
        raise BadPack(f"its {form} data unpack to more than {limit / 1e6:g} MB")
    if whole and not complete:
        raise BadPack(f"its {form} data end too early")
    del found[limit:]
    return bytes(found)


def unpacked_size(data: bytes, form: Literal["gzip", "zlib"], limit: int) -> int:
    """Count what bytes unpack to, up to a limit, in little memory; damaged ones as far as they are sound."""
    unpacker, total = zlib.decompressobj(zlib.MAX_WBITS + (16 if form == "gzip" else 0)), 0
    try:
        while data and not unpacker.eof and total < limit:
            total += len(unpacker.decompress(data, BLOCK))
            data = unpacker.unconsumed_tail
    except zlib.error:
        return total
    return total


def _deflated(data: bytes, limit: int, found: bytearray, bits: int) -> bool:
    """Add what comes of the data to `found`, up to the limit; members of gzip may follow each other."""
    rest = data
    while rest:
        unpacker = zlib.decompressobj(bits)
        while not unpacker.eof and len(found) < limit and rest:
            found += unpacker.decompress(rest, min(BLOCK, limit - len(found)))
            rest = unpacker.unconsumed_tail
        if not unpacker.eof:
            return False
        rest = unpacker.unused_data if bits > zlib.MAX_WBITS else b""
    return True


def _zstd(data: bytes, limit: int, found: bytearray) -> bool:
    import zstandard

    reader = zstandard.ZstdDecompressor(max_window_size=ZSTD_WINDOW_BYTES).stream_reader(data)
    try:
        size = zstandard.frame_content_size(data)
        while len(found) < limit and (block := reader.read(min(BLOCK, limit - len(found)))):
            found += block
    except zstandard.ZstdError as error:
        raise OSError(str(error)) from error
    return size in (-1, len(found))


def _lz4(data: bytes, limit: int, found: bytearray) -> bool:
    from lz4.frame import LZ4FrameDecompressor

    unpacker = LZ4FrameDecompressor()
    found += unpacker.decompress(data, max_length=limit)
    return bool(unpacker.eof)


_UNPACKERS = {
    "gzip": lambda data, limit, item: _deflated(data, limit, item, 16 + zlib.MAX_WBITS),
    "zlib": lambda data, limit, item: _deflated(data, limit, item, zlib.MAX_WBITS),
    "zstd": _zstd,
    "lz4": _lz4,
}
