"""What one enrolled vehicle can do to the broker that all share: others connect and report all the same."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from paho.mqtt.client import MQTTMessageInfo

from fleet.simulate.processes import kill, pids_of
from shared.evidence.signer import FileSigner
from shared.fleet.enrolling import enrol
from shared.fleet.identity import UplinkIdentity
from tests.support.dashboard.status_server import eventually
from tests.support.fleet.reports import Unit
from tests.support.fleet.vehicle_link import Link, token_for

FILLING = 2700  # messages of 100 kB: more than NATS once had room for
MEMORY_BYTES = 1 << 30  # of NATS, in deploy/compose.centre.yml
Connect = Callable[..., Link]


def enrolled(folder: Path, to: Path, vehicle: str) -> UplinkIdentity:
    return enrol(*token_for(folder, vehicle), vehicle, to / vehicle, FileSigner(vehicle.encode().ljust(32, b".")))


def filled(link: Link, qos: int, count: int = FILLING) -> None:
    """Have the broker keep messages, each of a topic of its own, until it has ended the connection."""
    for number in range(count):
        if link.ended:
            return
        sent = link.client.publish(f"obu/{link.vehicle}/live/x/n{number}", b"x" * 100_000, qos, retain=True)
        if number % 20 == 19:
            eventually(partial(is_over, link, sent))


def is_over(link: Link, sent: MQTTMessageInfo) -> bool:
    return bool(link.ended or sent.rc or sent.is_published())


def has_receipt(unit: Unit, vehicle: Link) -> bool:
    """Whether what a vehicle sends is stored; NATS may have begun before ingest is back."""
    batch = unit.positions()

    def stored() -> bool:
        vehicle.send(unit.vehicle, batch)
        time.sleep(0.2)
        return any(receipt.stored for receipt in vehicle.receipts)

    eventually(stored)
    return stored()


@pytest.mark.slow
def test_what_one_vehicle_has_the_broker_keep_stops_no_other(folder: Path, tmp_path: Path, link: Connect) -> None:
    mallory = enrolled(folder, tmp_path, "mallory-1")
    unit = Unit("bob-1", 41, time.time_ns() // 1_000_000)
    bob = enrol(*token_for(folder, "bob-1"), "bob-1", tmp_path / "bob", unit.signer)
    begun = link(mallory, clean=False)
    assert begun.ready
    begun.client.subscribe([("obu/mallory-1/uplink/receipt", 1), ("obu/mallory-1/uplink/watch", 2)])
    filled(begun, 0)
    assert not begun.ended  # what is retained with QoS 0 is passed on, and not kept
    for qos in (1, 2):
        for _ in range(3):
            filled(link(mallory, clean=False), qos, 20)
    (server,) = pids_of(folder, "nats-server")
    fields = dict(line.split(":", 1) for line in Path(f"/proc/{server}/status").read_text().splitlines())
    assert int(fields["VmHWM"].split()[0]) * 1024 < MEMORY_BYTES
    assert sum(path.stat().st_size for path in (folder / "nats" / "jetstream").rglob("*") if path.is_file()) < 100_000

    vehicle = link(bob)
    assert has_receipt(unit, vehicle)
    assert kill(folder, "nats-server") is not None
    eventually(lambda: vehicle.ended)
    eventually(lambda: pids_of(folder, "nats-server"))
    eventually(lambda: has_come_back(link, bob))
    filled(link(mallory, clean=False), 0, 50)
    again = link(bob)
    assert has_receipt(unit, again)


def has_come_back(link: Connect, identity: UplinkIdentity) -> bool:
    return bool(link(identity).ready)


@pytest.mark.parametrize("client_id", ["bob-2", "mallory-2x", ""])
def test_a_vehicle_connects_by_its_own_client_id_alone(
    folder: Path, tmp_path: Path, link: Connect, client_id: str
) -> None:
    mallory = enrolled(folder, tmp_path, "mallory-2")
    victim = link(enrolled(folder, tmp_path, "bob-2"))
    assert victim.ready
    assert not link(mallory, client_id).ready
    assert not victim.ended
    assert link(mallory).ready


def test_connections_of_one_certificate_replace_one_another(folder: Path, tmp_path: Path, link: Connect) -> None:
    identity = enrolled(folder, tmp_path, "twin-1")
    links = [link(identity) for _ in range(6)]
    eventually(lambda: sum(not link.ended for link in links) <= 1)
    time.sleep(1.0)  # NATS holds a client id that is replaced again and again for a second
    assert link(identity).ready
