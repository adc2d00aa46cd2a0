"""The simulated broker in a thread of the test."""

from pathlib import Path

from broker import simulated
from broker.passwords import Passwords
from tests.support.bus import brokers


class SimulatedMosquitto:
    """The simulated broker; retained messages are lost when it stops."""

    kind = brokers.SIMULATED

    def __init__(self, acl: str, passwords: Passwords | None = None) -> None:
        self._acl, self._passwords = acl, passwords
        self.handle = simulated.start(acl=simulated.parse(acl), passwords=passwords)
        self.port = self.handle.port

    def stop(self) -> None:
        """End it."""
        self.handle.stop()

    def restart(self) -> None:
        """Start it again, empty, on the same port."""
        self.stop()
        self.handle = simulated.start(self.port, acl=simulated.parse(self._acl), passwords=self._passwords)


def start(folder: Path, acl: str | None = None) -> SimulatedMosquitto:
    """Start one with the unit's access list, or with the text of another."""
    return SimulatedMosquitto(brokers.access_list(folder, acl).read_text())


def start_closed(folder: Path, acl: Path) -> SimulatedMosquitto:
    """Start one with the access list and the password file beside it."""
    return SimulatedMosquitto(acl.read_text(), Passwords((acl.parent / "passwords").read_text()))
