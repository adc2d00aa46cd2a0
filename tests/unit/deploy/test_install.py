"""The installer refuses what it cannot install before it touches anything; a whole run is for a container."""

import subprocess
from pathlib import Path

import pytest

from tests.support.data import REPOSITORY

SCRIPT = REPOSITORY / "deploy" / "install.sh"
OLD = 'PRETTY_NAME="Debian GNU/Linux 11 (bullseye)"\nID=debian\nVERSION_ID="11"\n'
OTHER = 'PRETTY_NAME="Fedora Linux 41"\nID=fedora\nVERSION_ID=41\n'


def run(
    tmp_path: Path, *arguments: str, system: str = OLD, script: str | None = None
) -> subprocess.CompletedProcess[str]:
    (tmp_path / "os-release").write_text(system)
    command = ["sh", str(SCRIPT)] if script is None else ["sh", "-s", "--"]
    return subprocess.run(
        [*command, *arguments], input=script or "", capture_output=True, text=True, check=False, cwd=tmp_path,
        env={"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "OBU_OS_RELEASE": str(tmp_path / "os-release"),
             "OBU_INSTALL_LOG": str(tmp_path / "log")},
    )  # fmt: skip


def test_help_names_every_option(tmp_path: Path) -> None:
    text = run(tmp_path, "--help").stdout
    asked = {word for line in SCRIPT.read_text().splitlines() for word in line.split() if word.startswith("--")}
    options = {word.rstrip(")") for word in asked if word.endswith(")")} - {"--help"}
    assert len(options) >= 4 and all(option in text for option in options)
    assert "Examples" in text


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("--nope",), "is not known"),
        (("--from",), "wants a value"),
        (("--purge",), "belongs to remove"),
        (("--access-point", "x" * 33), "at most 32 characters"),
        (("--version", "--upload-pack=x"), "no name of a version"),
    ],
)
def test_a_wrong_option_is_named_and_changes_nothing(tmp_path: Path, arguments: tuple[str, ...], reason: str) -> None:
    done = run(tmp_path, *arguments)
    assert done.returncode == 2 and reason in done.stderr and not (tmp_path / "log").exists()


@pytest.mark.parametrize(("system", "named"), [(OLD, "bullseye"), (OTHER, "Fedora")])
def test_another_system_is_refused_by_its_name(tmp_path: Path, system: str, named: str) -> None:
    done = run(tmp_path, system=system)
    assert done.returncode == 1 and named in done.stderr and not (tmp_path / "log").exists()


def test_a_download_that_breaks_off_runs_nothing(tmp_path: Path) -> None:
    """Whatever part of the script has arrived: no command of it runs."""
    text = SCRIPT.read_text()
    for length in range(0, text.rindex("main "), 997):
        done = run(tmp_path, "--help", script=text[:length])
        assert not done.stdout and not (tmp_path / "log").exists()
