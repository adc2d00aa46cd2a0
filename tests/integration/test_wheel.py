"""The wheel in a fresh environment, outside the repository."""

import json
import os
import re
import subprocess
import sys
import sysconfig
from fnmatch import fnmatch
from pathlib import Path

import pytest

from cli.demo.local import free_port
from tests.support.data import REPOSITORY
from tests.support.patience import HANGS_S
from tests.support.wheel import built

pytestmark = [pytest.mark.slow, pytest.mark.whole_unit, pytest.mark.broker]


@pytest.fixture(scope="module")
def obu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Path of the command `obu` of an environment that has the wheel, and borrows the packages that it requires."""
    folder = tmp_path_factory.mktemp("installed")
    wheel = built(folder)
    environment = folder / "environment"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(environment)], check=True)
    python = environment / "bin" / "python"
    # A folder that a .pth file names is searched, but its own .pth files, such as the one of this repository, are not.
    (site,) = environment.glob("lib/python3.*/site-packages")
    (site / "borrowed.pth").write_text(sysconfig.get_path("purelib"), encoding="utf-8")
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*install, str(wheel)], check=True)
    return environment / "bin" / "obu"


def run(obu: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    outside = {key: value for key, value in os.environ.items() if not key.startswith(("OBU_", "PYTHONPATH"))}
    return subprocess.run(
        [str(obu), *arguments], cwd=folder, env=outside, capture_output=True, text=True, timeout=HANGS_S, check=False
    )


@pytest.mark.parametrize("broker", ["simulated", "mosquitto"])
def test_the_demo_runs_from_the_wheel(obu: Path, tmp_path: Path, broker: str) -> None:
    for name in ("cli", "shared"):  # packages of other programs, which must not be taken for ours
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise SystemExit('not this one')")
    done = run(obu, tmp_path, "demo", "--duration", "20", "--json", "--port", str(free_port()), "--broker", broker)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["healthy"]
    assert result["processes_alive"] == result["processes_expected"]
    assert result["fixes"] > 0
    kept = sorted(path.name for path in (tmp_path / ".obu" / "demo").iterdir())
    assert "recordings" in kept, "the state is kept in the working folder"
    documented = re.findall(r"`([^` ]+)`", (REPOSITORY / "docs" / "how-to" / "upgrade.md").read_text(encoding="utf-8"))
    names = [name.rstrip("/").split("/")[0] for name in documented]
    assert [name for name in kept if not any(fnmatch(name, pattern) for pattern in names)] == []


@pytest.mark.parametrize("file", ["deploy/vehicles/pi.toml", "deploy/vehicles/rsu.toml"])
def test_doctor_finds_the_page_and_the_files_that_came_with_the_wheel(obu: Path, tmp_path: Path, file: str) -> None:
    done = run(obu, tmp_path, "doctor", "--vehicle", file)
    assert "ok  libraries of the dashboard" in done.stdout, done.stderr
    assert f"from {file}" in done.stdout
    assert "Traceback" not in done.stderr


def test_pages_of_the_repository_are_not_printed_elsewhere(obu: Path, tmp_path: Path) -> None:
    done = run(obu, tmp_path, "reference")
    assert (done.returncode, "is not the repository" in done.stderr) == (2, True)


def test_a_missing_vehicle_file_names_the_folder_of_the_examples(obu: Path, tmp_path: Path) -> None:
    done = run(obu, tmp_path, "doctor", "--vehicle", "mine.toml")
    examples = obu.parent.parent.glob("lib/python3.*/site-packages/deploy/vehicles")
    assert f"see {next(examples)}/ for examples" in done.stdout.replace("\n", "")
