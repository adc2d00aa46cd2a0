"""A control centre as `docker compose -f deploy/compose.centre.yml up` runs it.

It takes a minute, and is marked slow: `make containers` runs it. It skips where there is no engine with Compose, or
where the base images can neither be found nor fetched.
"""

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from cli.demo.local import free_port
from fleet.processes import NAMES
from shared.fleet.enrolling import enrol
from shared.fleet.identity import UplinkIdentity
from tests.support.containers import engine_with, eventually, kill, run
from tests.support.data import REPOSITORY
from tests.support.fleet.reports import Unit
from tests.support.fleet.vehicle_link import Link

pytestmark = [pytest.mark.container, pytest.mark.slow]

IMAGES = ("python:3.11-slim-bookworm", "postgis/postgis:15-3.5", "nats:2")
FILES = 4096  # open ones of NATS: an engine in a container may allow fewer than those of the Compose file
SERVICES = ["postgres", "nats", *NAMES]


class ComposeProject:
    """A running Compose project, with ports of its own."""

    def __init__(self, folder: Path) -> None:
        self.project = f"obu-centre-test-{os.getpid()}"
        mqtt, enrolment, web = free_port(), free_port(), free_port()
        settings = (REPOSITORY / "deploy" / "centre.toml").read_text()
        (folder / "centre.toml").write_text(
            f"mqtt_port = {mqtt}\nenrol_port = {enrolment}\nweb_port = {web}\n{settings}"
        )
        mount = f"volumes: ['{folder / 'centre.toml'}:/var/lib/obu-centre/centre.toml:ro']"
        more = {"nats": f"ulimits: {{nofile: {FILES}}}"}
        for name, port in (("nats", mqtt), ("admission", enrolment), ("web", web)):
            ports = f"ports: !override ['127.0.0.1:{port}:{port}']"
            more[name] = f"{more[name]}, {ports}" if name in more else ports
        self._override = folder / "override.yml"
        self._override.write_text(
            "services:\n"
            + "".join(
                f"  {name}: {{{', '.join(part for part in (more.get(name), mount) if part)}}}\n"
                for name in ("prepare", "nats", *NAMES)
            )
        )

    def compose(self, *arguments: str, timeout_s: float = 90.0) -> str:
        files = ("-f", "deploy/compose.centre.yml", "-f", str(self._override))
        return run("docker", "compose", "-p", self.project, *files, *arguments, timeout_s=timeout_s)

    def centre(self, *arguments: str) -> str:
        """Run a command of the operator."""
        return self.compose("exec", "-T", "maintenance", "python", "-m", "cli", "centre", *arguments)

    def inspect(self, service: str, template: str) -> str:
        return run("docker", "inspect", "--format", template, f"{self.project}-{service}-1").strip()

    def runs(self) -> bool:
        return {self.inspect(service, "{{.State.Status}}") for service in SERVICES} == {"running"}

    def is_ready(self) -> bool:
        try:
            return self.runs() and bool(self.centre("tenant", "list"))
        except AssertionError:
            return False  # the schema is being made


@pytest.fixture(scope="module")
def centre(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ComposeProject]:
    engine_with(IMAGES)
    composed = ComposeProject(tmp_path_factory.mktemp("composed"))
    try:
        composed.compose("build", timeout_s=400)
        composed.compose("up", "--detach", timeout_s=120)
        yield composed
    finally:
        composed.compose("down", "--volumes", "--timeout", "5")


@pytest.fixture(scope="module")
def unit() -> Unit:
    return Unit("car-1", 1, time.time_ns() // 1_000_000)


@pytest.fixture(scope="module")
def identity(centre: ComposeProject, unit: Unit, tmp_path_factory: pytest.TempPathFactory) -> UplinkIdentity:
    eventually(centre.is_ready, within_s=60)
    _, _, url, token, *_ = centre.centre("token", "--vehicle", "car-1").split()  # obu enrol URL TOKEN --vehicle NAME
    return enrol(url, token, "car-1", tmp_path_factory.mktemp("car"), unit.signer)


def test_a_vehicle_enrols_and_its_reports_are_stored(
    centre: ComposeProject, unit: Unit, identity: UplinkIdentity
) -> None:
    _send(identity, unit.positions())
    assert "car-1" in centre.centre("vehicles")


def test_no_process_is_root_or_has_a_capability(centre: ComposeProject, identity: UplinkIdentity) -> None:
    for service in NAMES:
        status = dict(
            line.split(":\t", 1) for line in centre.compose("exec", "-T", service, "cat", "/proc/1/status").splitlines()
            if ":\t" in line
        )  # fmt: skip
        assert "0" not in status["Uid"].split(), service
        assert {int(status[key], 16) for key in ("CapEff", "CapPrm", "CapBnd", "CapAmb")} == {0}, service
        assert centre.inspect(service, "{{.HostConfig.ReadonlyRootfs}}") == "true"


def test_what_is_killed_is_back_and_the_next_report_is_stored(
    centre: ComposeProject, unit: Unit, identity: UplinkIdentity
) -> None:
    for service in SERVICES:
        kill(f"{centre.project}-{service}-1", "obu-centre:local", signal.SIGKILL)
    eventually(lambda: all(centre.inspect(name, "{{.RestartCount}}") != "0" for name in SERVICES), within_s=60)
    eventually(centre.runs, within_s=60)
    _send(identity, unit.positions())


def test_all_end_in_time_when_they_are_told(centre: ComposeProject, identity: UplinkIdentity) -> None:
    centre.compose("stop")
    assert {name: centre.inspect(name, "{{.State.ExitCode}}") for name in SERVICES} == dict.fromkeys(SERVICES, "0")


def _send(identity: UplinkIdentity, batch: bytes) -> None:
    """Send one batch until it has its receipt."""

    def receipted() -> bool:
        link = Link(identity)
        try:
            if not link.ready:
                return False
            link.send("car-1", batch)
            until = time.monotonic() + 5.0
            while not link.receipts and time.monotonic() < until:
                time.sleep(0.1)
            return any(receipt.stored for receipt in link.receipts)
        finally:
            link.close()

    eventually(receipted, within_s=90)
