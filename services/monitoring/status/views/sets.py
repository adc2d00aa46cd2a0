"""Sets of hardware from which a set-up begins: files of deploy/vehicles/sets."""

from functools import cache
from pathlib import Path

from pydantic_core import to_json

from shared import shipped
from shared.bounded import TOML_BYTES, load_toml, read_text
from shared.page.answers import Object

FOLDER = shipped(Path("deploy/vehicles/sets"))


@cache
def sets() -> list[Object]:
    """Name, what it is made of (the first comment of its file), and every setting as JSON."""
    found: list[Object] = []
    for path in sorted(FOLDER.glob("*.toml")):
        text = read_text(path, TOML_BYTES)
        found.append({
            "name": path.stem,
            "what": text.partition("\n")[0].removeprefix("#").strip(),
            "settings": dict(_leaves("", load_toml(text))),
        })  # fmt: skip
    return found


def _leaves(prefix: str, table: dict[str, object]) -> list[tuple[str, str]]:
    found = []
    for key, value in table.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            found += _leaves(f"{name}.", value)
        elif name != "vehicle.name":
            found.append((name, to_json(value).decode()))
    return found
