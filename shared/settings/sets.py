"""Sets of hardware from which a set-up begins: files of deploy/vehicles/sets."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from pydantic_core import to_json

from .. import shipped
from ..bounded import TOML_BYTES, load_toml, read_text
from ..processes import Role, switchable

FOLDER = shipped(Path("deploy/vehicles/sets"))


@dataclass(frozen=True)
class HardwareSet:
    """One set, and what it is made of (the first comment of its file)."""

    name: str
    text: str
    what: str
    tables: Mapping[str, object]
    runs: tuple[str, ...]  # processes that it switches on; it switches off all others that read or simulate devices

    def settings(self, known: Collection[str] = ()) -> dict[str, str]:
        """Every setting as JSON; a table is one setting where `known` has its name."""
        return dict(_leaves("", self.tables, known))


@cache
def hardware_sets() -> tuple[HardwareSet, ...]:
    """Every set, by name."""
    return tuple(_read(path) for path in sorted(FOLDER.glob("*.toml")))


@cache
def values_of_sets() -> Mapping[str, frozenset[str]]:
    """Values that sets give to settings, as JSON."""
    found: dict[str, set[str]] = {}
    for one in hardware_sets():
        for name, value in one.settings().items():
            found.setdefault(name, set()).add(value)
    return {name: frozenset(values) for name, values in found.items()}


def _read(path: Path) -> HardwareSet:
    text = read_text(path, TOML_BYTES)
    tables = load_toml(text)
    runs = (
        name for name in switchable(Role.OBU)
        if isinstance(layer := tables.get(name.split(".")[0]), dict) and name.split(".")[1] in layer
    )  # fmt: skip
    what = text.partition("\n")[0].removeprefix("#").strip()
    return HardwareSet(path.stem, text, what, tables, tuple(runs))


def _leaves(prefix: str, table: Mapping[str, object], known: Collection[str]) -> list[tuple[str, str]]:
    found = []
    for key, value in table.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict) and (name not in known or "." not in prefix.removesuffix(".")):  # or a process
            found += _leaves(f"{name}.", value, known)
        elif name != "vehicle.name":
            found.append((name, to_json(value).decode()))
    return found
