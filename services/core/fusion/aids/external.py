"""Aids of packages that are installed beside the unit.

An entry point of the group `obu.aids` is a module with a mapping `KINDS`, as in `kinds.py`: of a class of message, the
functions that make measurements of it. Their classes are a `Kind` of `base.py`, and what they observe is of
`AidingKind.EXTERNAL`. States of their own are entry points of another group (`states.py`), which are read before any of
this, and found by name: `LAYOUT.place(name)`.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any, cast

from shared.messages.base import Message
from shared.messages.navigation import AidingKind
from shared.packages import AIDS, brought

from ..settings import Settings
from .base import Measurement

KIND = AidingKind.EXTERNAL
Converter = Callable[[Any, Settings], Iterable[Measurement]]


@cache
def external_kinds() -> Mapping[type[Message], tuple[Converter, ...]]:
    """Functions of all installed packages, by the class of message; read once a process."""
    found: dict[type[Message], tuple[Converter, ...]] = defaultdict(tuple)
    for module in brought(AIDS):
        for message, converters in cast(Any, module).KINDS.items():
            found[message] += tuple(converters)
    return dict(found)
