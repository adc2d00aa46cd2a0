"""All aids: which measurements a message holds. A new aid is one folder, and one row here.

The module `aid` of an aid has a mapping `KINDS`: of a class of message, the functions that make measurements of it. So
has that of a package that is installed beside the unit, an entry point of the group `obu.aids`; what it observes is of
`AidingKind.EXTERNAL`. States are named by other modules (`states.py`), which are read before any of this.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from itertools import chain
from typing import Any, cast

from shared import packages
from shared.messages.base import Message

from ..settings import Settings
from .barometer import aid as barometer
from .base import Measurement
from .carrier import aid as carrier
from .dual_antenna import aid as dual_antenna
from .gnss import aid as gnss
from .magnetometer import aid as magnetometer
from .odometer import aid as odometer

AIDS = gnss, odometer, barometer, magnetometer, dual_antenna, carrier
Converter = Callable[[Any, Settings], Iterable[Measurement]]


@cache
def converters() -> Mapping[type[Message], tuple[Converter, ...]]:
    """Functions of all aids by the class of message, those of installed packages last; read once a process."""
    found: dict[type[Message], tuple[Converter, ...]] = defaultdict(tuple)
    for module in (*AIDS, *packages.brought(packages.AIDS)):
        for message, functions in cast(Any, module).KINDS.items():
            found[message] += functions
    return dict(found)


def measurements_of(message: Message, settings: Settings) -> list[Measurement]:
    """Measurements that a message holds; none of a message that is no aid."""
    functions = converters().get(type(message), ())
    return list(chain.from_iterable(convert(message, settings) for convert in functions))
