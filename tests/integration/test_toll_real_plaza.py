"""The how-to of a real plaza, followed: no simulator; operator and detector are programs with rights of their own."""

import contextlib
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion

from broker import keys
from cli.demo.local import free_port
from shared.bus.codec import encode, signed
from shared.messages.base import Message, Sender
from shared.messages.toll import LedgerState, TollReceipt, TollRegistration, TollTransaction
from shared.messages.v2x import CamContent
from shared.runtime.config import parse_vehicle
from shared.topics import BY_MESSAGE
from shared.v2x import its_time
from tests.support.bus import brokers
from tests.support.patience import HANGS_S
from tests.support.v2x import cams
from tests.support.v2x.toll import Vehicle, example_plaza

pytestmark = pytest.mark.slow

NS = 1_000_000_000
LIMIT_S = 60.0  # a charge without confirmation is reviewed after 30 s
PLAZA = example_plaza()
PROCESSES = ("sensors.v2x", "sensors.plaza", "parsers.v2x", "core.toll", "monitoring.ledger")
CAR = Vehicle(7, "n2", start=-140.0, speed=20.0, stated_sd=0.3)
# The test has no receiver at a surveyed antenna: the vehicles' receivers have no common error instead.
VEHICLE_TOML = """
[vehicle]
name = "plaza"
role = "rsu"
[sensors.v2x]
device = "udp://127.0.0.1:{radio}"
[sensors.plaza]
detectors = ["udp://127.0.0.1:{detector}"]
camera = "simulated:"
[parsers.v2x]
[core.toll.errors]
common_sd_m = 0.05
vehicle_sd_m = 0.2
"""


@dataclass
class Program:
    """A program at the broker with the user and secret of `obu keys add`."""

    name: str
    role: str
    secret: str
    port: int
    received: list[tuple[str, bytes]] = field(default_factory=list)
    number: int = 0

    def __enter__(self) -> "Program":
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, client_id=self.name)
        self._client.username_pw_set(self.name, self.secret)
        self._client.on_message = lambda _client, _data, message: self.received.append(
            (message.topic, bytes(message.payload))
        )
        self._client.connect("127.0.0.1", self.port)
        self._client.loop_start()
        return self

    def __exit__(self, *_: object) -> None:
        self._client.loop_stop()
        self._client.disconnect()

    def follow(self, topic: str) -> None:
        self._client.subscribe(f"obu/plaza/{topic}", qos=1)

    def publish(self, message: Message) -> None:
        sender = Sender(process=self.role, incarnation=1, sequence=self.number)
        self.number += 1
        topic = BY_MESSAGE[type(message)].name
        self._client.publish(f"obu/plaza/{topic}", signed(encode(message), sender), qos=1)

    def of(self, kind: type[Message]) -> list[Message]:
        name = BY_MESSAGE[kind].name
        return [kind.model_validate_json(payload) for topic, payload in list(self.received) if topic.endswith(name)]


@dataclass
class Site:
    """Ports and secrets of the running unit."""

    port: int
    radio: int
    detector: int
    secrets: dict[str, str]


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    radio, detector = free_port(), free_port()
    text = VEHICLE_TOML.format(radio=radio, detector=detector)
    file = tmp_path / "plaza.toml"
    file.write_text(text)
    vehicle = parse_vehicle(text)
    credentials = tmp_path / "credentials"
    keys.make(credentials, vehicle, keys.KeyFileOwners(str(file), str(tmp_path / "rules")))
    roles = {"back-office": "operator", "loops": "detector", "gateway": "reader"}
    secrets = {name: keys.add_program(credentials, name, role) for name, role in roles.items()}
    broker = brokers.start_closed(brokers.SIMULATED, tmp_path, vehicle)
    environment = os.environ | {"OBU_VEHICLE": str(file), "OBU_BROKER": f"mqtt://127.0.0.1:{broker.port}",
                                "OBU_STATE": str(tmp_path)}  # fmt: skip
    children = [
        subprocess.Popen([sys.executable, "-m", "cli", "run", name], env=environment, stdout=subprocess.DEVNULL)
        for name in PROCESSES
    ]
    try:
        yield Site(broker.port, radio, detector, secrets)
    finally:
        for child in children:
            child.terminate()
        for child in children:
            child.wait(HANGS_S)
        broker.stop()


def until(condition: Callable[[], bool], what: Callable[[], str]) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < deadline, what()
        time.sleep(0.05)


def frame(car: Vehicle, t: float) -> bytes:
    """What the car sends now, if it has driven for t seconds."""
    stated = car.cam(PLAZA, t)
    content = CamContent.model_validate(stated.model_dump(include=set(CamContent.model_fields)))
    return cams.packet(content, its_time.its_time_ms(time.time_ns()))


def test_a_car_is_registered_counted_charged_and_answered_without_a_simulator(site: Site) -> None:
    car = replace(CAR, since=0.0)
    gate_s = -car.start / car.speed
    with contextlib.ExitStack() as stack:
        office = stack.enter_context(Program("back-office", "operator", site.secrets["back-office"], site.port))
        loops = stack.enter_context(Program("loops", "detector", site.secrets["loops"], site.port))
        air = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        for topic in ("toll/transaction", "ledger/state", "toll/seal"):
            office.follow(topic)
        until(lambda: bool(office.of(LedgerState)), lambda: "the ledger publishes its state")
        begin, pulsed = time.monotonic() + 4.0, False  # passages are opened 3 s after a start
        while (t := time.monotonic() - begin) < gate_s + 4.0:
            now_ns = time.time_ns()
            if int(t * 10) % 10 == 0:
                registration = TollRegistration(sampled_ns=now_ns, contract="contract-1", tariff_class="car",
                                                station_id=7, valid_until_ns=now_ns + 60 * NS)  # fmt: skip
                office.publish(registration)
                loops.publish(registration.model_copy(update={"contract": "forged"}))  # it may not
            if t >= 0.0:
                air.sendto(frame(car, t), ("127.0.0.1", site.radio))
            if t >= gate_s and not pulsed:
                air.sendto(b"n2,0,f\n", ("127.0.0.1", site.detector))
                pulsed = True
            time.sleep(0.1)
        until(lambda: bool(office.of(TollTransaction)), lambda: f"a charge: {office.of(LedgerState)[-1]}")
        (charge, *_) = office.of(TollTransaction)
        assert isinstance(charge, TollTransaction)
        assert (charge.contract, charge.lane, charge.confirmed, charge.authenticated) == (
            "contract-1",
            "n2",
            True,
            False,
        )
        office.publish(
            TollReceipt(received_ns=time.time_ns(), transaction_id=charge.transaction_id,
                        passage_id=charge.passage_id, operator="operator", accepted=True)
        )  # fmt: skip

        def answered() -> bool:
            newest = office.of(LedgerState)[-1]
            return isinstance(newest, LedgerState) and newest.transactions == 1 and newest.outbox == 0

        until(answered, lambda: f"the receipt arrives: {office.of(LedgerState)[-1]}")
        assert any(topic.endswith("toll/seal") for topic, _ in office.received), "the operator keeps a seal"
        assert not loops.received
