"""A centre in one object: checks batches as ingest does, keeps them once, and answers with receipts.

Its broker is a real one: nats-server or Mosquitto, with TLS and certificates of vehicles. Between both, a `Courier` may
lose, repeat and reorder messages.
"""

import asyncio
import getpass
import json
import random
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import nats
import paho.mqtt.client as mqtt
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from nats.aio.client import Client
from nats.aio.msg import Msg
from paho.mqtt.enums import CallbackAPIVersion

from cli.demo.local import free_port
from shared.fleet.batch import Batch, Kind, Report
from shared.fleet.receipts import Receipt, RejectedBatch, StoredBatch
from shared.fleet.sealed import chain_digest, receipt_digest, unsealed
from tests.support.fleet.certificates import Authority
from tests.support.fleet.database import missing
from tests.support.patience import HANGS_S


class Memory:
    """What a centre has stored, and whether that is whole."""

    def __init__(self, vehicle: str, *public_keys: bytes) -> None:
        self.vehicle = vehicle
        self.keys = {chain_digest(key)[:8].hex(): Ed25519PublicKey.from_public_bytes(key) for key in public_keys}
        self.batches: dict[tuple[int, int], bytes] = {}
        self.arrivals: Counter[bytes] = Counter()  # by digest
        self.refuse: Callable[[Batch], str | None] = lambda _batch: None

    def receive(self, data: bytes) -> Receipt:
        """Store a batch once; return its receipt."""
        self.arrivals[chain_digest(data)] += 1
        sealed = unsealed(data)
        batch = sealed.batch
        named = batch.epoch_ms, batch.first, receipt_digest(data)
        key = self.keys.get(sealed.key)
        if key is None:
            return Receipt(
                refused=(RejectedBatch(0, 0, receipt_digest(data), "key"),)
            )  # as ingest: nothing is verified
        if not sealed.is_genuine(key, self.vehicle):
            return Receipt(refused=(RejectedBatch(0, 0, receipt_digest(data), "signature"),))
        if (reason := self.refuse(batch)) is not None:
            return Receipt(refused=(RejectedBatch(*named, reason),))
        known = self.batches.setdefault(named[:2], data)
        if known != data and batch.kind is not Kind.GAP:
            return Receipt(refused=(RejectedBatch(*named, "conflict"),))
        self.batches[named[:2]] = data
        return Receipt(stored=(StoredBatch(*named),))

    def chain(self) -> list[Batch]:
        """Batches in the order of their sequence; asserts that none is missing and that each names the one before."""
        found: list[Batch] = []
        for epoch in sorted({epoch for epoch, _ in self.batches}):
            following, previous = 0, bytes(32)
            for (_, first), data in sorted(item for item in self.batches.items() if item[0][0] == epoch):
                batch = unsealed(data).batch
                assert (first, batch.previous) == (following, previous), f"the chain is broken at {first}"
                following = first + batch.count
                previous = chain_digest(data) if batch.gap is None else batch.gap.last
                found.append(batch)
        return found

    def reports(self) -> list[Report]:
        """Every report in the order of the chain."""
        return [report for batch in self.chain() for report in batch.reports]


class Courier:
    """Carries messages, and loses, repeats or holds some back until others have passed them."""

    def __init__(self, lost: float = 0.0, repeated: float = 0.0, held: float = 0.0, seed: int = 34) -> None:
        self._lost, self._repeated, self._held = lost, repeated, held
        self._random = random.Random(seed)
        self._waiting: list[bytes] = []
        self.counts: Counter[str] = Counter()

    def carry(self, data: bytes) -> list[bytes]:
        """Give what arrives now."""
        draw = self._random.random
        if draw() < self._lost:
            self.counts["lost"] += 1
            return []
        if draw() < self._held:
            self.counts["held"] += 1
            self._waiting.append(data)
            return []
        arrived = [data]
        if draw() < self._repeated:
            self.counts["repeated"] += 1
            arrived.append(data)
        if self._waiting and draw() < 0.5:
            arrived += [self._waiting.pop() for _ in range(len(self._waiting))]
        return arrived


class Broker:
    """nats-server or Mosquitto: `port` for vehicles with certificates, `inner_port` for the consumer."""

    def __init__(self, folder: Path, authority: Authority, kind: str = "nats") -> None:
        self.port, self.inner_port = free_port(), free_port()
        self.kind, self._folder = kind, folder
        folder.mkdir(parents=True, exist_ok=True)
        self._command = self._configured(*authority.write(folder, "127.0.0.1"))
        self._process: subprocess.Popen[bytes] | None = None
        self.start()

    def start(self) -> None:
        with (self._folder / "log").open("ab") as log:
            self._process = subprocess.Popen(self._command, stdout=log, stderr=log)
        deadline = time.monotonic() + HANGS_S
        for port in (self.port, self.inner_port):
            while not answers(port):
                assert self._process.poll() is None, (self._folder / "log").read_text()
                assert time.monotonic() < deadline, "the broker does not answer"
                time.sleep(0.02)

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._process = None

    def _configured(self, authority: Path, certificate: Path, key: Path) -> list[str]:
        path = self._folder / "broker.conf"
        if self.kind == "nats":
            program = Path(sys.executable).parent / "nats-server"
            if not program.exists():
                missing("nats-server")
            path.write_text(
                f'listen: "127.0.0.1:{self.inner_port}"\nserver_name: "test"\n'
                f'jetstream {{ store_dir: "{self._folder}/jetstream" }}\n'
                f'mqtt {{ listen: "127.0.0.1:{self.port}", tls {{ cert_file: "{certificate}", key_file: "{key}", '
                f'ca_file: "{authority}", verify: true }} }}\n'
            )
            return [str(program), "-c", str(path)]
        program = Path("/usr/sbin/mosquitto")
        if not program.exists():
            missing("Mosquitto")
        path.write_text(
            f"user {getpass.getuser()}\nper_listener_settings true\n"
            f"listener {self.inner_port} 127.0.0.1\nallow_anonymous true\n"
            f"listener {self.port} 127.0.0.1\ncafile {authority}\ncertfile {certificate}\nkeyfile {key}\n"
            f"require_certificate true\nuse_identity_as_username true\nallow_anonymous true\n"
        )
        return [str(program), "-c", str(path)]


def answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


Take = Callable[[str, bytes], None]


class MqttLine:
    """The consumer's connection to Mosquitto: `take` is called with noun and payload."""

    def __init__(self, port: int, vehicle: str, take: Take) -> None:
        self._prefix = f"obu/{vehicle}/"
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, "consumer", protocol=mqtt.MQTTv311)
        ready = threading.Event()
        self._client.on_connect = lambda client, *_: client.subscribe(f"{self._prefix}#")
        self._client.on_subscribe = lambda *_: ready.set()
        self._client.on_message = lambda _c, _u, message: take(
            message.topic.removeprefix(self._prefix), bytes(message.payload)
        )
        self._client.reconnect_delay_set(1, 1)
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        assert ready.wait(HANGS_S)

    def publish(self, noun: str, data: bytes) -> None:
        self._client.publish(self._prefix + noun, data)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


async def _quiet(_error: Exception) -> None:
    """The server may be ended by a test."""


class NatsLine:
    """The consumer's connection to nats-server, in a thread with a loop of its own."""

    def __init__(self, port: int, vehicle: str, take: Take) -> None:
        self._prefix = f"obu.{vehicle}."
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._client = asyncio.run_coroutine_threadsafe(self._connected(port, take), self._loop).result(HANGS_S)

    async def _connected(self, port: int, take: Take) -> Client:
        client = await nats.connect(
            f"nats://127.0.0.1:{port}", max_reconnect_attempts=-1, reconnect_time_wait=0.1, error_cb=_quiet
        )

        async def arrived(message: Msg) -> None:
            take(message.subject.removeprefix(self._prefix).replace(".", "/"), message.data)

        for noun in ("uplink.batch", "live.>"):
            await client.subscribe(self._prefix + noun, cb=arrived)
        await client.flush()
        return client

    def publish(self, noun: str, data: bytes) -> None:
        sending = self._client.publish(self._prefix + noun.replace("/", "."), data)
        asyncio.run_coroutine_threadsafe(sending, self._loop)

    def close(self) -> None:
        asyncio.run_coroutine_threadsafe(self._client.close(), self._loop).result(HANGS_S)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(HANGS_S)
        self._loop.close()


class SmallCentre:
    """Receives what the courier `up` carries, and answers by what `down` carries."""

    def __init__(self, broker: Broker, memory: Memory, up: Courier | None = None, down: Courier | None = None) -> None:
        self.memory, self.live = memory, list[tuple[str, bytes]]()
        self.is_storing = True  # False: the database is away, and nothing is answered
        self.batches_seen = 0  # stored or not
        self._up, self._down = up or Courier(), down or Courier()
        line = NatsLine if broker.kind == "nats" else MqttLine
        self._line = line(broker.inner_port, memory.vehicle, self._take)

    def watch(self, topics: list[str], for_s: float = 30.0, watchers: int = 1) -> None:
        """Begin, prolong or end a watch session."""
        body = json.dumps({"topics": topics, "for_s": for_s, "watchers": watchers})
        self._line.publish("uplink/watch", body.encode())

    def answer(self, data: bytes) -> None:
        """Send bytes as a receipt."""
        self._line.publish("uplink/receipt", data)

    def close(self) -> None:
        self._line.close()

    def _take(self, noun: str, payload: bytes) -> None:
        if noun.startswith("live/"):
            self.live.append((noun.removeprefix("live/"), payload))
        elif noun == "uplink/batch":
            self.batches_seen += 1
            if not self.is_storing:
                return
            for data in self._up.carry(payload):
                for answer in self._down.carry(self.memory.receive(data).encode()):
                    self.answer(answer)
