"""Numba in commands and tests: the same functions, compiled; without Numba both decorators do nothing.

`compiled` makes machine code of a function and keeps it between runs; `compilable` lets that code call a function that
stays one of Python. NUMBA_DISABLE_JIT=1, Numba's own switch, leaves Numba out: processes of a vehicle have it set.
"""

import os
from collections.abc import Callable
from importlib import import_module
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])


def _unchanged(function: Function) -> Function:
    return function


compiled: Callable[[Function], Function] = _unchanged
compilable: Callable[[Function], Function] = _unchanged
COMPILED = False
if os.environ.get("NUMBA_DISABLE_JIT", "0") == "0":
    try:
        numba: Any = import_module("numba")
    except ImportError:
        pass
    else:
        COMPILED = True
        compiled = numba.njit(cache=True)
        compilable = import_module("numba.extending").register_jitable
