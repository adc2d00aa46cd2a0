"""Writes the lock files: the installed versions of all dependencies of pyproject.toml.

Run by `make lock` in a fresh environment. `requirements.lock` holds the packages of the unit and its commands, and
`requirements-dev.lock` those and the test tools.
"""

import tomllib
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
AARCH64 = {"platform_machine": "aarch64"}


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


def lock_text(wanted: list[str]) -> str:
    """Sorted lines `name==version`."""
    return "".join(f"{name}=={version}\n" for name, version in sorted(closure(wanted).items()))


def main() -> None:
    """Write the files at the top of the repository."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    run_time: list[str] = project["dependencies"]
    development: list[str] = project["optional-dependencies"]["dev"]
    (ROOT / "requirements.lock").write_text(lock_text(run_time))
    (ROOT / "requirements-dev.lock").write_text(lock_text(run_time + development))


if __name__ == "__main__":
    main()
