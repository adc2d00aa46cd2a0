"""Writes the lock files: the installed versions of all dependencies of pyproject.toml, with the hashes of their files.

Run by `make lock` in a fresh environment; it takes about ten minutes. `requirements.lock` holds the packages of the
unit and its commands, `requirements-fleet.lock` those and what a control centre needs, and `requirements-dev.lock` all
of them and the test tools. One line is one package:
`name==version --hash=sha256:... --hash=sha256:...`, with the file that pip chooses for each Python and machine of
`PYTHONS` and `MACHINES`, or the source archive where there is no wheel. Addresses are not written: any index that has
the same files will do. `deploy/node.lock` is Node.js for `deploy/install_dashboard.py`, where there is no npm.
"""

import contextlib
import json
import re
import subprocess
import sys
import tempfile
import tomllib
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
AARCH64 = {"platform_machine": "aarch64"}
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
MACHINES = ("x86_64", "aarch64")
# Those of Debian 12, the oldest system that has Python 3.11. pip tries them in this order.
LIBRARIES = (*(f"manylinux_2_{minor}" for minor in range(36, 4, -1)), "manylinux2014", "manylinux2010", "linux")
NO_FILE = re.compile(r"No matching distribution found for ([A-Za-z0-9._-]+)==")
Files = Mapping[str, str]  # name of a package -> SHA-256 of the file that pip chooses
Ask = Callable[[Mapping[str, str], "list[str]"], Files]


class PackageFileMissing(Exception):
    """The index has no file of a package that fits."""

    def __init__(self, package: str) -> None:
        super().__init__(package)
        self.package = package


def needed_here(requirement: Requirement, extra: str) -> bool:
    """Whether a requirement applies to this machine or to a Raspberry Pi (aarch64)."""
    marker = requirement.marker
    return marker is None or marker.evaluate({"extra": extra}) or marker.evaluate({"extra": extra, **AARCH64})


def closure(wanted: list[str]) -> dict[str, str]:
    """Transitive closure of requirements: canonical name -> installed version."""
    versions: dict[str, str] = {}
    done: set[tuple[str, str]] = set()
    todo = [(Requirement(text), extra) for text in wanted for extra in ["", *sorted(Requirement(text).extras)]]
    while todo:
        requirement, extra = todo.pop()
        name = canonicalize_name(requirement.name)
        if (name, extra) in done:
            continue
        done.add((name, extra))
        found = distribution(name)
        versions[name] = found.version
        for child in map(Requirement, found.requires or ()):
            if needed_here(child, extra):
                todo += [(child, further) for further in ["", *sorted(child.extras)]]
    return versions


def ask_pip(versions: Mapping[str, str], options: list[str]) -> Files:
    """Hash of the file that pip would install of each package, asked of the index that it is configured for.

    Nothing is installed. Raises `PackageFileMissing` where a package has no file that fits the options, and
    `RuntimeError` where
    pip fails otherwise.
    """
    with tempfile.TemporaryDirectory() as folder:
        pins, report = Path(folder) / "pins.txt", Path(folder) / "report.json"
        pins.write_text("".join(f"{name}=={version}\n" for name, version in versions.items()))
        command = [sys.executable, "-m", "pip", "install", "--dry-run", "--ignore-installed", "--no-deps", "--quiet"]
        command += ["--disable-pip-version-check", "--report", str(report), "--target", f"{folder}/none", *options]
        done = subprocess.run([*command, "-r", str(pins)], capture_output=True, text=True, check=False)
        if done.returncode:
            if missing := NO_FILE.search(done.stderr):
                raise PackageFileMissing(canonicalize_name(missing[1]))
            said = "\n".join(line for line in done.stderr.splitlines() if not line.startswith("WARNING"))
            raise RuntimeError(f"pip could not tell the hashes; check its index, then run `make lock` again\n{said}")
        chosen = json.loads(report.read_text())["install"]
    return {
        canonicalize_name(item["metadata"]["name"]): item["download_info"]["archive_info"]["hashes"]["sha256"]
        for item in chosen
    }


def wheels(versions: Mapping[str, str], python: str, machine: str, ask: Ask, doubtful: set[str]) -> Files:
    """Hashes of the wheels for one Python and machine; a package that has none is left out, and added to `doubtful`.

    Those are asked for one by one, since pip names one package a call that has no file.
    """
    options = ["--only-binary=:all:", "--implementation", "cp", "--python-version", python]
    options += [word for library in LIBRARIES for word in ("--platform", f"{library}_{machine}")]
    found: dict[str, str] = {}
    while True:
        try:
            found |= ask({name: version for name, version in versions.items() if name not in doubtful}, options)
            break
        except PackageFileMissing as missing:
            if missing.package not in versions.keys() - doubtful:
                raise RuntimeError(f"pip names {missing.package}, which was not asked for") from missing
            doubtful.add(missing.package)
    for name in sorted(doubtful):
        with contextlib.suppress(PackageFileMissing):
            found |= ask({name: versions[name]}, options)
    return found


def hashes(versions: Mapping[str, str], ask: Ask = ask_pip) -> tuple[dict[str, set[str]], list[str]]:
    """Hashes of all files of each package for `PYTHONS` and `MACHINES`, and a sentence a package without wheels."""
    found: dict[str, set[str]] = defaultdict(set)
    without: dict[str, list[str]] = defaultdict(list)
    doubtful: set[str] = set()
    for machine in MACHINES:
        for python in PYTHONS:
            files = wheels(versions, python, machine, ask, doubtful)
            for name, digest in files.items():
                found[name].add(digest)
            for name in versions.keys() - files.keys():
                without[name].append(f"{machine} with Python {python}")
    said = []
    for name in sorted(without):
        try:
            sources = ask({name: versions[name]}, ["--no-binary", name])
            found[name].add(sources[name])
            instead = "it is built from its source there"
        except PackageFileMissing:
            instead = "and there is no source archive: it cannot be installed there"
        except RuntimeError:
            instead = "and its source archive does not build here: its hash is missing"
        said.append(f"{name} {versions[name]}: no wheel for {', '.join(without[name])}; {instead}")
    return found, said


def lock_text(versions: Mapping[str, str], digests: Mapping[str, Iterable[str]]) -> str:
    """Sorted lines `name==version --hash=sha256:...`."""
    return "".join(
        " ".join((f"{name}=={version}", *(f"--hash=sha256:{digest}" for digest in sorted(digests[name])))) + "\n"
        for name, version in sorted(versions.items())
    )


def write_node() -> list[str]:
    """Write the hashes of `deploy/node.lock`, whose versions are chosen by hand; returns what is to be said."""
    path = ROOT / "deploy" / "node.lock"
    versions = dict(line.split()[0].split("==") for line in path.read_text().splitlines())
    digests, said = hashes(versions)
    path.write_text(lock_text(versions, digests))
    return said


def main() -> None:
    """Write the files at the top of the repository, and that of Node.js."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    run_time: list[str] = project["dependencies"]
    fleet: list[str] = project["optional-dependencies"]["fleet"]
    development: list[str] = project["optional-dependencies"]["dev"]
    every = closure(run_time + fleet + development)
    digests, said = hashes(every)
    for sentence in (*said, *write_node()):
        sys.stderr.write(f"{sentence}\n")
    (ROOT / "requirements.lock").write_text(lock_text(closure(run_time), digests))
    (ROOT / "requirements-fleet.lock").write_text(lock_text(closure(run_time + fleet), digests))
    (ROOT / "requirements-dev.lock").write_text(lock_text(every, digests))


if __name__ == "__main__":
    main()
