"""A simulation from the entry of its vehicles to the comparison of the truth list with the database."""

import logging
import resource
import secrets
import shutil
import ssl
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from fleet.admission.authority import Authority
from fleet.centre import Centre
from shared.errors import UserError
from shared.evidence.signer import FileSigner

from . import processes, truth
from .drive import BATCH, PERIOD_MS, reports
from .entering import EnrolledVehicle, enter
from .mqtt import tls_context
from .outboxes import BatchTruth, MemoryOutbox
from .traffic import Disturbance, Traffic, Vehicle
from .unit import Orders, read_truth

log = logging.getLogger(__name__)

ROOT = Path(__file__).parents[2]
UNIT = "unit"
KILLED = (processes.INGEST, processes.POSTGRES, UNIT, processes.NATS)  # in turn
FILES_BESIDE = 200  # open files besides connections
SHOWN_S, SAMPLED_S, LOOK_S = 5.0, 1.0, 0.5
STALL_TIMEOUT_S = 60.0  # without another connection


@dataclass(frozen=True)
class Plan:
    """What is simulated."""

    vehicles: int
    seconds: float = 60.0  # of reports, after all vehicles are connected
    durable: int = 0  # of the vehicles, with outboxes on the disk, in processes that may be killed
    unit_processes: int = 4
    backlog_s: int = 0  # of reports that are there at the start
    kills: int = 0
    disturbance: Disturbance = field(default_factory=Disturbance)
    retry_s: float = 10.0
    drain_s: float = 300.0  # for what has no receipt at the end
    seed: int = 34


@dataclass
class Outcome:
    """What was measured."""

    plan: Plan
    verdict: truth.Verdict
    connected_s: float  # until all vehicles were connected
    drained_s: float | None  # until the backlog had its receipts, from the first connection
    measured_s: float
    reports: int  # with a receipt, in the time that was measured
    cpu_s: dict[str, float]  # of each part of the centre, in that time
    memory_mb: dict[str, float]
    latency_s: tuple[float, float]  # median and 99 %
    bytes_hour: tuple[float, float]  # MQTT from and to a vehicle, in an hour
    kills: Counter[str]
    counts: Counter[str]
    faults: Counter[str]
    waiting: int  # batches without a receipt when the time was up

    @property
    def us_a_report(self) -> dict[str, float]:
        """Processor time of each part [us a report]."""
        return {part: 1e6 * spent / max(self.reports, 1) for part, spent in self.cpu_s.items()}


class _UnitProcess:
    """A process of units that is started again when it was killed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.process: subprocess.Popen[bytes] | None = None
        self.failures = 0

    def look(self) -> bool:
        """Start it if it was killed; give whether it has ended its work. Raises `UserError`."""
        if self.process is not None and (code := self.process.poll()) is not None:
            if code == 0:
                return True
            self.failures += code > 0
            if self.failures > 3:
                raise UserError(f"a process of units fails with {code}; {self.folder / 'log'} says why")
            self.process = None
        if self.process is None:
            with (self.folder / "log").open("ab") as output:
                self.process = subprocess.Popen(
                    [sys.executable, "-m", "fleet.simulate.unit", str(self.folder)],
                    cwd=ROOT, stdin=subprocess.DEVNULL, stdout=output, stderr=output,
                )  # fmt: skip
        return False

    def kill(self) -> bool:
        """End it with SIGKILL; give whether it ran."""
        if self.process is None or self.process.poll() is not None:
            return False
        self.process.kill()
        self.process.wait()
        return True


@dataclass(eq=False)
class _Car:
    number: int
    vehicle: Vehicle
    outbox: MemoryOutbox
    end_ms: int  # of the last report


class Campaign:
    """Runs a plan against the centre of a folder, which `obu centre up` runs."""

    def __init__(self, centre: Centre, plan: Plan, say: Callable[[str], None]) -> None:
        self._centre, self._plan, self._say = centre, plan, say
        self._dsn = centre.owner_dsn
        self._authority = Authority(centre.folder / "authority")
        _raise_limit(plan.vehicles)
        settings = centre.settings
        self._traffic = Traffic((settings.host, settings.mqtt_port), plan.disturbance, plan.seed)
        self._cars: list[_Car] = []
        self._units: list[_UnitProcess] = []
        self._working = list[_UnitProcess]()
        self._end_s = float("inf")
        self._kills: Counter[str] = Counter()
        self._kills_left = plan.kills
        self._shown_s = self._sampled_s = 0.0
        self._meter: processes.Meter | None = None

    def run(self, out: Path | None = None) -> Outcome:
        """Simulate, and compare; raises `UserError`."""
        with self._unit_folder() as folder:
            try:
                outcome = self._simulate(folder)
            finally:
                for unit in self._units:
                    unit.kill()
                self._traffic.close()
            outcome.verdict = self._compared(folder)
        if out is not None:
            truth.write(out, self.made)
        return outcome

    @property
    def made(self) -> list[BatchTruth]:
        """The truth list: every batch of the outboxes in memory."""
        return [made for car in self._cars for made in car.outbox.made]

    def _simulate(self, folder: Path) -> Outcome:
        plan, traffic = self._plan, self._traffic
        entered = self._entered()
        now_ms = time.time_ns() // 1_000_000
        for number, item in enumerate(entered[plan.durable :], plan.durable):
            self._cars.append(self._car(number, item, now_ms))
        self._say(f"{len(self._cars)} vehicles have their reports; connecting")
        joined_s = time.monotonic()
        for car in self._cars:
            traffic.join(car.vehicle)
        self._connect()
        begin_ms, connected_s = time.time_ns() // 1_000_000, time.monotonic() - joined_s
        self._end_s = time.monotonic() + plan.seconds
        self._start_units(folder, entered[: plan.durable], begin_ms)
        self._meter = meter = processes.Meter(self._centre.folder)
        counts = Counter(traffic.counts)
        begin_s = time.monotonic()
        self._plan_work(begin_s)
        drained_s = self._run_until_the_end(joined_s)
        measured_s = time.monotonic() - begin_s
        meter.sample()
        made = Counter(traffic.counts)
        made.subtract(counts)
        waiting = self._drain()
        return Outcome(
            plan, truth.Verdict(), connected_s, drained_s, measured_s, made["receipted"] * BATCH,
            dict(meter.cpu_s), meter.memory_mb, self._latency(),
            self._bytes_hour(made, measured_s), self._kills, traffic.counts, traffic.faults, waiting,
        )  # fmt: skip

    def _run_until_the_end(self, joined_s: float) -> float | None:
        """Give when the backlog had its receipts; None if there is none, or it has not."""
        drained_s = None
        looked_s = time.monotonic()
        while (now_s := time.monotonic()) < self._end_s:
            self._turn("running")
            if drained_s is None and self._plan.backlog_s and now_s > looked_s + LOOK_S:
                drained_s = now_s - joined_s if self._backlog_is_stored() else None
                looked_s = now_s
        return drained_s

    def _entered(self) -> list[EnrolledVehicle]:
        run = secrets.token_hex(2)
        names = [f"s{run}-{number:05d}" for number in range(self._plan.vehicles)]
        self._say(f"entering {len(names)} vehicles, s{run}-00000 and on")
        return list(enter(self._dsn, self._authority, names))

    def _car(self, number: int, entered: EnrolledVehicle, now_ms: int) -> _Car:
        outbox = MemoryOutbox(entered.name, FileSigner(entered.secret), now_ms, self._plan.retry_s)
        begin_ms = now_ms - self._plan.backlog_s * PERIOD_MS
        car = _Car(number, Vehicle(entered.name, outbox, self._tls(entered.tls)), outbox, begin_ms)
        for _ in range(self._plan.backlog_s // BATCH):
            self._make(car)
        return car

    @staticmethod
    def _make(car: _Car) -> None:
        car.end_ms += BATCH * PERIOD_MS
        car.outbox.make(reports(car.number, car.end_ms))

    def _tls(self, pem: str) -> Callable[[], ssl.SSLContext]:
        return lambda: tls_context(self._authority.pem, pem)

    def _start_units(self, folder: Path, entered: list[EnrolledVehicle], now_ms: int) -> None:
        plan, settings = self._plan, self._centre.settings
        for part in range(min(plan.unit_processes, len(entered))):
            vehicles = [
                (number, item.name, item.secret.hex(), item.tls)
                for number, item in enumerate(entered)
                if number % plan.unit_processes == part
            ]
            orders = Orders(
                settings.host, settings.mqtt_port, self._authority.pem, vehicles, plan.disturbance.repeat,
                plan.disturbance.reorder, plan.retry_s, now_ms - plan.backlog_s * PERIOD_MS,
                now_ms + round(plan.seconds * 1000),
            )  # fmt: skip
            orders.write(folder / str(part))
            self._units.append(_UnitProcess(folder / str(part)))
        self._working = list(self._units)

    def _plan_work(self, begin_s: float) -> None:
        """Spread batches over ten seconds, and kills over the whole time."""
        period_s = BATCH * PERIOD_MS / 1000
        for place, car in enumerate(self._cars):
            self._traffic.at(begin_s + period_s * place / len(self._cars), self._batch_of(car))
            self._traffic.at(begin_s, self._tick_of(car))
        for number in range(self._plan.kills):
            when_s = begin_s + self._plan.seconds * (number + 1) / (self._plan.kills + 1)
            self._traffic.at(when_s, self._kill_of(KILLED[number % len(KILLED)]))

    def _batch_of(self, car: _Car) -> Callable[[], None]:
        def work() -> None:
            now_s = time.monotonic()
            if now_s < self._end_s:
                self._make(car)
                self._traffic.pump(car.vehicle)
                self._traffic.at(now_s + BATCH * PERIOD_MS / 1000, work)

        return work

    def _tick_of(self, car: _Car) -> Callable[[], None]:
        def work() -> None:
            self._traffic.pump(car.vehicle)
            self._traffic.alive(car.vehicle)
            self._traffic.at(time.monotonic() + self._plan.retry_s, work)

        return work

    def _kill_of(self, part: str) -> Callable[[], None]:
        def work() -> None:
            if part == UNIT:
                done = sum(unit_process.kill() for unit_process in self._working) > 0
            else:
                done = processes.kill(self._centre.folder, part) is not None
            if done:
                self._kills[part] += 1
                self._say(f"killed: {part}")
            elif part != UNIT or self._working:
                self._traffic.at(time.monotonic() + 0.5, work)  # it is being started again
                return
            self._kills_left -= 1

        return work

    def _turn(self, what: str) -> None:
        self._traffic.turn()
        self._working = [unit_process for unit_process in self._working if not unit_process.look()]
        if self._meter is not None and time.monotonic() > self._sampled_s + SAMPLED_S:
            self._meter.sample()
            self._sampled_s = time.monotonic()
        self._show(what)

    def _show(self, what: str) -> None:
        now_s = time.monotonic()
        if now_s < self._shown_s + SHOWN_S:
            return
        self._shown_s = now_s
        counts, waiting = self._traffic.counts, self._waiting()
        self._say(
            f"{what}: {self._traffic.ready} connections, {counts['sent']} batches sent, {counts['receipted']} with a "
            f"receipt, {waiting} without"
        )

    def _waiting(self) -> int:
        return sum(car.outbox.waiting for car in self._cars)

    def _backlog_is_stored(self) -> bool:
        return all(car.outbox.settled >= self._plan.backlog_s // BATCH for car in self._cars)

    def _drain(self) -> int:
        """Wait for the receipts of everything; give the number of batches that have none when the time is up."""
        until_s = time.monotonic() + self._plan.drain_s
        while (self._waiting() or self._working or self._kills_left) and time.monotonic() < until_s:
            self._turn("draining")
        return self._waiting()

    def _connect(self) -> None:
        """Wait until all are connected; raises `UserError`."""
        most, since_s = 0, time.monotonic()
        while self._traffic.ready < len(self._cars):
            self._turn("connecting")
            if self._traffic.ready > most:
                most, since_s = self._traffic.ready, time.monotonic()
            if time.monotonic() > since_s + STALL_TIMEOUT_S:
                why = "".join(f"{text}; " for text, _ in self._traffic.faults.most_common(1))
                raise UserError(
                    f"{len(self._cars) - most} of {len(self._cars)} vehicles cannot connect: {why}start the centre "
                    "with `obu centre up`, or simulate fewer"
                )

    def _latency(self) -> tuple[float, float]:
        found = sorted(self._traffic.latencies)
        return (found[len(found) // 2], found[len(found) * 99 // 100]) if found else (0.0, 0.0)

    def _bytes_hour(self, counts: Counter[str], seconds: float) -> tuple[float, float]:
        scale = 3600.0 / seconds / max(len(self._cars), 1)
        return counts["bytes out"] * scale, counts["bytes in"] * scale

    def _compared(self, folder: Path) -> truth.Verdict:
        self._say("comparing the truth list with the database")
        found = truth.compared(self._dsn, [car.vehicle.name for car in self._cars], self.made)
        for unit in self._units:
            begun, done = read_truth(unit.folder)
            for vehicle, stamps in done.items():
                found = found.add(truth.chained(self._dsn, vehicle, stamps, begun[vehicle]))
        return found

    @contextmanager
    def _unit_folder(self) -> Iterator[Path]:
        folder = self._centre.folder / "simulate" / secrets.token_hex(4)
        folder.mkdir(mode=0o700, parents=True)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def _raise_limit(vehicles: int) -> None:
    wanted = vehicles + FILES_BESIDE
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < wanted:
        raise UserError(
            f"{vehicles} vehicles need {wanted} open files, and {hard} are allowed; try `ulimit -Hn {wanted}`"
        )
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
