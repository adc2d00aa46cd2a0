"""What receiving and decoding CAM costs: frames encoded beforehand, over UDP, through sensors.v2x and parsers.v2x."""

import argparse
import json
import math
import os
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import psutil

from benchmarks.bus.hops import Ages
from cli.demo.local import broker_command, free_port
from shared.bus.bus import Bus
from shared.messages.operation import ProcessHealth
from shared.messages.v2x import (
    CamContent,
    CamList,
    DriveDirection,
    LowFrequencyContainer,
    PathPoint,
    StationType,
)
from shared.runtime.config import BrokerAddress
from shared.topics import BY_NAME
from shared.v2x import cam, geonetworking, its_time

RESULTS = Path(__file__).resolve().parents[1] / "results"
MEASURED = ("sensors.v2x", "parsers.v2x")
VEHICLES, RATE_HZ = 200, 10
PATH_POINTS = 10  # in each CAM with a low-frequency container: two of the ten CAM of a second
DELTA_TIME_AT = geonetworking.PAYLOAD_AT + 6  # of generationDeltaTime in a packet: behind the 48 bits of the header
SETTLING_S = 5.0
TITLE = """# Receiving CAM: cost and latency

By `make v2x`: {vehicles} vehicles at {rate} Hz, two of ten CAM with a path of {points} points, over UDP on this machine
({cores} cores, {broker}, {priority} priority). Latency is from the arrival of a frame at the kernel to the arrival of
its CAM at a subscriber of v2x/cam; batches of 20 ms are part of it.

"""


@dataclass(frozen=True)
class Result:
    """One run: what was sent and published, how late, and what it cost."""

    seconds: float
    sent: int
    published: int
    rejects: dict[str, int]
    dropped: int  # by full queues of the two processes
    latency: Ages
    cpu_percent: dict[str, float]  # of one core
    decode_us: float  # of one CAM, in a process that reads v2x/cam


def packets(vehicle: int) -> list[bytes]:
    """Encode one second of a vehicle's CAM; the generation time is put in when they are sent."""
    angle = 2 * math.pi * vehicle / VEHICLES
    content = CamContent(
        station_id=1000 + vehicle,
        station_type=StationType.PASSENGER_CAR,
        latitude_deg=49.44 + 0.003 * math.sin(angle),
        longitude_deg=1.1 + 0.003 * math.cos(angle),
        position_semi_major_m=2.1,
        position_semi_minor_m=1.7,
        position_semi_major_orientation_rad=angle,
        height_ellipsoid_m=120.5,
        height_confidence_m=5.0,
        heading_rad=angle,
        heading_confidence_rad=0.02,
        speed_m_s=30.0,
        speed_confidence_m_s=0.2,
        drive_direction=DriveDirection.FORWARD,
        vehicle_length_m=4.5,
        vehicle_width_m=1.8,
        longitudinal_acceleration_m_s2=-0.4,
        curvature=0.001,
        yaw_rate_rad_s=0.03,
    )
    point = PathPoint(delta_latitude_deg=1e-4, delta_longitude_deg=-1e-4, delta_height_m=0.2, delta_time_s=0.8)
    low = content.model_copy(update={"low_frequency": LowFrequencyContainer(path=(point,) * PATH_POINTS)})
    sender = geonetworking.PositionVector(
        geonetworking.pseudonymous_address(1000 + vehicle), 5, 0, 49.44, 1.1, True, 30.0, angle
    )
    return [
        geonetworking.encode_packet(cam.encode(low if number % 5 == 0 else content, 0), sender)
        for number in range(RATE_HZ)
    ]


def send(port: int, seconds: float) -> int:
    """Send every vehicle's CAM at its rate, evenly over time; return how many."""
    encoded = [packets(vehicle) for vehicle in range(VEHICLES)]
    sent, period_s = 0, 1.0 / (VEHICLES * RATE_HZ)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
        start = time.monotonic()
        while (elapsed := time.monotonic() - start) < seconds:
            stamp = struct.pack(">H", its_time.its_time_ms(time.time_ns()) % its_time.CYCLE_MS)
            while sent * period_s <= elapsed:
                turn, vehicle = divmod(sent, VEHICLES)
                packet = encoded[vehicle][(turn + vehicle) % RATE_HZ]
                radio.sendto(packet[:DELTA_TIME_AT] + stamp + packet[DELTA_TIME_AT + 2 :], ("127.0.0.1", port))
                sent += 1
            time.sleep(0.001)
    return sent


@contextmanager
def running(folder: Path, port: int, broker: str) -> Iterator[dict[str, psutil.Process]]:
    """Run a broker and the measured processes, each a process of its own."""
    broker_port = free_port()
    file = folder / "vehicle.toml"
    file.write_text(f'[vehicle]\nname = "bench"\n\n[sensors.v2x]\ndevice = "udp://127.0.0.1:{port}"\n\n[parsers.v2x]\n')
    environment = os.environ | {
        "OBU_VEHICLE": str(file), "OBU_BROKER": f"mqtt://127.0.0.1:{broker_port}", "OBU_STATE": str(folder)
    }  # fmt: skip
    os.environ["OBU_BROKER"] = environment["OBU_BROKER"]
    commands = {"broker": broker_command(folder, broker_port, broker)}
    commands |= {name: [sys.executable, "-m", "cli", "run", name] for name in MEASURED}
    with (folder / "log").open("w") as log:
        children = {
            name: subprocess.Popen(command, env=environment, stdout=log, stderr=log)
            for name, command in commands.items()
        }
        try:
            yield {name: psutil.Process(child.pid) for name, child in children.items()}
        finally:
            for child in reversed(children.values()):
                child.terminate()
                child.wait(10.0)


def measure(seconds: float, broker: str) -> Result:
    """Send for a while, and listen to what becomes of it."""
    port = free_port()
    with (
        tempfile.TemporaryDirectory() as name,
        running(Path(name), port, broker) as hosts,
        ProcessPoolExecutor(1) as pool,
    ):
        folder = Path(name)
        address = BrokerAddress.parse(os.environ["OBU_BROKER"])
        topics = [BY_NAME["v2x/cam"], BY_NAME["health/+"]]
        listener = Listener(Bus("observer", "bench", address, topics, folder, observer=True))
        listener.wait_for(set(MEASURED))
        settling: Future[int] = pool.submit(send, port, SETTLING_S)
        listener.listen(settling)
        listener.restart()
        before = {name: sum(host.cpu_times()[:2]) for name, host in hosts.items()}
        started = time.monotonic()
        sending: Future[int] = pool.submit(send, port, seconds)
        listener.listen(sending)
        elapsed = time.monotonic() - started
        cpu = {n: round(100 * (sum(host.cpu_times()[:2]) - before[n]) / elapsed, 1) for n, host in hosts.items()}
        return Result(
            seconds=seconds,
            sent=sending.result(),
            published=len(listener.ages_ns),
            rejects=listener.rejects(),
            dropped=sum(health.dropped for health in listener.health.values()),
            latency=Ages.of(listener.ages_ns),
            cpu_percent=cpu,
            decode_us=round(1e6 * listener.decoding_s / max(1, len(listener.ages_ns)), 1),
        )


class Listener:
    """A subscriber of v2x/cam and of the health of the measured processes."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self.health: dict[str, ProcessHealth] = {}
        self._health_before: dict[str, ProcessHealth] = {}
        self.ages_ns: list[int] = []
        self.decoding_s = 0.0

    def wait_for(self, names: set[str]) -> None:
        """Listen until these processes are there."""
        deadline = time.monotonic() + 30.0
        while not names <= self.health.keys():
            if time.monotonic() > deadline:
                raise RuntimeError(f"{names - self.health.keys()} did not start")
            self._take()

    def listen(self, sending: Future[int]) -> None:
        """Listen until a second after the sender has ended."""
        while not sending.done():
            self._take()
        deadline = time.monotonic() + 1.0
        while time.monotonic() < deadline:
            self._take()

    def restart(self) -> None:
        """Forget what was heard so far."""
        self._health_before = dict(self.health)
        self.ages_ns, self.decoding_s = [], 0.0

    def rejects(self) -> dict[str, int]:
        """Rejects of the measured processes since the last restart, by reason."""
        found: dict[str, int] = {}
        for name, health in self.health.items():
            before = self._health_before[name].rejects
            found |= {key: count - before.get(key, 0) for key, count in health.rejects.items()}
        return {key: count for key, count in found.items() if count}

    def _take(self) -> None:
        for envelope in self._bus.receive(0.05):
            started = time.process_time()
            message = envelope.decode()
            if isinstance(message, CamList):
                self.decoding_s += time.process_time() - started
                self.ages_ns += [envelope.received_ns - found.received_ns for found in message.cams]
            elif isinstance(message, ProcessHealth):
                self.health[message.process] = message


def markdown(result: Result, broker: str, priority: str) -> str:
    """Write the result as a page."""
    cores = os.cpu_count() or 1
    lines = [
        TITLE.format(
            vehicles=VEHICLES, rate=RATE_HZ, points=PATH_POINTS, cores=cores, broker=broker, priority=priority
        ),
        "| quantity | value |",
        "| --- | --- |",
        f"| duration | {result.seconds:g} s |",
        f"| frames sent | {result.sent} ({result.sent / result.seconds:.0f} per second) |",
        f"| CAM published | {result.published} |",
        f"| rejected | {', '.join(f'{k} {n}' for k, n in result.rejects.items()) or 'none'} |",
        f"| dropped by full queues | {result.dropped} |",
        f"| latency | median {result.latency.p50_ms:.1f} ms, 99th percentile {result.latency.p99_ms:.1f} ms |",
        *(f"| processor of {name} | {share:.1f} % of a core |" for name, share in result.cpu_percent.items()),
        f"| decoding v2x/cam in a subscriber | {result.decode_us:.1f} us a CAM |",
    ]
    return "\n".join(lines) + "\n"


def take_priority() -> str:
    """Run from now on, with all child processes, at the priority of the hot path in deploy/systemd, if allowed."""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    except PermissionError:
        return "normal"
    return "real-time"


def main(arguments: Sequence[str]) -> int:
    """Measure, print and store the result."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.v2x", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="duration of the measurement")
    parser.add_argument("--broker", choices=("mosquitto", "simulated"), default="mosquitto")
    parser.add_argument("--no-store", action="store_true", help="print only")
    given = parser.parse_args(arguments)
    priority = take_priority()
    result = measure(given.seconds, given.broker)
    text = markdown(result, given.broker, priority)
    print(text)
    if not given.no_store:
        (RESULTS / "v2x.md").write_text(text, encoding="utf-8")
        (RESULTS / "v2x.json").write_text(json.dumps(asdict(result), indent=2) + "\n", encoding="utf-8")
    return 0 if result.published == result.sent else 1
