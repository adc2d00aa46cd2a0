"""Renames what has no name of the field: `python -m tests.support.renaming [--loops]`, on a committed tree.

`names.toml` has the classes and constants by the file that defines them; entries whose old name is gone are skipped, so
that a branch that is older can be brought up to date before it is merged. `--loops` renames loop variables that say
nothing (`one`, `found`). Needs libcst (`pip install libcst`), which nothing else uses.
"""

import argparse
import os
import re
import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path

try:
    from tests.support.renaming.loops import VARIABLES, rename_loops
    from tests.support.renaming.symbols import SymbolRenames, in_prose
except ModuleNotFoundError as error:
    sys.exit(f"{error.name} is not installed: pip install {error.name}")

TABLE = Path(__file__).with_name("names.toml")


def main() -> None:
    """Rename, and list what keeps its name."""
    parser = argparse.ArgumentParser(prog="python -m tests.support.renaming", description=__doc__.splitlines()[0])
    parser.add_argument(
        "--loops", action="store_true", help="rename loop variables as well (five minutes: mypy runs first)"
    )
    arguments = parser.parse_args()
    os.chdir(TABLE.parents[3])
    if subprocess.run(["git", "status", "--porcelain"], check=True, capture_output=True).stdout:
        sys.exit("there are changes that are not committed: commit them, so that `git checkout .` takes a rename back")
    files = [Path(name) for name in _tracked("*.py") if not name.startswith("tests/support/renaming/")]
    _symbols(files)
    if arguments.loops:
        _loops(files)


def _symbols(files: list[Path]) -> None:
    table = tomllib.loads(TABLE.read_text())
    renames = {file: names for file, names in table.items() if Path(file).exists()}
    definitions = Counter(name for path in files for name in _defined(path))
    renames = {
        file: {old: new for old, new in names.items() if old in _defined(Path(file))} for file, names in renames.items()
    }
    symbols = SymbolRenames(renames)
    symbols.passed_on(files)
    for path in files:
        symbols.apply(path)
    unique = {old: new for names in renames.values() for old, new in names.items() if definitions[old] == 1}
    for path in [*files, *map(Path, _tracked("*.md"))]:
        text = path.read_text()
        if (changed := in_prose(text, unique | renames.get(str(path), {}))) != text:
            path.write_text(changed)
    print(f"{sum(map(len, renames.values()))} names")


def _defined(path: Path) -> set[str]:
    return set(re.findall(r"^(?:class |)([A-Za-z_]\w*)(?=[(:]|\[| = |: )", path.read_text(), re.MULTILINE))


def _loops(files: list[Path]) -> None:
    from tests.support.renaming.element_types import element_types  # mypy is imported for loops alone

    types = element_types(VARIABLES)
    for path in files:
        for line, name in rename_loops(path, types.get(str(path), {})):
            print(f"{path}:{line}: {name}")


def _tracked(pattern: str) -> list[str]:
    return subprocess.run(["git", "ls-files", pattern], check=True, capture_output=True, text=True).stdout.split()


if __name__ == "__main__":
    main()
