"""Sets of hardware from which a set-up begins: files of deploy/vehicles/sets."""

from collections.abc import Collection

from shared.page.answers import Object
from shared.processes import BY_NAME, Kind, Role, switchable
from shared.settings.sets import hardware_sets

OF_DEVICES = (Kind.DEVICE_DRIVER, Kind.SIMULATOR)


def sets(known: Collection[str] = ()) -> list[Object]:
    """Name, what it is made of, every setting as JSON (see `HardwareSet`), and which processes run.

    A set decides on those that it has a section of, and on each other one that reads or simulates devices of a set.
    """
    devices = {name for one in hardware_sets() for name in one.runs if BY_NAME[name].kind in OF_DEVICES}
    return [
        {
            "name": one.name,
            "what": one.what,
            "settings": dict(one.settings(known)),
            "runs": {name: name in one.runs for name in switchable(Role.OBU) if name in devices or name in one.runs},
        }
        for one in hardware_sets()
    ]
