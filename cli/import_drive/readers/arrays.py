"""Reads files of arrays: NumPy (.npz) and MATLAB (.mat)."""

import struct
import zlib
from io import BytesIO
from typing import Any, cast
from zipfile import BadZipFile, ZipFile

import numpy as np
import numpy.typing as npt

from shared.errors import UserError
from shared.unpacked import MAX_TIMES, MIN_LIMIT_BYTES, BadPack, check_size, unpacked_size

Arrays = dict[str, npt.NDArray[np.generic]]
FORMATS = (".npz", ".mat")
HDF5 = b"\x89HDF\r\n\x1a\n"
MATLAB_HEADER, MATLAB_PACKED = 128, 15  # [bytes], and the type of an element that is packed with zlib
FEW_COLUMNS = 16  # a matrix with at most as many rows, and more columns, is transposed: time runs along the rows


def arrays_of(data: bytes, name: str) -> Arrays:
    """Read the arrays of a file by the end of its name."""
    try:
        check_size(len(data), (_matlab_bytes if name.endswith(".mat") else _numpy_bytes)(data))
    except BadPack as error:
        raise UserError(f"{name} cannot be read: {error}") from error
    return _matlab(data, name) if name.endswith(".mat") else _numpy(data, name)


def _numpy_bytes(data: bytes) -> int:
    """What the members of an archive say that they unpack to; no more than that is read of them."""
    try:
        with ZipFile(BytesIO(data)) as archive:
            return sum(member.file_size for member in archive.infolist())
    except (OSError, ValueError, EOFError, BadZipFile):
        return 0  # no archive, which is said where its arrays are read


def _matlab_bytes(data: bytes) -> int:
    """Bytes that the packed elements of a file of version 7 unpack to, as far as `check_size` allows."""
    tag = struct.Struct(">II" if data[126:128] == b"MI" else "<II")
    allowed = max(MIN_LIMIT_BYTES, MAX_TIMES * len(data))
    total, place = 0, MATLAB_HEADER
    while place + tag.size <= len(data) and total <= allowed:
        kind, size = tag.unpack_from(data, place)
        place += tag.size
        if kind == MATLAB_PACKED:
            total += unpacked_size(data[place : place + size], "zlib", allowed + 1 - total)
        place += size
    return total


def _numpy(data: bytes, name: str) -> Arrays:
    try:
        with np.lib.npyio.NpzFile(BytesIO(data), allow_pickle=False) as archive:
            return {key: archive[key] for key in archive.files}
    except (OSError, ValueError, EOFError, MemoryError, BadZipFile, zlib.error) as error:
        raise UserError(f"{name} is not an archive of NumPy arrays ({error}); write it with numpy.savez") from error


def _matlab(data: bytes, name: str) -> Arrays:
    """Arrays of a MATLAB file of versions 4 to 7; those of structures as `structure.field`."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    if data[:8] == HDF5 or data[512:520] == HDF5 or data.startswith(b"MATLAB 7.3"):
        raise UserError(
            f"{name} is a MATLAB file of version 7.3 (HDF5), which is not read; save it again in MATLAB: "
            f"load('{name}'); save('{name}', '-v7')"
        )
    try:
        variables = loadmat(cast(Any, BytesIO(data)), squeeze_me=True, simplify_cells=True)
    except (MatReadError, NotImplementedError, ValueError, TypeError, KeyError, IndexError, OSError, EOFError,
            OverflowError, MemoryError, struct.error, zlib.error) as error:  # fmt: skip
        raise UserError(f"{name} is not a MATLAB file ({error}); save it with save('{name}', '-v7')") from error
    return dict(_flat("", {key: value for key, value in variables.items() if not key.startswith("__")}))


def _flat(prefix: str, variables: dict[str, object]) -> list[tuple[str, npt.NDArray[np.generic]]]:
    found: list[tuple[str, npt.NDArray[np.generic]]] = []
    for key, value in variables.items():
        if isinstance(value, dict):
            found += _flat(f"{prefix}{key}.", value)
        elif isinstance(value, np.ndarray):
            lying = value.ndim == 2 and value.shape[0] <= FEW_COLUMNS < value.shape[1]
            found.append((f"{prefix}{key}", value.T if lying else value))
    return found
