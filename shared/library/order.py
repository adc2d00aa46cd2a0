"""The order in which the recordings of a folder were made: stored beside them, and independent of clock and names.

A host without a battery clock may date the present drive before older ones. The recorder therefore keeps a list where
the names, with their numbers as numbers, do not say the same. A recording that is not in it follows those that are,
such as a file that was copied into the folder; without a list, as in a folder of an earlier version, names decide.
"""

import json
import logging
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from ..bounded import load_json, read_bytes

log = logging.getLogger(__name__)

ORDER_FILE = "order.json"
ORDER_BYTES = 10_000_000


def natural(name: str) -> list[tuple[int, str]]:
    """Sort key of a name in which numbers count as numbers."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d{1,18})", name) if part]


def read_order(folder: Path) -> list[str]:
    """The stored order, oldest first; empty where there is none that can be read."""
    try:
        stored = load_json(read_bytes(folder / ORDER_FILE, ORDER_BYTES), ORDER_BYTES)
    except FileNotFoundError:
        return []
    except (OSError, ValueError) as error:
        log.warning("the order of the recordings in %s cannot be read, and is made anew: %s", folder, error)
        return []
    return [name for name in stored if isinstance(name, str)] if isinstance(stored, list) else []


def in_order(names: Iterable[str], stored: Sequence[str]) -> list[str]:
    """Sort names from the oldest to the newest: those of the stored order, then the others."""
    places = {name: place for place, name in enumerate(stored)}
    return sorted(names, key=lambda name: (places.get(name, len(places)), natural(name)))


def write_order(folder: Path, names: Sequence[str]) -> None:
    """Store an order if the names do not say it: after a power cut there is the one before, or this one."""
    if list(names) == in_order(names, ()):
        (folder / ORDER_FILE).unlink(missing_ok=True)
        return
    draft = folder / f"{ORDER_FILE}.new"
    with draft.open("w", encoding="utf-8") as file:
        json.dump(names, file)
        file.flush()
        os.fsync(file.fileno())
    draft.replace(folder / ORDER_FILE)
