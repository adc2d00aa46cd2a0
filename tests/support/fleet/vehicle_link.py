"""What an operator and a vehicle do with a whole centre."""

import os
import subprocess
import sys
from pathlib import Path

import paho.mqtt.client as mqtt
import psycopg
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.reasoncodes import ReasonCode

from fleet.centre import Centre
from shared.fleet.identity import UplinkIdentity
from shared.fleet.receipts import Receipt
from tests.support.dashboard.status_server import eventually
from tests.support.data import REPOSITORY


def obu(*arguments: str, folder: Path, given: str = "") -> subprocess.CompletedProcess[str]:
    """Run a command of the operator."""
    environment = {**os.environ, "OBU_CENTRE": str(folder)}
    command = [sys.executable, "-m", "cli", *arguments]
    return subprocess.run(
        command, cwd=REPOSITORY, env=environment, input=given, capture_output=True, text=True, check=False
    )


def token_for(folder: Path, vehicle: str) -> tuple[str, str]:
    """Address and token, from the command that an operator gives to a vehicle."""
    done = obu("centre", "token", "--vehicle", vehicle, folder=folder)
    assert done.returncode == 0, done.stderr
    _, _, url, token, _, name = done.stdout.split()
    assert name == vehicle
    return url, token


class Link:
    """A connection of a vehicle to the centre, which does not come back by itself."""

    def __init__(self, identity: UplinkIdentity, client_id: str | None = None, *, clean: bool = True) -> None:
        self.receipts: list[Receipt] = []
        self.ready = self.ended = False
        self.vehicle = identity.centre.vehicle
        self.client = mqtt.Client(
            CallbackAPIVersion.VERSION2,
            self.vehicle if client_id is None else client_id,
            clean_session=clean,
            protocol=mqtt.MQTTv311,
            reconnect_on_failure=False,
        )
        self.client.tls_set(str(identity.authority), str(identity.tls))
        self.client.on_connect = self._connected
        self.client.on_subscribe = self._subscribed
        self.client.on_disconnect = self._disconnected
        self.client.on_message = lambda _c, _u, message: self.receipts.append(Receipt.decode(bytes(message.payload)))
        try:
            self.client.connect(identity.centre.host, identity.centre.mqtt_port)
        except OSError:  # refused during the handshake
            self.ended = True
            return
        self.client.loop_start()
        eventually(lambda: self.ready or self.ended)

    def _connected(self, _client: object, _data: object, _flags: object, reason: ReasonCode, _more: object) -> None:
        if not reason.is_failure:
            self.client.subscribe(f"obu/{self.vehicle}/uplink/receipt")

    def _subscribed(self, *_: object) -> None:
        self.ready = True

    def _disconnected(self, *_: object) -> None:
        self.ended = True

    def send(self, vehicle: str, data: bytes) -> None:
        self.client.publish(f"obu/{vehicle}/uplink/batch", data)

    def close(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()
        if (sock := self.client.socket()) is not None:
            sock.close()


def rows(folder: Path, query: str) -> list[tuple[object, ...]]:
    with psycopg.connect(Centre(folder).owner_dsn) as db:
        return db.execute(query.encode()).fetchall()
