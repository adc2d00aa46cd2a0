"""Cost and latency of signed CAM, and a flood of forged tickets: `python -m benchmarks.v2x.signed`."""

import argparse
import json
import os
import random
import socket
import struct
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import ClassVar

from benchmarks import tables
from benchmarks.bus.hops import Ages
from benchmarks.v2x.report import (
    DELTA_TIME_AT,
    HEADER_TIME_AT,
    MEASURED,
    RATE_HZ,
    RESULTS,
    SECTIONS,
    Listener,
    running,
    take_priority,
    vehicles,
)
from benchmarks.v2x.report import PLAZA as PLAZA_FILE
from benchmarks.v2x.report import packet as plain_packet
from cli.demo.local import free_port
from shared.bus.bus import Bus
from shared.messages.v2x import Authentication, CamList
from shared.runtime.config import BrokerAddress
from shared.toll.plaza import load_plaza
from shared.topics import BY_NAME
from shared.v2x import geonetworking, its_time
from shared.v2x.security.issuing.signing import Holder, sign_packet
from tests.support.v2x.signing import Pki

CERTIFICATE_EVERY = 5  # frames of a vehicle: two a second, twice as often as stations send it
MS = 1_000_000
SETTLED_NS = 1_000 * MS
LEAD_S = 2.0  # from the end of the preparation to the first frame
TITLE = """# Receiving signed CAM: cost and latency

By `python -m benchmarks.v2x.signed`: vehicles at 10 Hz, a certificate in every fifth frame, each of a ticket of its
own, over UDP on this machine ({cores} cores, {broker}, {priority} priority). Latency is from the arrival of a frame at
the kernel to that of its CAM at a subscriber of v2x/cam, without the first second, in which frames wait for
certificates. The flood is of 20,000 tickets that name the trusted authority and that it has not signed, beside 40
vehicles.

| quantity | {columns} |
| --- |{rule}
"""


@dataclass(frozen=True)
class Load:
    """What is sent."""

    name: str
    curve: str
    vehicles: int
    flood_s: int = 0  # frames a second, each with a new ticket


LOADS = (
    Load("P-256", "ecdsaNistP256", 120),
    Load("brainpoolP256r1", "ecdsaBrainpoolP256r1", 80),
    Load("P-384", "ecdsaNistP384", 40),
    Load("flood", "ecdsaNistP256", 40, flood_s=1000),
)


@dataclass(frozen=True)
class Result:
    """One run."""

    name: str
    seconds: float
    sent: int  # of the vehicles
    flooded: int
    authenticated: int
    others: dict[str, int]  # CAM that are not, by the reason
    rejects: dict[str, int]
    dropped: int
    latency: Ages  # of authenticated CAM
    cpu_percent: dict[str, float]  # of one core
    parser_mib: float


class Sender:
    """Lives in a process of its own: signs everything beforehand for the times at which it is sent."""

    frames: ClassVar[list[tuple[int, bytes]]] = []  # UTC [ns] and frame

    @classmethod
    def prepare(cls, load: Load, folder: str, seconds: float) -> int:
        """Sign the frames of this time; return the UTC [ns] of the first."""
        now_s = its_time.its_time_ms(time.time_ns()) // 1000
        pki = Pki.make(now_s, load.curve)
        pki.write(Path(folder))
        tickets = [pki.ticket(f"vehicle {k}", load.curve) for k in range(load.vehicles)]
        starts = vehicles(load_plaza(PLAZA_FILE))[: load.vehicles]
        turns = range(round(seconds * RATE_HZ))
        count = load.vehicles * len(turns) + load.flood_s * round(seconds)
        start_ns = time.time_ns() + round((LEAD_S + 0.0015 * count) * 1e9)
        cls.frames = []
        for turn in turns:
            for k, (start, ticket) in enumerate(zip(starts, tickets, strict=True)):
                utc_ns = start_ns + round((turn + k / load.vehicles) / RATE_HZ * 1e9)
                plain = stamped(plain_packet(k, *start, turn), utc_ns)
                is_whole = (turn + k) % CERTIFICATE_EVERY == 0
                cls.frames.append((utc_ns, signed(plain, ticket, utc_ns, is_whole=is_whole)))
        cls.frames += cls._flood(load, pki, starts[0], start_ns, round(seconds))
        cls.frames.sort()
        if time.time_ns() > start_ns:
            raise RuntimeError("signing took longer than planned")
        return start_ns

    @staticmethod
    def _flood(
        load: Load, pki: Pki, start: tuple[object, float], start_ns: int, seconds: int
    ) -> list[tuple[int, bytes]]:
        """Frames with tickets that no authority has signed: random bytes in the place of the authority's signature."""
        chance = random.Random(1)
        ticket = pki.ticket("flood", load.curve)
        real = ticket.certificate.encoded
        found = []
        for k in range(load.flood_s * seconds):
            utc_ns = start_ns + round(k / load.flood_s * 1e9)
            if k % (load.flood_s // 10) == 0:
                plain = stamped(plain_packet(5000, *start, 0), utc_ns)  # type: ignore[arg-type]
                whole = signed(plain, ticket, utc_ns, is_whole=True)
            forged = real[:-64] + chance.randbytes(64)
            found.append((utc_ns, whole.replace(real, forged)))
        return found

    @classmethod
    def send(cls, port: int) -> int:
        """Send each frame at its time; return the largest delay [ns]."""
        late_ns = 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
            for utc_ns, frame in cls.frames:
                while (now_ns := time.time_ns()) < utc_ns:
                    time.sleep(min((utc_ns - now_ns) * 1e-9, 0.001))
                late_ns = max(late_ns, now_ns - utc_ns)
                radio.sendto(frame, ("127.0.0.1", port))
        return late_ns


def stamped(packet: bytes, utc_ns: int) -> bytes:
    """Set the times of header and CAM."""
    time_ms = its_time.its_time_ms(utc_ns)
    header = struct.pack(">I", time_ms % geonetworking.TIME_CYCLE_MS)
    delta = struct.pack(">H", time_ms % its_time.CYCLE_MS)
    return (
        packet[:HEADER_TIME_AT] + header + packet[HEADER_TIME_AT + 4 : DELTA_TIME_AT] + delta
        + packet[DELTA_TIME_AT + 2 :]
    )  # fmt: skip


def signed(packet: bytes, ticket: Holder, utc_ns: int, *, is_whole: bool) -> bytes:
    """Sign a packet at a time."""
    return sign_packet(packet, ticket, its_time.its_time_ms(utc_ns) * 1000, with_certificate=is_whole)


class SignedListener(Listener):
    """Tells CAM by what is known of their senders."""

    def __init__(self, bus: Bus) -> None:
        super().__init__(bus)
        self.states: Counter[str] = Counter()
        self.settled_ns = 0  # from then on every certificate has been sent

    def note(self, message: CamList, received_ns: int) -> None:
        """Count the CAM of a list; the latency is that of authenticated ones."""
        for cam in message.cams:
            if cam.authentication is Authentication.AUTHENTICATED and cam.received_ns > self.settled_ns:
                self.ages_ns.append(received_ns - cam.received_ns)
            self.states[cam.unverified or cam.authentication] += 1


def measure(load: Load, seconds: float, broker: str) -> Result:
    """Send for a while, and listen to what becomes of it."""
    port = free_port()
    with tempfile.TemporaryDirectory() as name, ProcessPoolExecutor(1) as pool:
        folder = Path(name)
        trust = folder / "trust"
        start_ns = pool.submit(Sender.prepare, load, str(trust / "test"), seconds).result()
        sections = f'{SECTIONS}[parsers.v2x.security]\ntrust_folder = "{trust}"\n'
        with running(folder, port, broker, sections) as hosts:
            address = BrokerAddress.parse(os.environ["OBU_BROKER"])
            topics = [BY_NAME["v2x/cam"], BY_NAME["health/+"]]
            listener = SignedListener(Bus("observer", "bench", address, topics, folder, observer=True))
            listener.wait_for(set(MEASURED))
            if time.time_ns() > start_ns:
                raise RuntimeError("the processes started later than planned")
            listener.restart()
            listener.settled_ns = start_ns + SETTLED_NS
            before = {host: sum(process.cpu_times()[:2]) for host, process in hosts.items()}
            sending: Future[int] = pool.submit(Sender.send, port)
            listener.listen(sending)
            cpu = {
                host: round(100 * (sum(process.cpu_times()[:2]) - before[host]) / seconds, 1)
                for host, process in hosts.items()
            }
            states = dict(listener.states)
            return Result(
                name=load.name,
                seconds=seconds,
                sent=load.vehicles * round(seconds * RATE_HZ),
                flooded=load.flood_s * round(seconds),
                authenticated=states.pop(Authentication.AUTHENTICATED, 0),
                others=states,
                rejects=listener.rejects(),
                dropped=sum(health.dropped for health in listener.health.values()),
                latency=Ages.of(listener.ages_ns),
                cpu_percent=cpu,
                parser_mib=round(hosts["parsers.v2x"].memory_info().rss / 2**20, 1),
            )


def markdown(results: Sequence[Result], broker: str, priority: str) -> str:
    """Write the results as a page."""
    rows: list[tuple[str, list[str]]] = [
        ("duration", [f"{one.seconds:g} s" for one in results]),
        ("signed CAM sent", [f"{one.sent} ({one.sent / one.seconds:.0f} per second)" for one in results]),
        ("frames of the flood", [str(one.flooded) for one in results]),
        ("authenticated", [str(one.authenticated) for one in results]),
        ("not authenticated", [_counts(one.others) for one in results]),
        ("rejected", [_counts(one.rejects) for one in results]),
        ("dropped by full queues", [str(one.dropped) for one in results]),
        ("frame to CAM, median", [f"{one.latency.p50_ms:.1f} ms" for one in results]),
        ("frame to CAM, 99th percentile", [f"{one.latency.p99_ms:.1f} ms" for one in results]),
        *((f"processor of {host}", [f"{one.cpu_percent[host]:.1f} %" for one in results]) for host in MEASURED),
        ("memory of parsers.v2x", [f"{one.parser_mib:.0f} MiB" for one in results]),
    ]
    title = TITLE.format(
        cores=os.cpu_count(), broker=broker, priority=priority, columns=" | ".join(one.name for one in results),
        rule=" --- |" * len(results),
    )  # fmt: skip
    return title + "".join(f"| {name} | {' | '.join(values)} |\n" for name, values in rows)


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in sorted(counts.items())) or "none"


def main(arguments: Sequence[str]) -> int:
    """Measure, print and store the result."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.v2x.signed", description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="duration of each measurement")
    parser.add_argument("--broker", choices=("mosquitto", "simulated"), default="mosquitto")
    parser.add_argument("--no-store", action="store_true", help="print only")
    parser.add_argument("--smoke", action="store_true", help="two seconds of few vehicles; stores no result")
    given = parser.parse_args(arguments)
    loads: Sequence[Load] = LOADS
    if given.smoke:
        given.seconds, given.no_store = 2.0, True
        loads = [replace(load, vehicles=10, flood_s=load.flood_s and 100) for load in LOADS]
    priority = take_priority()
    results = [measure(load, given.seconds, given.broker) for load in loads]
    text = markdown(results, given.broker, priority)
    print(text)
    if not given.no_store:
        tables.publish(RESULTS / "v2x_signed.md", text)
        stored = json.dumps([asdict(one) for one in results], indent=2)
        (RESULTS / "v2x_signed.json").write_text(stored + "\n", encoding="utf-8")
    return 0 if all(one.authenticated == one.sent for one in results) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
