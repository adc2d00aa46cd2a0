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
        (("upgrade", "--local"), "belong to install"),
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
    last = text.rindex('main "$@"; exit')
    for length in (*range(0, last, 997), *range(last - 3, text.rindex("}") + 1)):
        done = run(tmp_path, "--help", script=text[:length])
        assert not done.stdout and not (tmp_path / "log").exists()


UBUNTU = 'PRETTY_NAME="Ubuntu 22.04.5 LTS"\nID=ubuntu\nID_LIKE=debian\nVERSION_ID="22.04"\n'
TESTING = 'PRETTY_NAME="Debian GNU/Linux forky/sid"\nID=debian\n'


def call(tmp_path: Path, commands: str, **stubs: str) -> subprocess.CompletedProcess[str]:
    """Run commands among the functions of the script, with programs of its environment replaced."""
    functions = SCRIPT.read_text().rpartition("{ main ")[0]
    (tmp_path / "bin").mkdir()
    for name, text in stubs.items():
        (tmp_path / "bin" / name).write_text(f"#!/bin/sh\n{text}\n")
        (tmp_path / "bin" / name).chmod(0o755)
    return subprocess.run(
        ["sh", "-s"], input=f"{functions}\n{commands}\n", capture_output=True, text=True, check=False, cwd=tmp_path,
        env={"PATH": f"{tmp_path}/bin:/usr/bin:/bin", "OBU_OS_RELEASE": str(tmp_path / "os-release"),
             "OBU_INSTALL_LOG": str(tmp_path / "log")},
    )  # fmt: skip


def test_a_command_that_fails_ends_the_installation(tmp_path: Path) -> None:
    """As the last line calls it: no list around it switches that off."""
    last = SCRIPT.read_text().strip().splitlines()[-1]
    stubs = "check_machine() { :; }\ninstall_unit() { false; echo went on; }\n"
    done = call(tmp_path, f"{stubs}set -- --from {tmp_path}\n{last}")
    assert done.returncode == 1 and "went on" not in done.stdout, done.stderr


@pytest.mark.parametrize(("system", "code", "passes"), [(UBUNTU, 1, False), (UBUNTU, 0, True), (TESTING, 1, True)])
def test_a_relative_of_debian_is_judged_by_its_python(tmp_path: Path, system: str, code: int, passes: bool) -> None:
    (tmp_path / "os-release").write_text(system)
    done = call(tmp_path, "getconf() { echo 32; }\ncheck_machine", python3=f"exit {code}")
    assert ("has 32 bit" if passes else "older than 3.11") in done.stderr


@pytest.mark.parametrize(
    ("stopped", "answers", "comes_up"), [("", 0, True), ("obu@core.fusion.service", 0, False), ("", 1, False)]
)
def test_a_unit_runs_when_its_page_answers_and_every_process_runs(
    tmp_path: Path, stopped: str, answers: int, comes_up: bool
) -> None:
    python = tmp_path / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(f'#!/bin/sh\n[ "$3" = http://127.0.0.1:8099/ ] && exit {answers}\nexit 1\n')
    python.chmod(0o755)
    (tmp_path / "address").write_text("http://127.0.0.1:8099/")
    systemctl = f"""case $* in
    *is-enabled*rsu*) exit 1 ;;
    *show*) echo obu@core.fusion.service obu-broker.service ;;
    *is-active*) [ "$3" != "{stopped}" ] ;;
    esac"""
    commands = f"""UNIT={tmp_path} ADDRESS={tmp_path}/address number=0 START_S=6
sleep() {{ :; }}
wait_for_unit
echo port "$port" end"""
    done = call(tmp_path, commands, systemctl=systemctl)
    assert (done.stdout.endswith("port 8099 end\n")) is comes_up, done.stderr
    assert comes_up or ("does not start" in done.stderr and stopped in done.stderr)


def test_a_user_that_is_not_of_the_unit_stays(tmp_path: Path) -> None:
    rows = ["obu:x:9:9::/var/lib/obu:/x", "obu-core-fusion:x:8:9::/var/lib/obu:/x", "obu-driver:x:7:7::/home/d:/x"]
    done = call(tmp_path, "users_of_unit", getent="\n".join(f"echo {row}" for row in rows))
    assert done.stdout.split() == ["obu", "obu-core-fusion"]
