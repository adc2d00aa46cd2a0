"""A process with a few simulated units whose outbox is that of `monitoring.uplink`; it may be killed at any moment.

    python -m fleet.simulate.unit FOLDER

`FOLDER/units.json` says what it does. Before reports enter an outbox a line "b" with their stamps is written to
`FOLDER/truth`, and a line "d" afterwards: what lies between both at a kill may or may not be stored.
"""

import json
import os
import ssl
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from shared.evidence.signer import FileSigner
from shared.fleet.batch import Report

from .drive import BATCH, PERIOD_MS, reports
from .entering import EnrolledVehicle
from .mqtt import tls_context
from .outboxes import DiskOutbox
from .traffic import Disturbance, Traffic, Vehicle

ORDERS, TRUTH = "units.json", "truth"


@dataclass(frozen=True)
class Orders:
    """What a process does until a time of day, after which it ends when each batch has its receipt."""

    host: str
    port: int
    authority: str  # PEM
    vehicles: list[tuple[int, str, str, str]]  # number, name, secret of the evidence key, TLS key and certificate
    repeat: float
    reorder: bool
    retry_s: float
    begin_ms: int  # of the first report; earlier than now: a backlog
    end_ms: int

    def write(self, folder: Path) -> None:
        """Write them for a process."""
        folder.mkdir(mode=0o700, parents=True)
        with os.fdopen(os.open(folder / ORDERS, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            json.dump(asdict(self), file)

    @classmethod
    def read(cls, folder: Path) -> "Orders":
        """Read what this program has written."""
        return cls(**json.loads((folder / ORDERS).read_text(encoding="utf-8")))


class Truth:
    """The stamps that outboxes were given, in a file that a kill leaves whole."""

    def __init__(self, folder: Path) -> None:
        self.begun, self.done = read_truth(folder)
        self._file = os.open(folder / TRUTH, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)

    def write(self, letter: str, vehicle: str, rows: list[Report]) -> None:
        """Add a line with one system call."""
        os.write(self._file, f"{letter} {vehicle} {' '.join(str(row.utc_ms) for row in rows)}\n".encode())


def read_truth(folder: Path) -> tuple[dict[str, set[int]], dict[str, set[int]]]:
    """Stamps of each vehicle that were begun and that are done."""
    begun, done = defaultdict[str, set[int]](set), defaultdict[str, set[int]](set)
    path = folder / TRUTH
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        letter, vehicle, *stamps = line.split()
        (begun if letter == "b" else done)[vehicle].update(map(int, stamps))
    return begun, done


class Unit:
    """One vehicle of the process."""

    def __init__(self, orders: Orders, entered: EnrolledVehicle, number: int, folder: Path, truth: Truth) -> None:
        self._orders, self._number, self._truth = orders, number, truth
        signer = FileSigner(entered.secret)
        self.outbox = DiskOutbox(folder / f"{entered.name}.sqlite", entered.name, signer, orders.retry_s)
        self.vehicle = Vehicle(entered.name, self.outbox, _tls(orders.authority, entered.tls))
        self._last_ms = max(truth.begun[entered.name], default=orders.begin_ms)
        self._since = 0
        self.ended = False

    def step(self) -> None:
        """Give the outbox what is due, and make a batch of each ten."""
        until_ms = min(time.time_ns() // 1_000_000, self._orders.end_ms)
        while (due := (until_ms - self._last_ms) // PERIOD_MS) > 0:
            count = min(due, BATCH - self._since)
            rows = reports(self._number, self._last_ms + count * PERIOD_MS, count)
            self._last_ms = rows[-1].utc_ms
            self._truth.write("b", self.vehicle.name, rows)
            self.outbox.add(rows)
            self._truth.write("d", self.vehicle.name, rows)
            self._since += count
            if self._since == BATCH:
                self.outbox.flush()
                self._since = 0
        if time.time_ns() // 1_000_000 >= self._orders.end_ms and not self.ended:
            self.outbox.flush()
            self.ended = True

    @property
    def is_empty(self) -> bool:
        """Whether everything has its receipt."""
        return self.ended and not self.outbox.waiting


def run(folder: Path) -> None:
    """Work until the end, and until each batch has its receipt."""
    orders, truth = Orders.read(folder), Truth(folder)
    traffic = Traffic((orders.host, orders.port), Disturbance(orders.repeat, orders.reorder), os.getpid())
    units = [
        Unit(orders, EnrolledVehicle(name, bytes.fromhex(secret), tls), number, folder, truth)
        for number, name, secret, tls in orders.vehicles
    ]

    def tick(unit: Unit) -> None:
        unit.step()
        traffic.pump(unit.vehicle)
        traffic.alive(unit.vehicle)
        traffic.at(time.monotonic() + min(1.0, orders.retry_s), lambda: tick(unit))

    for unit in units:
        traffic.join(unit.vehicle)
        tick(unit)
    while not all(unit.is_empty for unit in units):
        traffic.turn()
    traffic.close()


def _tls(authority: str, pem: str) -> Callable[[], ssl.SSLContext]:
    return lambda: tls_context(authority, pem)


if __name__ == "__main__":
    run(Path(sys.argv[1]))
