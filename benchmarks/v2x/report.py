"""Cost and latency of 2,000 CAM a second, encoded beforehand, through sensors.v2x, parsers.v2x and core.toll."""

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
from typing import ClassVar

import psutil

from benchmarks import tables
from benchmarks.bus.hops import Ages
from cli.demo.local import free_port, local_broker
from shared.bus.bus import Bus
from shared.maths.earth import Geodetic, geodetic_from_ned_difference
from shared.messages.operation import ProcessHealth
from shared.messages.toll import TollTracks
from shared.messages.v2x import (
    CamContent,
    CamList,
    DriveDirection,
    LowFrequencyContainer,
    PathPoint,
    StationType,
)
from shared.runtime.config import BrokerAddress, load_vehicle
from shared.toll.plaza import Plaza, load_plaza
from shared.topics import BY_NAME
from shared.v2x import cam, geonetworking, its_time

RESULTS = Path(__file__).resolve().parents[1] / "results"
MEASURED = ("sensors.v2x", "parsers.v2x", "core.toll")
VEHICLES, RATE_HZ = 200, 10
PLAZA = Path("deploy/plazas/example.geojson")
SPEED_M_S, GAP_M = 5.0, 17.0  # a slow queue before and behind the gates
PATH_POINTS = 10  # in each CAM with a low-frequency container: two of the ten CAM of a second
HEADER_TIME_AT = geonetworking.POSITION_AT + 8  # behind the address
DELTA_TIME_AT = geonetworking.PAYLOAD_AT + 6  # of generationDeltaTime in a packet: behind the 48 bits of the header
SETTLING_S = 5.0
SECTIONS = "[sensors.traffic]\n"  # the plaza is simulated; the process does not run
TITLE = """# Receiving and tracking CAM: cost and latency

By `make v2x`: {vehicles} vehicles at {rate} Hz, two of ten CAM with a path of {points} points, over UDP on this machine
({cores} cores, {broker}, {priority} priority). Latency is from the arrival of a frame at the kernel to the arrival of
its CAM at a subscriber of v2x/cam, and to that of the tracks which it has updated; batches of 20 ms are part of it.

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
    tracks: int  # in the last message
    track_latency: Ages  # from the arrival of the last frame of a batch to that of the tracks which it has updated
    cpu_percent: dict[str, float]  # of one core
    decode_us: float  # of one CAM, in a process that reads v2x/cam


def vehicles(plaza: Plaza) -> list[tuple[Geodetic, float]]:
    """Places [rad] and headings [rad] at which the vehicles start, one behind the other in every lane."""
    lanes = list(plaza.lanes)
    found = []
    for number in range(VEHICLES):
        (north_0, east_0), (north_1, east_1) = lanes[number % len(lanes)].centre[:2].tolist()
        heading = math.atan2(east_1 - east_0, north_1 - north_0)
        ahead = GAP_M * (number // len(lanes))
        offset = (north_0 + ahead * math.cos(heading), east_0 + ahead * math.sin(heading), 0.0)
        found.append((geodetic_from_ned_difference(offset, plaza.antenna), heading))
    return found


def packet(vehicle: int, start: Geodetic, heading_rad: float, turn: int) -> bytes:
    """Encode one CAM; the generation time is put in when it is sent."""
    travelled_m = SPEED_M_S * turn / RATE_HZ
    offset = (travelled_m * math.cos(heading_rad), travelled_m * math.sin(heading_rad), 0.0)
    place = geodetic_from_ned_difference(offset, start)
    point = PathPoint(delta_latitude_deg=1e-4, delta_longitude_deg=-1e-4, delta_height_m=0.2, delta_time_s=0.8)
    path = LowFrequencyContainer(path=(point,) * PATH_POINTS) if (turn + vehicle) % 5 == 0 else None
    content = CamContent(
        station_id=1000 + vehicle,
        station_type=StationType.PASSENGER_CAR,
        latitude_deg=math.degrees(place.latitude),
        longitude_deg=math.degrees(place.longitude),
        position_semi_major_m=2.1,
        position_semi_minor_m=1.7,
        position_semi_major_orientation_rad=0.3,
        height_ellipsoid_m=place.height,
        height_confidence_m=5.0,
        heading_rad=heading_rad % (2 * math.pi),
        heading_confidence_rad=0.02,
        speed_m_s=SPEED_M_S,
        speed_confidence_m_s=0.2,
        drive_direction=DriveDirection.FORWARD,
        vehicle_length_m=4.5,
        vehicle_width_m=1.8,
        longitudinal_acceleration_m_s2=0.0,
        curvature=0.0,
        yaw_rate_rad_s=0.0,
        low_frequency=path,
    )
    sender = geonetworking.PositionVector(
        mac_address=geonetworking.pseudonymous_address(1000 + vehicle),
        station_type=5,
        its_time_ms=0,
        latitude_deg=math.degrees(place.latitude),
        longitude_deg=math.degrees(place.longitude),
        accurate=True,
        speed_m_s=SPEED_M_S,
        heading_rad=heading_rad,
    )
    return geonetworking.encode_packet(cam.encode(content, 0), sender)


class Sender:
    """Lives in a process of its own: encodes everything beforehand, and sends it evenly over time."""

    encoded: ClassVar[list[bytes]] = []
    sent: ClassVar[int] = 0

    @classmethod
    def prepare(cls, seconds: float) -> None:
        """Encode the CAM of this time, in the order in which they are sent."""
        starts = vehicles(load_plaza(PLAZA))
        turns = range(math.ceil(seconds * RATE_HZ) + 1)
        cls.encoded = [packet(k, *start, turn) for turn in turns for k, start in enumerate(starts)]

    @classmethod
    def send(cls, port: int, seconds: float) -> int:
        """Send for a while, and go on where the last call ended; return how many."""
        first, start = cls.sent, time.monotonic()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
            while (elapsed := time.monotonic() - start) < seconds:
                time_ms = its_time.its_time_ms(time.time_ns())
                stamp = struct.pack(">H", time_ms % its_time.CYCLE_MS)
                header_stamp = struct.pack(">I", time_ms % geonetworking.TIME_CYCLE_MS)
                while (cls.sent - first) / (VEHICLES * RATE_HZ) <= elapsed:
                    data = cls.encoded[cls.sent]
                    header = data[:HEADER_TIME_AT] + header_stamp + data[HEADER_TIME_AT + 4 : DELTA_TIME_AT]
                    radio.sendto(header + stamp + data[DELTA_TIME_AT + 2 :], ("127.0.0.1", port))
                    cls.sent += 1
                time.sleep(0.001)
        return cls.sent - first


@contextmanager
def running(folder: Path, port: int, broker: str, sections: str = SECTIONS) -> Iterator[dict[str, psutil.Process]]:
    """Run a broker and the measured processes, each a process of its own; `sections` are of the vehicle's file."""
    broker_port = free_port()
    file = folder / "vehicle.toml"
    device = f'[sensors.v2x]\ndevice = "udp://127.0.0.1:{port}"\n'
    file.write_text(f'[vehicle]\nname = "bench"\nrole = "rsu"\n\n{device}{sections}')
    started = local_broker(folder, broker_port, broker, load_vehicle(file))
    environment = os.environ | {
        "OBU_VEHICLE": str(file), "OBU_BROKER": started.address.url, "OBU_STATE": str(folder)
    }  # fmt: skip
    os.environ["OBU_BROKER"] = environment["OBU_BROKER"]
    commands = {"broker": started.command}
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
        topics = [BY_NAME["v2x/cam"], BY_NAME["toll/tracks"], BY_NAME["health/+"]]
        listener = Listener(Bus("observer", "bench", address, topics, folder, observer=True))
        listener.wait_for(set(MEASURED))
        listener.listen(pool.submit(Sender.prepare, SETTLING_S + seconds))
        settling: Future[int] = pool.submit(Sender.send, port, SETTLING_S)
        listener.listen(settling)
        listener.restart()
        before = {name: sum(host.cpu_times()[:2]) for name, host in hosts.items()}
        started = time.monotonic()
        sending: Future[int] = pool.submit(Sender.send, port, seconds)
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
            tracks=listener.tracks,
            track_latency=Ages.of(listener.track_ages_ns),
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
        self.tracks = 0
        self.track_ages_ns: list[int] = []
        self.decoding_s = 0.0

    def wait_for(self, names: set[str]) -> None:
        """Listen until these processes are there."""
        deadline = time.monotonic() + 30.0
        while not names <= self.health.keys():
            if time.monotonic() > deadline:
                raise RuntimeError(f"{names - self.health.keys()} did not start")
            self._take()

    def listen(self, sending: Future[int] | Future[None]) -> None:
        """Listen until a second after the other process has ended."""
        while not sending.done():
            self._take()
        deadline = time.monotonic() + 1.0
        while time.monotonic() < deadline:
            self._take()

    def restart(self) -> None:
        """Forget what was received so far."""
        self._health_before = dict(self.health)
        self.ages_ns, self.track_ages_ns, self.decoding_s = [], [], 0.0

    def rejects(self) -> dict[str, int]:
        """Rejects of the measured processes since the last restart, by reason."""
        found: dict[str, int] = {}
        for name, health in self.health.items():
            before = self._health_before[name].rejects
            found |= {key: count - before.get(key, 0) for key, count in health.rejects.items()}
        return {key: count for key, count in found.items() if count}

    def note(self, message: CamList, received_ns: int) -> None:
        """Use a list of CAM."""
        self.ages_ns += [received_ns - cam.received_ns for cam in message.cams]

    def _take(self) -> None:
        for envelope in self._bus.receive(0.05):
            started = time.process_time()
            message = envelope.decode()
            if isinstance(message, CamList):
                self.decoding_s += time.process_time() - started
                self.note(message, envelope.received_ns)
            elif isinstance(message, TollTracks):
                self.tracks = len(message.tracks)
                self.track_ages_ns.append(envelope.received_ns - message.sampled_ns)
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
        f"| frame to CAM | median {result.latency.p50_ms:.1f} ms, 99th percentile {result.latency.p99_ms:.1f} ms |",
        f"| vehicles tracked | {result.tracks} |",
        f"| frame to track | median {result.track_latency.p50_ms:.1f} ms, "
        f"99th percentile {result.track_latency.p99_ms:.1f} ms of {result.track_latency.messages} |",
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
    parser.add_argument("--smoke", action="store_true", help="two seconds, to see that it runs; stores no result")
    given = parser.parse_args(arguments)
    if given.smoke:
        given.seconds, given.no_store = 2.0, True
    priority = take_priority()
    result = measure(given.seconds, given.broker)
    text = markdown(result, given.broker, priority)
    print(text)
    if not given.no_store:
        tables.publish(RESULTS / "v2x.md", text)
        (RESULTS / "v2x.json").write_text(json.dumps(asdict(result), indent=2) + "\n", encoding="utf-8")
    return 0 if result.published == result.sent else 1
