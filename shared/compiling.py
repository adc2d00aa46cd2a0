"""Compiles plain functions where Numba is installed, and keeps the machine code between runs.

Numba keeps machine code by the file of one function, and does not see a change in another one that is called by it. So
the folder of the cache is named after the contents of all files.
"""

import hashlib
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(
    function: Function, parts: Iterable[Callable[..., Any]], loops: Mapping[Callable[..., Any], Callable[..., Any]]
) -> Function | None:
    """Compile a function and what it calls; None where Numba is not installed.

    Parameters
    ----------
    function : callable
        Of numbers, tuples and arrays.
    parts : iterable of callable
        All that it calls, directly or not, and that is written in the same way.
    loops : mapping of callable to callable
        What else it calls, and what to compile instead.
    """
    try:
        import numba
        from numba.extending import overload, register_jitable
    except ImportError:
        return None
    parts = list(parts)
    for part in parts:
        register_jitable(part)
    for original, instead in loops.items():
        overload(original, strict=False)(lambda *_, instead=instead: instead)
    folder = _cache_folder(function, *parts, *loops, *loops.values())
    if folder is not None:
        vars(numba.config)["CACHE_DIR"] = str(folder)
    machine_code: Function = numba.njit(function, cache=folder is not None)
    return machine_code


def _cache_folder(*functions: Callable[..., Any]) -> Path | None:
    """Folder that can be written, for these versions of the sources; None where there is none."""
    digest = hashlib.sha256()
    for path in sorted({function.__code__.co_filename for function in functions}):
        digest.update(Path(path).read_bytes())
    base = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(base) / "obu" / digest.hexdigest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None
