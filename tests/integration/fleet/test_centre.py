"""A whole centre as `obu centre up` runs it, and a vehicle that enrols and reports."""

import time
from collections.abc import Callable
from pathlib import Path

import paho.mqtt.client as mqtt
import psycopg
import pytest
from paho.mqtt.enums import CallbackAPIVersion

from fleet.centre import Centre
from shared.errors import UserError
from shared.evidence.signer import FileSigner
from shared.fleet.enrolling import enrol, renew
from shared.fleet.identity import UplinkIdentity
from shared.fleet.receipts import Receipt, StoredBatch
from shared.fleet.sealed import receipt_digest
from tests.support.dashboard.status_server import eventually
from tests.support.fleet.reports import Unit
from tests.support.fleet.vehicle_link import Link, rows, token_for


def test_an_enrolled_vehicle_reports_and_has_a_receipt_after_the_commit(
    folder: Path, tmp_path: Path, link: Callable[[UplinkIdentity], Link]
) -> None:
    unit = Unit("car-1", 1, time.time_ns() // 1_000_000)
    url, token = token_for(folder, "car-1")
    vehicle = link(enrol(url, token, "car-1", tmp_path, unit.signer))
    batch = unit.positions([0, 0, 5])
    vehicle.send("car-1", batch)
    eventually(lambda: vehicle.receipts)
    assert vehicle.receipts == [Receipt((StoredBatch(unit.epoch_ms, 0, receipt_digest(batch)),))]
    vehicle.send("car-1", batch)
    eventually(lambda: len(vehicle.receipts) == 2)
    assert vehicle.receipts[0] == vehicle.receipts[1]
    assert rows(folder, "SELECT vehicle, sequence, verdict FROM vehicle_now WHERE vehicle = 'car-1'") == [
        ("car-1", 2, 5)
    ]
    assert rows(folder, "SELECT count(*) FROM segment WHERE vehicle = 'car-1'") == [(1,)]


def test_a_topic_of_another_vehicle_does_not_arrive_and_a_foreign_signature_is_refused(
    folder: Path, tmp_path: Path, link: Callable[[UplinkIdentity], Link]
) -> None:
    now_ms = time.time_ns() // 1_000_000
    thief, victim = Unit("car-2", 2, now_ms), Unit("car-3", 3, now_ms)
    mine = enrol(*token_for(folder, "car-2"), "car-2", tmp_path / "2", thief.signer)
    enrol(*token_for(folder, "car-3"), "car-3", tmp_path / "3", victim.signer)
    vehicle = link(mine)
    vehicle.send("car-3", victim.positions())  # closes nothing: the server drops it
    thief.signer = FileSigner(b"x" * 32)
    vehicle.send("car-2", thief.positions())
    vehicle.send("car-2", victim.positions())
    refused: list[str] = []

    def both_are_refused() -> bool:
        refused[:] = [refused.reason for receipt in vehicle.receipts for refused in receipt.refused]
        return len(refused) == 2

    eventually(both_are_refused)
    assert sorted(refused) == ["key", "vehicle"]
    assert rows(
        folder,
        "SELECT vehicle, detail->>'reason' FROM alarm WHERE kind = 'signature' AND vehicle IN ('car-2', 'car-3')",
    ) == [("car-2", "vehicle")]
    assert rows(folder, "SELECT count(*) FROM segment WHERE vehicle IN ('car-2', 'car-3')") == [(0,)]


@pytest.mark.parametrize("spoilt", ["used", "other name", "unknown", "foreign centre"])
def test_a_token_is_for_one_vehicle_once(folder: Path, tmp_path: Path, spoilt: str) -> None:
    name = f"car-{spoilt.replace(' ', '-')}"
    url, token = token_for(folder, name)
    if spoilt == "used":
        enrol(url, token, name, tmp_path, FileSigner(b"a" * 32))
    if spoilt == "unknown":
        token = "x" + token
    if spoilt == "foreign centre":
        token = token.rpartition(".")[0] + "." + "0" * 32
    with pytest.raises(UserError, match=r"another one|obu enrol --name|another token"):
        enrol(url, token, "car-x" if spoilt == "other name" else name, tmp_path / "again", FileSigner(b"b" * 32))
    assert not (tmp_path / "again").exists()


def test_a_renewal_is_another_key_and_registers_another_evidence_key(folder: Path, tmp_path: Path) -> None:
    first = enrol(*token_for(folder, "car-9"), "car-9", tmp_path, FileSigner(b"c" * 32))
    before = first.tls.read_bytes()
    second = renew(first, FileSigner(b"d" * 32))
    assert second.tls.read_bytes() != before
    assert second.centre.evidence_key == FileSigner(b"d" * 32).key_id
    found = rows(folder, "SELECT kind FROM certificate WHERE vehicle = 'car-9' ORDER BY kind")
    assert found == [("evidence",), ("evidence",), ("tls",), ("tls",)]


def test_a_revoked_vehicle_neither_connects_nor_renews(
    folder: Path, tmp_path: Path, link: Callable[[UplinkIdentity], Link]
) -> None:
    identity = enrol(*token_for(folder, "car-8"), "car-8", tmp_path, FileSigner(b"e" * 32))
    with psycopg.connect(Centre(folder).owner_dsn) as db:
        db.execute("UPDATE certificate SET revoked = now() WHERE vehicle = 'car-8'")
    with pytest.raises(UserError, match="revoked"):
        renew(identity, FileSigner(b"e" * 32))
    assert not link(identity).ready


def test_without_a_certificate_or_encryption_nobody_connects(folder: Path, tmp_path: Path) -> None:
    identity = enrol(*token_for(folder, "car-7"), "car-7", tmp_path, FileSigner(b"f" * 32))
    bare = mqtt.Client(CallbackAPIVersion.VERSION2, "car-7", protocol=mqtt.MQTTv311)
    bare.tls_set(str(identity.authority))
    plain = mqtt.Client(CallbackAPIVersion.VERSION2, "car-7", protocol=mqtt.MQTTv311)
    for client in (bare, plain):
        connected: list[object] = []
        client.on_connect = lambda _c, _u, _f, reason, _p, to=connected: to.append(reason)
        try:
            client.connect(identity.centre.host, identity.centre.mqtt_port)
            deadline = time.monotonic() + 2.0
            while time.monotonic() < deadline and client.loop(0.1) == mqtt.MQTT_ERR_SUCCESS:
                pass
        except OSError:
            pass  # refused during the handshake
        assert connected == []
