"""Commands of a container engine, for tests that skip where there is none."""

import os
import subprocess
import time
from collections.abc import Callable, Sequence

import pytest

from .data import REPOSITORY


def run(*command: str, environment: dict[str, str] | None = None, timeout_s: float = 60.0) -> str:
    """Run a command to its end; its standard output, or a failure with its error output."""
    result = subprocess.run(
        command, cwd=REPOSITORY, env={**os.environ, **(environment or {})}, timeout=timeout_s, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 0, f"{' '.join(command)}\n{result.stdout[-2000:]}\n{result.stderr[-4000:]}"
    return result.stdout


def eventually(condition: Callable[[], bool], within_s: float) -> float:
    """Wait for a condition; the seconds that it took."""
    started = time.monotonic()
    while not condition():
        assert time.monotonic() - started < within_s, f"not within {within_s} s"
        time.sleep(0.2)
    return time.monotonic() - started


def engine_with(images: Sequence[str]) -> None:
    """Skip the test where there is no engine with Compose, or an image can neither be found nor fetched."""
    if not _succeeds("docker", "info"):
        pytest.skip("no Docker engine answers here")
    if not _succeeds("docker", "compose", "version"):
        pytest.skip("the Docker engine has no Compose plugin")
    for image in images:
        if not _succeeds("docker", "image", "inspect", image) and not _succeeds("docker", "pull", image, within_s=180):
            pytest.skip(f"the image {image} is neither here nor to be had")


def kill(container: str, image: str, number: int) -> None:
    """Send a signal as another process of the host would. (`docker kill` counts as a wish of the user's.)"""
    pid = run("docker", "inspect", "--format", "{{.State.Pid}}", container).strip()
    run("docker", "run", "--rm", "--pid=host", "--user=0", "--network=none", "--entrypoint=python", image,
        "-c", f"import os; os.kill({pid}, {number})")  # fmt: skip


def _succeeds(*command: str, within_s: float = 20.0) -> bool:
    try:
        return subprocess.run(command, timeout=within_s, capture_output=True, check=False).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False
