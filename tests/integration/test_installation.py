"""The unit as deploy/install.sh puts it on a blank Debian with systemd: installed, upgraded, moved, removed.

It takes three minutes a system, and fetches packages, so it is slow and of `make containers`. It skips where there is
no engine, where the system's image can neither be found nor fetched, or where systemd does not start in a container.
"""

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.containers import engine_with, eventually, run
from tests.support.data import REPOSITORY

pytestmark = [pytest.mark.container, pytest.mark.slow]

SYSTEMS = ("debian:bookworm-slim", "debian:trixie-slim")
BLANK = """FROM {system}
RUN apt-get update && apt-get install -y --no-install-recommends systemd systemd-sysv dbus ca-certificates git
STOPSIGNAL SIGRTMIN+3
CMD ["/sbin/init"]
"""
INSTALL_S = 900.0
CERTIFICATES = "NODE_EXTRA_CA_CERTS=/etc/ssl/certs/ca-certificates.crt"  # of a network whose proxy has its own
ACCESS_POINT = "/etc/NetworkManager/system-connections/obu-access-point.nmconnection"
BROKEN = "sed -i 's/^class Process:/class Process(:/' services/core/fusion/process.py"
COMMIT = "git -c safe.directory='*' -c user.name=x -c user.email=x@x commit -qam broken"


class Machine:
    """A blank machine, in a container."""

    def __init__(self, name: str) -> None:
        self.name = name

    def run(self, command: str, *, fails: bool = False) -> str:
        """Run a command of a shell; its output, both kinds."""
        done = subprocess.run(
            ["docker", "exec", "--env", CERTIFICATES, self.name, "sh", "-c", f"{command} 2>&1"], capture_output=True,
            text=True, timeout=INSTALL_S, check=False,
        )  # fmt: skip
        assert bool(done.returncode) is fails, f"{command}\n{done.stdout[-3000:]}"
        return done.stdout

    def state(self) -> str:
        done = subprocess.run(
            ["docker", "exec", self.name, "systemctl", "is-system-running"], capture_output=True, text=True, check=False
        )
        return done.stdout.strip()

    @property
    def services(self) -> dict[str, str]:
        rows = self.run("systemctl list-units --plain --no-legend 'obu@*'").splitlines()
        return {row.split()[0]: row.split()[3] for row in rows if row.strip()}


@pytest.fixture(scope="module", params=SYSTEMS)
def machine(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    engine_with([request.param])
    folder: Path = tmp_path_factory.mktemp("blank")
    (folder / "Dockerfile").write_text(BLANK.format(system=request.param))
    image = f"obu-blank-{request.param.partition(':')[2]}"
    run("docker", "build", "--quiet", "--tag", image, str(folder), timeout_s=INSTALL_S)
    name = f"{image}-{folder.name}"
    # What systemd needs of its host; where that is not granted, it does not start.
    rights = ("--cap-add", "SYS_ADMIN", "--cap-add", "NET_ADMIN", "--cap-add", "SYS_NICE", "--cgroupns", "host",
              "--security-opt", "seccomp=unconfined", "--security-opt", "apparmor=unconfined",
              "--tmpfs", "/run", "--tmpfs", "/run/lock", "--env", "container=docker")  # fmt: skip
    legacy = Path("/sys/fs/cgroup/systemd")
    group = legacy if legacy.is_dir() else Path("/sys/fs/cgroup")
    run("docker", "run", "--detach", "--name", name, *rights, "--volume", f"{group}:{group}", image)
    try:
        found = Machine(name)
        try:
            eventually(lambda: found.state() in ("running", "degraded"), 60.0)
        except AssertionError:
            pytest.skip("systemd does not start in a container of this engine")
        found.run("mount --make-rshared /")  # as systemd does on a machine of its own, for credentials of services
        run("git", "clone", "--quiet", "--no-hardlinks", str(REPOSITORY), str(folder / "unit"))
        run("docker", "cp", str(folder / "unit"), f"{name}:/src")
        found.run("chown -R 1000:1000 /src")  # a user's copy, as after git clone
        yield found
    finally:
        run("docker", "rm", "--force", "--volumes", name)


def test_one_line_installs_upgrades_and_removes(machine: Machine) -> None:
    said = machine.run("sh /src/deploy/install.sh --simulated --access-point 'OBU truck 7'")
    assert "/login#token=" in said and "passphrase" in said
    eventually(lambda: set(machine.services.values()) == {"running"}, 60.0)
    assert len(machine.services) >= 15
    assert "no broker" not in machine.run("obu doctor || true")
    assert (
        machine.run("stat -c %a /etc/NetworkManager/system-connections/obu-access-point.nmconnection").strip() == "600"
    )
    assert "0.0.0.0" in machine.run("grep HTTP_HOST /etc/obu/obu.env")

    version = machine.run("git -C /opt/obu rev-parse HEAD")
    machine.run(f"cd /src && {BROKEN} && {COMMIT}")
    assert "the former version runs again" in machine.run("obu-install upgrade", fails=True)
    assert machine.run("git -C /opt/obu rev-parse HEAD") == version
    eventually(lambda: set(machine.services.values()) == {"running"}, 60.0)

    machine.run("obu backup -o /tmp/unit.zip")
    assert "the unit runs" in machine.run("obu reset --all --yes", fails=True)
    machine.run("systemctl stop obu.target && obu reset --all --yes && obu restore /tmp/unit.zip")
    owner = machine.run("stat -c '%U:%G %a' /var/lib/obu-private/keys/evidence.key").strip()
    assert owner == "root:obu-evidence 440"
    machine.run("systemctl start obu.target")
    eventually(lambda: set(machine.services.values()) == {"running"}, 60.0)

    machine.run("obu-install remove")
    machine.run("test -e /etc/obu/vehicle.toml && test ! -e /opt/obu && test ! -e /usr/local/bin/obu")
    machine.run("sh /src/deploy/install.sh remove --purge")
    machine.run("test ! -e /etc/obu && test ! -e /var/lib/obu && ! getent passwd | grep -q ^obu")
