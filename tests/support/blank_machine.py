"""A blank Debian with systemd, in a container."""

import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.support.containers import engine_with, eventually, run
from tests.support.data import REPOSITORY

BLANK = """FROM {system}
RUN apt-get update && apt-get install -y --no-install-recommends systemd systemd-sysv dbus ca-certificates git
STOPSIGNAL SIGRTMIN+3
CMD ["/sbin/init"]
"""
INSTALL_S = 900.0
CERTIFICATES = "NODE_EXTRA_CA_CERTS=/etc/ssl/certs/ca-certificates.crt"  # of a network whose proxy has its own


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


@contextmanager
def blank_machine(system: str, folder: Path, options: Sequence[str] = ()) -> Iterator[Machine]:
    """Start one with a copy of this repository in /src; `options` are further ones of `docker run`."""
    engine_with([system])
    (folder / "Dockerfile").write_text(BLANK.format(system=system))
    image = f"obu-blank-{system.partition(':')[2]}"
    run("docker", "build", "--quiet", "--tag", image, str(folder), timeout_s=INSTALL_S)
    name = f"{image}-{folder.name}"
    # What systemd needs of its host; where that is not granted, it does not start.
    rights = ("--cap-add", "SYS_ADMIN", "--cap-add", "NET_ADMIN", "--cap-add", "SYS_NICE", "--cgroupns", "host",
              "--security-opt", "seccomp=unconfined", "--security-opt", "apparmor=unconfined",
              "--tmpfs", "/run", "--tmpfs", "/run/lock", "--env", "container=docker")  # fmt: skip
    legacy = Path("/sys/fs/cgroup/systemd")
    group = legacy if legacy.is_dir() else Path("/sys/fs/cgroup")
    run("docker", "run", "--detach", "--name", name, *rights, *options, "--volume", f"{group}:{group}", image)
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
