"""Builds the wheel: `python deploy/wheel.py [--out dist]`, run by `make wheel`.

The wheel holds the code, the broker's, vehicles' and plazas' files, and the dashboard with the files of its JavaScript
libraries that the web server gives away, and the licence of each library that is in them. It is built from a copy of
the tree, so that nothing is left in the repository.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from shared.page import assets  # noqa: E402 the repository is not on the path of a script

DASHBOARD = Path("services/monitoring/status/dashboard")
FOLDERS = ("cli", "services", "shared", "broker", "deploy/vehicles", "deploy/plazas", "deploy/trust")
FILES = ("pyproject.toml", "README.md", "LICENSE")
LICENCES = "LICENSES.txt"  # beside the libraries, in node_modules
LEFT_OUT = shutil.ignore_patterns("node_modules", "__pycache__", "*.pyc", ".*")
NAMES_OF_LICENCES = ("LICENSE", "LICENCE", "COPYING", "NOTICE")
IN_README = re.compile(r"^#+ *Licen[sc]e[^\n]*\n(.*?)(?=^#|\Z)", re.MULTILINE | re.DOTALL | re.IGNORECASE)
OWN_SETUPTOOLS = 77  # the first that pyproject.toml can be built with


class WheelIncomplete(Exception):
    """Something that belongs into the wheel is missing."""


class Package(NamedTuple):
    """What a JavaScript package says about its licence."""

    name: str
    version: str
    licence: str
    author: str
    source: str
    texts: tuple[str, ...]


def library_files() -> set[str]:
    """Files of the libraries that the web server gives away, below node_modules."""
    tables = (assets.LIBRARIES, assets.MAP_LIBRARIES, assets.DOCUMENTATION)
    return {path for table in tables for path in table.values()} | {assets.LIBRARY_STYLE}


def packages(dashboard: Path) -> list[Package]:
    """List the packages that the libraries are made of, with what each holds about its licence."""
    locked = json.loads((dashboard / "package-lock.json").read_text(encoding="utf-8"))["packages"]
    shipped = {
        path: row for path, row in sorted(locked.items()) if path and not row.get("dev") and not row.get("optional")
    }
    return [
        _package(dashboard / path, path.removeprefix("node_modules/"), row["version"]) for path, row in shipped.items()
    ]


def _package(folder: Path, name: str, number: str) -> Package:
    said = json.loads((folder / "package.json").read_text(encoding="utf-8"))
    author = said.get("author", "")
    source = said.get("homepage") or said.get("repository", "")
    files = sorted(
        path for path in folder.glob("*") if path.is_file() and path.name.upper().startswith(NAMES_OF_LICENCES)
    )
    files += sorted(folder / path for path in _notices(folder, name))
    texts = [path.read_text(encoding="utf-8", errors="replace").strip() for path in files]
    for readme in [] if texts else sorted(folder.glob("README*")):
        section = IN_README.search(readme.read_text(encoding="utf-8", errors="replace"))
        texts += [section[1].strip()] if section else []
    return Package(
        name, number, said.get("license", "unknown"),
        author.get("name", "") if isinstance(author, dict) else author,
        source.get("url", "") if isinstance(source, dict) else source,
        tuple(texts),
    )  # fmt: skip


def _notices(folder: Path, name: str) -> set[str]:
    """Files of notices beside the files that are given away, as bundlers write them."""
    own = {path.removeprefix(f"{name}/") for path in library_files() if path.startswith(f"{name}/")}
    return {f"{path}.LICENSE.txt" for path in own if (folder / f"{path}.LICENSE.txt").is_file()}


def licences(found: Sequence[Package]) -> str:
    """Text of the licences, one section a package.

    A package that holds no text is named with its author, and with a package that holds the text of the same licence.
    Raises `WheelIncomplete` where there is none.
    """
    parts = ["JavaScript libraries in this folder, and what is bundled in them."]
    for package in found:
        texts = package.texts
        if not texts:
            same = next((other for other in found if other.texts and other.licence == package.licence), None)
            if same is None:
                raise WheelIncomplete(
                    f"{package.name} {package.version} holds no licence; find its text before it is given away"
                )
            who = f"Copyright {package.author} ({package.source})."
            texts = (f"{who} Its package holds no text; the conditions are those under {same.name}.",)
        parts.append("\n\n".join([f"{'=' * 79}\n{package.name} {package.version}: {package.licence}", *texts]))
    return "\n\n".join(parts) + "\n"


def stage(folder: Path) -> None:
    """Copy what belongs into the wheel to an empty folder; raises `WheelIncomplete` without dashboard."""
    libraries = ROOT / DASHBOARD / "node_modules"
    if missing := sorted(path for path in library_files() if not (libraries / path).is_file()):
        raise WheelIncomplete(
            f"the dashboard's libraries are not installed ({missing[0]} is missing); run `make setup` first"
        )
    for name in FOLDERS:
        shutil.copytree(ROOT / name, folder / name, ignore=LEFT_OUT)
    for name in FILES:
        shutil.copy(ROOT / name, folder / name)
    for path in library_files():
        copy = folder / DASHBOARD / "node_modules" / path
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(libraries / path, copy)
    text = licences(packages(ROOT / DASHBOARD))
    (folder / DASHBOARD / "node_modules" / LICENCES).write_text(text, encoding="utf-8")


def builds_offline() -> bool:
    """Whether the installed setuptools can build the wheel; otherwise pip asks its index for one that can."""
    try:
        return int(version("setuptools").split(".")[0]) >= OWN_SETUPTOOLS
    except PackageNotFoundError:
        return False


def build(out: Path) -> Path:
    """Write the wheel into a folder, and return its path; raises `WheelIncomplete`, or `CalledProcessError` of pip."""
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        tree, made = Path(folder) / "tree", Path(folder) / "made"
        tree.mkdir()
        stage(tree)
        command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps"]
        command += [*(["--no-build-isolation"] if builds_offline() else []), "--wheel-dir", str(made), str(tree)]
        subprocess.run(command, check=True)
        (wheel,) = made.glob("*.whl")
        return Path(shutil.copy(wheel, out / wheel.name))


def main() -> int:
    """Build the wheel, and print its path."""
    parser = argparse.ArgumentParser(description="Build the wheel.")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder of the wheel")
    try:
        sys.stdout.write(f"{build(parser.parse_args().out)}\n")
    except WheelIncomplete as error:
        sys.stderr.write(f"{error}\n")
        return 1
    except subprocess.CalledProcessError as error:
        sys.stderr.write(f"pip could not build the wheel (exit {error.returncode}); its words are above\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
