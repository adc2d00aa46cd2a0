"""Numba in commands and tests: the same functions, compiled; without Numba the decorators do nothing.

`compiled` makes machine code of a function and keeps it between runs; `compilable` lets that code call a function that
stays one of Python; an `inlined` one is compiled as a part of its callers, for what has one caller and takes long to
compile. NUMBA_DISABLE_JIT=1, Numba's own switch, leaves Numba out: processes of a vehicle have it set.
"""

import math
import os
import shutil
import tempfile
from collections.abc import Callable
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

from ..packages import AID_STATES, offered

SOURCES = "shared", "services/core"  # folders of all code that is compiled, and of what it calls
MAX_VERSIONS = 32  # versions of the code whose machine code is kept: 1.5 MB each; several trees have one each
Function = TypeVar("Function", bound=Callable[..., Any])


def _unchanged(function: Function) -> Function:
    return function


def machine_code() -> Path:
    """Folder for the machine code of this version of the sources.

    Numba looks at the file of a function alone: code that calls one of another file, or takes a type of it, would stay
    as it was when that file changes. Packages with states of their own make another version of the same sources.
    """
    root = Path(__file__).resolve().parents[2]
    files = sorted(path for folder in SOURCES for path in (root / folder).rglob("*.py"))
    stamps = ((str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in files)
    version = sha256(repr([*stamps, *offered(AID_STATES)]).encode()).hexdigest()[:16]
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "obu" / "numba"
    try:
        (cache / version).mkdir(parents=True, exist_ok=True)
        os.utime(cache / version)  # in use: others are dropped before it
        for old in sorted(cache.iterdir(), key=lambda path: path.stat().st_mtime_ns)[:-MAX_VERSIONS]:
            shutil.rmtree(old, ignore_errors=True)
    except OSError:  # no home, or none that can be written to: for this run alone
        return Path(tempfile.mkdtemp(prefix="obu-numba-"))
    return cache / version


compiled: Callable[[Function], Function] = _unchanged
compilable: Callable[[Function], Function] = _unchanged
inlined: Callable[[Function], Function] = _unchanged
COMPILED = False
if os.environ.get("NUMBA_DISABLE_JIT", "0") == "0":
    try:
        numba: Any = import_module("numba")
    except ImportError:
        pass
    else:
        COMPILED = True
        numba.config.CACHE_DIR = numba.config.CACHE_DIR or str(machine_code())
        compiled = numba.njit(cache=True)
        extending: Any = import_module("numba.extending")
        np: Any = import_module("numpy")
        compilable = extending.register_jitable
        inlined = extending.register_jitable(inline="always")

        @extending.overload_attribute(numba.types.Array, "mT", inline="always")  # type: ignore[untyped-decorator]
        def _matrix_transpose(matrix: Any) -> Callable[[Any], Any]:  # named as that of the function in it
            def transposed(matrix: Any) -> Any:  # of a matrix; Numba lacks .mT
                return matrix.T

            return transposed

        @extending.overload(math.remainder)  # type: ignore[untyped-decorator]
        def _remainder(x: Any, y: Any) -> Callable[[Any, Any], Any]:
            def remainder(x: Any, y: Any) -> Any:  # Numba lacks it; exact within three halves of y
                return x - np.rint(x / y) * y

            return remainder
