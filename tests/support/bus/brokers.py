"""Both brokers behind one interface, for tests that must hold on each: `start(kind, folder)`."""

from pathlib import Path
from typing import Protocol

import pytest

from broker import acl, keys
from shared.runtime.config import VehicleFile

SIMULATED = "simulated"
MOSQUITTO = "mosquitto"
KINDS = (pytest.param(SIMULATED), pytest.param(MOSQUITTO, marks=pytest.mark.broker))


class RunningBroker(Protocol):
    """A broker on a free port of 127.0.0.1."""

    kind: str
    port: int

    def stop(self) -> None:
        """End it in an orderly way; may be called again."""

    def restart(self) -> None:
        """End it if it runs, and start it again on the same port with its saved messages."""


def start(kind: str, folder: Path, rights: str | None = None) -> RunningBroker:
    """Start a broker with its files in `folder`, with the access list of the unit or a given text."""
    from tests.support.bus import mosquitto, simulated

    return simulated.start(folder, rights) if kind == SIMULATED else mosquitto.start(folder, rights)


def start_closed(kind: str, folder: Path, vehicle: VehicleFile) -> RunningBroker:
    """Start a broker as on a vehicle: with secrets, in `folder / "credentials"`, which `Bus` finds there."""
    from tests.support.bus import mosquitto, simulated

    _, rights = keys.make(folder / "credentials", vehicle, keys.KeyFileOwners(vehicle.path, str(folder / "rules")))
    return simulated.start_closed(folder, rights) if kind == SIMULATED else mosquitto.start_closed(folder, rights)


def access_list(folder: Path, text: str | None) -> Path:
    """Write an access list into the folder; without a text, that of every process in any vehicle."""
    path = folder / "acl.conf"
    path.write_text(acl.access_list() if text is None else text)
    path.chmod(0o600)
    return path
