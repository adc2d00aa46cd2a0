"""The unit as `docker compose up` runs it: healthy, without privileges, and restarted after each kind of failure.

It takes two minutes, and three with an empty build cache, so it is marked slow: `make containers` runs it. It skips
where there is no engine with Compose, or where the base images can neither be found nor fetched.
"""

import json
import os
import signal
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from typing import cast

import pytest

from broker.keys import CONTAINER_USERS
from cli.demo.local import free_port
from shared import VERSION
from shared.processes import Role, running
from tests.support.containers import engine_with, eventually, kill, run

pytestmark = [pytest.mark.container, pytest.mark.slow]

BASE_IMAGES = ("python:3.11-slim-bookworm", "eclipse-mosquitto:2")
EXPECTED = [row.name for row in running(Role.OBU, ["sensors.simulator"])]
SERVICES = [name.replace(".", "-") for name in EXPECTED]
MEMORY_BYTES = 700e6


@dataclass(frozen=True)
class Unit:
    """A running Compose project."""

    project: str
    http_port: int

    def compose(self, *arguments: str, timeout_s: float = 60.0) -> str:
        environment = {
            "OBU_HTTP_PORT": str(self.http_port), "OBU_HTTP_BIND": "127.0.0.1", "COMPOSE_FILE": "docker-compose.yml",
            "OBU_VEHICLE": "deploy/vehicles/simulated.toml",
        }  # fmt: skip
        return run("docker", "compose", "-p", self.project, *arguments, environment=environment, timeout_s=timeout_s)

    def inspect(self, service: str, template: str) -> str:
        return run("docker", "inspect", "--format", template, f"{self.project}-{service}-1").strip()

    def get(self, path: str) -> dict[str, object]:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.http_port}{path}", timeout=5) as answer:
            return cast("dict[str, object]", json.load(answer))

    def is_well(self) -> bool:
        """Tell whether every process reports itself ready and the solution is fresh."""
        try:
            health = self.get("/api/health")
        except (OSError, urllib.error.URLError):
            return False
        processes = cast("dict[str, dict[str, object]]", health["processes"])
        return health["state"] == "ok" and [name for name in EXPECTED if processes[name]["ok"]] == EXPECTED

    def signal(self, service: str, number: signal.Signals) -> None:
        kill(f"{self.project}-{service}-1", "obu:local", number)

    def stop_program(self, service: str, name: str) -> None:
        """Stop the program behind the shell of a container; the shell goes on."""
        pid = self.inspect(service, "{{.State.Pid}}")
        find = (
            "import os, pathlib, signal; "
            f"children = pathlib.Path('/proc/{pid}/task/{pid}/children').read_text().split(); "
            f"(found,) = [p for p in children if {name!r} in pathlib.Path('/proc', p, 'comm').read_text()]; "
            "os.kill(int(found), signal.SIGSTOP)"
        )
        run("docker", "run", "--rm", "--pid=host", "--user=0", "--network=none", "--entrypoint=python", "obu:local",
            "-c", find)  # fmt: skip


@pytest.fixture(scope="module")
def unit() -> Iterator[Unit]:
    engine_with(BASE_IMAGES)
    running = Unit(f"obu-test-{os.getpid()}", free_port())
    try:
        running.compose("build", timeout_s=400)
        running.compose("up", "--detach", timeout_s=120)
        yield running
    finally:
        running.compose("down", "--volumes", "--timeout", "5", timeout_s=60)


def test_every_process_starts_and_a_position_is_published(unit: Unit) -> None:
    eventually(unit.is_well, within_s=60)
    topics = cast("dict[str, dict[str, object]]", unit.get("/api/state")["topics"])
    assert topics["navigation/solution"]


def test_the_image_knows_its_version(unit: Unit) -> None:
    assert run("docker", "run", "--rm", "--network=none", "obu:local", "--version") == f"obu {VERSION}\n"


def test_no_process_runs_as_root_or_with_a_capability(unit: Unit) -> None:
    users = [(name.replace(".", "-"), str(CONTAINER_USERS[name])) for name in EXPECTED]
    for service, uid in [*users, ("broker", "1883")]:
        status = dict(
            line.split(":\t", 1) for line in unit.compose("exec", "-T", service, "cat", "/proc/1/status").splitlines()
            if ":\t" in line
        )  # fmt: skip
        assert set(status["Uid"].split()) == {uid}, service
        assert {int(status[key], 16) for key in ("CapEff", "CapPrm", "CapBnd", "CapAmb")} == {0}, service
        assert status["NoNewPrivs"] == "1", service


def test_the_file_system_of_a_container_is_read_only(unit: Unit) -> None:
    attempt = "import pathlib; pathlib.Path('/opt/obu/services/x.py').write_text('')"
    with pytest.raises(AssertionError, match=r"Read-only file system|Permission denied"):
        unit.compose("exec", "-T", "core-fusion", "python", "-c", attempt)
    assert unit.inspect("core-fusion", "{{.HostConfig.ReadonlyRootfs}}") == "true"


def test_only_the_port_of_the_dashboard_is_open(unit: Unit) -> None:
    published = {s for s in [*SERVICES, "broker"] if unit.inspect(s, "{{json .HostConfig.PortBindings}}") != "{}"}
    assert published == {"monitoring-status"}
    assert run("docker", "network", "inspect", "--format", "{{.Internal}}", f"{unit.project}_bus").strip() == "true"


def test_a_killed_process_is_restarted(unit: Unit) -> None:
    before = unit.inspect("core-fusion", "{{.State.StartedAt}}")
    unit.signal("core-fusion", signal.SIGKILL)
    eventually(lambda: unit.inspect("core-fusion", "{{.State.StartedAt}}") != before, within_s=20)
    eventually(unit.is_well, within_s=40)
    assert unit.inspect("core-fusion", "{{.RestartCount}}") == "1"


def test_after_a_kill_of_the_broker_all_processes_reconnect_without_a_restart(unit: Unit) -> None:
    restarts = {service: unit.inspect(service, "{{.RestartCount}}") for service in SERVICES}
    unit.signal("broker", signal.SIGKILL)
    eventually(lambda: unit.inspect("broker", "{{.RestartCount}}") == "1", within_s=20)
    eventually(unit.is_well, within_s=40)
    assert {service: unit.inspect(service, "{{.RestartCount}}") for service in SERVICES} == restarts


def test_the_health_checks_agree(unit: Unit) -> None:
    def healthy() -> bool:
        return {unit.inspect(s, "{{.State.Health.Status}}") for s in [*SERVICES, "broker"]} == {"healthy"}

    eventually(healthy, within_s=75)


@pytest.mark.parametrize(("service", "program"), [("parsers-gnss", "python"), ("broker", "mosquitto")])
def test_what_hangs_is_killed_and_its_container_restarted(unit: Unit, service: str, program: str) -> None:
    before = unit.inspect(service, "{{.State.StartedAt}}")
    unit.stop_program(service, program)
    eventually(lambda: not unit.is_well(), within_s=15)
    eventually(lambda: unit.inspect(service, "{{.State.StartedAt}}") != before, within_s=25)
    eventually(unit.is_well, within_s=40)


def test_the_unit_is_within_its_memory_limit(unit: Unit) -> None:
    names = [f"{unit.project}-{service}-1" for service in [*SERVICES, "broker"]]
    lines = run("docker", "stats", "--no-stream", "--format", "{{.MemUsage}}", *names).splitlines()
    sizes = [line.split("/")[0].strip() for line in lines]
    factors = {"KiB": 2**10, "MiB": 2**20, "GiB": 2**30}
    assert len(sizes) == len(names)
    assert sum(float(size[:-3]) * factors[size[-3:]] for size in sizes) < MEMORY_BYTES


def test_every_process_ends_on_sigterm(unit: Unit) -> None:
    unit.compose("stop", timeout_s=60)
    assert {service: unit.inspect(service, "{{.State.ExitCode}}") for service in SERVICES} == dict.fromkeys(
        SERVICES, "0"
    )
