"""Compressed bytes of every format: whole, cut, damaged, and those that unpack to far more than data can be."""

import gzip
import subprocess
import sys
import zlib
from collections.abc import Callable
from typing import get_args

import lz4.frame
import pytest
import zstandard

from shared.unpacked import BadPack, Form, check_size, compression_of, unpacked, unpacked_size
from tests.support.patience import HANGS_S

PACK: dict[Form, Callable[[bytes], bytes]] = {
    "gzip": gzip.compress, "zlib": zlib.compress, "zstd": zstandard.compress, "lz4": lz4.frame.compress,
}  # fmt: skip
DATA = bytes(range(256)) * 400
FORMS: tuple[Form, ...] = get_args(Form)


@pytest.mark.parametrize("form", FORMS)
def test_data_up_to_the_limit_come_back(form: Form) -> None:
    assert unpacked(PACK[form](DATA), form, len(DATA)) == DATA
    assert unpacked(PACK[form](b""), form, 10) == b""
    with pytest.raises(BadPack, match=r"unpack to more than 0\.1023"):
        unpacked(PACK[form](DATA), form, len(DATA) - 1)


@pytest.mark.parametrize("form", FORMS)
def test_cut_and_damaged_data_are_an_error_or_what_is_sound(form: Form) -> None:
    packed = PACK[form](DATA)
    with pytest.raises(BadPack, match=r"damaged|end too early"):
        unpacked(packed[: len(packed) // 2], form, len(DATA))
    with pytest.raises(BadPack, match="damaged"):
        unpacked(b"\xff" * 100, form, len(DATA))
    part = unpacked(packed[:-2], form, len(DATA), whole=False)
    assert DATA.startswith(part)


def test_members_of_gzip_follow_each_other_and_a_stream_of_zstd_may_not_state_its_size() -> None:
    assert unpacked(gzip.compress(b"a") + gzip.compress(b"b"), "gzip", 10) == b"ab"
    stream = zstandard.ZstdCompressor().compressobj()
    packed = stream.compress(DATA) + stream.flush()
    assert unpacked(packed, "zstd", len(DATA)) == DATA


@pytest.mark.parametrize("form", FORMS)
def test_a_gigabyte_of_zeros_takes_little_memory(form: Form) -> None:
    """In a process of its own, whose memory is limited to 200 MB beyond what it has."""
    code = f"""
import resource, sys
sys.path.insert(0, {str(sys.path[0])!r})
from shared.unpacked import BadPack, unpacked
import zlib, zstandard, lz4.frame
size = 64 << 20
if {form!r} == "zstd":
    stream = zstandard.ZstdCompressor().compressobj()
elif {form!r} == "lz4":
    class Lz4:
        def __init__(self): self.one = lz4.frame.LZ4FrameCompressor(); self.head = self.one.begin()
        def compress(self, data): head, self.head = self.head, b""; return head + self.one.compress(data)
        def flush(self): return self.one.flush()
    stream = Lz4()
else:
    stream = zlib.compressobj(9, zlib.DEFLATED, 31 if {form!r} == "gzip" else 15)
block = bytes(1 << 20)
packed = b"".join(stream.compress(block) for _ in range(256)) + stream.flush()
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    unpacked(packed, {form!r}, 8 << 20)
except BadPack as error:
    print(error, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=HANGS_S
    ).stdout
    assert "unpack to more than" in said
    assert int(said.split()[-1]) < 60_000, "[kB] beyond the limit of 8 MB and its copies"


def test_a_size_beyond_what_data_can_be_is_an_error() -> None:
    check_size(1000, 60_000_000)
    check_size(10_000_000, 900_000_000)
    with pytest.raises(BadPack, match="1000 bytes unpack to 70 MB or more, over 100 times"):
        check_size(1000, 70_000_000)
    assert unpacked_size(zlib.compress(bytes(5_000_000)), "zlib", 1_000_000) < 1_100_000


def test_the_compression_of_a_file_is_known_by_its_first_bytes() -> None:
    assert [compression_of(PACK[form](DATA)) for form in ("gzip", "zstd", "lz4")] == ["gzip", "zstd", "lz4"]
    assert compression_of(b"t;lat;lon") is None
