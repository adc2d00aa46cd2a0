"""Archives that unpack to far more than a drive can be end with a sentence, and before they are unpacked."""

import struct
import time
import zipfile
import zlib
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from cli.import_drive.readers.arrays import arrays_of
from shared.errors import UserError

MATLAB_5 = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"


def zeros_packed_with_zlib(megabytes: int) -> bytes:
    packer = zlib.compressobj(9)
    return b"".join(packer.compress(bytes(1 << 20)) for _ in range(megabytes)) + packer.flush()


def matlab_bomb() -> bytes:
    packed = zeros_packed_with_zlib(300)
    return MATLAB_5 + struct.pack("<II", 15, len(packed)) + packed


def numpy_bomb() -> bytes:
    head = BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (300 << 17,)})
    file = BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("t.npy", "w") as member:
        member.write(head.getvalue())
        for _ in range(300):
            member.write(bytes(1 << 20))
    return file.getvalue()


@pytest.mark.parametrize(("name", "made"), [("a.npz", numpy_bomb), ("a.mat", matlab_bomb)])
def test_a_bomb_is_an_error_before_it_is_unpacked(name: str, made: object) -> None:
    data = made()  # type: ignore[operator]
    started_s = time.thread_time()
    with pytest.raises(UserError, match=rf"{name} cannot be read: {len(data)} bytes unpack to \d+ MB or more"):
        arrays_of(data, name)
    assert time.thread_time() - started_s < 3.0, "[s] of the processor: unpacking would take longer"


def test_an_array_that_claims_to_be_larger_than_its_file_is_an_error() -> None:
    head = BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (1 << 50,)})
    file = BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("t.npy", head.getvalue())
    with pytest.raises(UserError, match="is not an archive of NumPy arrays"):
        arrays_of(file.getvalue(), "a.npz")


def test_packed_arrays_of_a_drive_are_read(tmp_path: Path) -> None:
    values = np.round(np.random.default_rng(1).normal(0.0, 1.0, (5000, 3)), 3)
    np.savez_compressed(tmp_path / "a.npz", a=values)
    savemat(tmp_path / "a.mat", {"a": values}, do_compression=True)
    for name in ("a.npz", "a.mat"):
        assert np.array_equal(arrays_of((tmp_path / name).read_bytes(), name)["a"], values)
