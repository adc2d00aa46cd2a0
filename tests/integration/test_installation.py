"""The unit as deploy/install.sh puts it on a blank Debian with systemd: installed, upgraded, moved, removed.

It takes three minutes a system, and fetches packages, so it is slow and of `make containers`. It skips where there is
no engine, where the system's image can neither be found nor fetched, or where systemd does not start in a container.
"""

from collections.abc import Iterator

import pytest

from tests.support.blank_machine import Machine, blank_machine
from tests.support.containers import eventually

pytestmark = [pytest.mark.container, pytest.mark.slow]

SYSTEMS = ("debian:bookworm-slim", "debian:trixie-slim")
ACCESS_POINT = "/etc/NetworkManager/system-connections/obu-access-point.nmconnection"
BROKEN = "sed -i 's/^class Process:/class Process(:/' services/core/fusion/process.py"
COMMIT = "git -c safe.directory='*' -c user.name=x -c user.email=x@x commit -qam broken"


@pytest.fixture(scope="module", params=SYSTEMS)
def machine(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    with blank_machine(request.param, tmp_path_factory.mktemp("blank")) as found:
        yield found


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
