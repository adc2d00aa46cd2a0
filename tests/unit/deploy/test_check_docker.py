"""The check of Docker's versions before `make up`, with a program of the test's own as docker."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.support.data import REPOSITORY

SCRIPT = REPOSITORY / "deploy" / "check_docker.sh"


def check(folder: Path, compose: str, engine: str) -> subprocess.CompletedProcess[str]:
    """Run it with a docker that states these versions; an empty one is not there, or does not answer."""
    docker = folder / "docker"
    docker.write_text(
        f'#!/bin/sh\ncase "$*" in\n"compose version --short") echo "{compose}" ;;\nversion*) echo "{engine}" ;;\nesac\n'
    )
    docker.chmod(0o755)
    path = f"{folder}:{os.environ['PATH']}"
    return subprocess.run(["sh", str(SCRIPT)], env={"PATH": path}, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("compose", ["2.24.0", "v2.24.5", "2.40.3-3", "v2.29.1-desktop.1", "5.0.1", "10.0"])
def test_new_enough(tmp_path: Path, compose: str) -> None:
    assert check(tmp_path, compose, "20.10.24+dfsg1").returncode == 0
    assert check(tmp_path, compose, "28.2.2").returncode == 0


@pytest.mark.parametrize("compose", ["1.29.2", "2.23.3", "v2.3.4", "2.9.0-rc1"])
def test_an_old_compose_is_named_with_the_version_that_is_needed(tmp_path: Path, compose: str) -> None:
    done = check(tmp_path, compose, "28.2.2")
    assert done.returncode == 1
    assert f"Compose is {compose}, and 2.24 or newer is needed" in done.stderr


def test_docker_without_compose(tmp_path: Path) -> None:
    done = check(tmp_path, "", "28.2.2")
    assert (done.returncode, "Docker has no Compose" in done.stderr) == (1, True)


def test_an_old_engine_is_named_and_one_that_does_not_answer_is_left_to_compose(tmp_path: Path) -> None:
    done = check(tmp_path, "2.24.0", "19.03.15")
    assert done.returncode == 1
    assert "Docker Engine is 19.03.15, and 20.10 or newer is needed" in done.stderr
    assert check(tmp_path, "2.24.0", "").returncode == 0


def test_the_how_to_states_the_same_versions() -> None:
    text = (REPOSITORY / "docs" / "how-to" / "run-in-containers.md").read_text(encoding="utf-8")
    script = SCRIPT.read_text(encoding="utf-8")
    assert "Docker Engine 20.10 or newer and Compose 2.24 or newer" in text
    assert "compose_needed=2.24\nengine_needed=20.10\n" in script


def test_make_up_checks_first() -> None:
    assert "up: ## start the containers\n\t@deploy/check_docker.sh\n" in (REPOSITORY / "Makefile").read_text()
