"""Charges under loss, repetition, reordering and kills: `python -m benchmarks.toll_campaign`.

The simulated plaza, `parsers.v2x`, `parsers.gnss`, `core.toll` and the ledger run in one thread on simulated time. A
kill ends `core.toll` before or after one of its statements, or the ledger before one of its database statements, before
a commit, or before it publishes; the steps are drawn in turns. What was on the way to the dead process is lost, as on a
bus without sessions. The next life begins 0.5 to 2 s later, with the retained delta position.

A passage is decided where `core.toll` has found the lane of its crossing, whether or not that statement arrived. The
vehicles of the first 30 s, before the first delta position, drive on an unprepared plaza and are not counted. The
simulated road begins 150 m before the approach line and ends 90 m behind the exit line.

The campaign is made of parts of 580 passages and 12 kills, with a ledger and a seed each.
"""

import argparse
import json
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import tables
from cli.campaign import Job, Size, options_of, run, worth_storing
from services.core.toll.process import Config as TollConfig
from services.core.toll.process import Process as Toll
from services.monitoring.ledger.ledger import Ledger, Settings
from services.monitoring.ledger.store import Store, Value
from services.parsers.gnss.process import Config as GnssConfig
from services.parsers.gnss.process import Process as GnssParser
from services.parsers.v2x.process import Config as V2xConfig
from services.parsers.v2x.process import Process as V2xParser
from services.sensors.traffic.operator import Operator
from services.sensors.traffic.world import Channel, Frame, Traffic, World
from shared.evidence import KeyFile
from shared.messages.base import Message, Tick
from shared.messages.gnss import GnssFix, GnssRaw
from shared.messages.toll import (
    PlazaDetector,
    PlazaTruth,
    TollDelta,
    TollPassage,
    TollReceipt,
    TollRegistration,
    TrafficPassage,
    TransactionKind,
    UsedCams,
)
from shared.messages.v2x import CamFrames, CamList, Encapsulation
from shared.toll.plaza import Lane, Plaza, along, load_plaza, plaza_path
from shared.v2x import frames

NS = 1_000_000_000
BATCH_NS = 100_000_000  # of what is delivered together; each frame keeps its own time of arrival
SECOND_STEPS = NS // BATCH_NS
START_NS = 1_790_000_000 * NS
SIZE = Size(short=1, usual=20, full=20, unit="parts")
PASSAGES, KILLS, VEHICLES = 580, 12, 100  # of a part
PLAZA_FILE = Path("deploy/plazas/example.geojson")
DRAIN_S = 330.0
ANSWERS_LOST = 0.05
CORE_STEPS = tuple(
    f"core.toll {side} {event}"
    for event in ("open", "checkpoint", "crossed", "charged", "undecided")
    for side in ("before", "after")
)
LEDGER_STEPS = tuple(
    f"ledger before {step}"
    for step in (
        "INSERT INTO registration", "INSERT OR IGNORE INTO pulse", "INSERT OR REPLACE INTO passage", "UPDATE settled",
        "INSERT INTO booking", "INSERT INTO outbox", "INSERT INTO evidence", "DELETE FROM passage",
        "INSERT INTO settled", "INSERT INTO crossing", "INSERT OR IGNORE INTO receipt", "DELETE FROM outbox",
        "INSERT INTO balance", "UPDATE pulse", "DELETE FROM crossing", "COMMIT", "publishing a transaction",
        "publishing a review", "UPDATE review", "publishing open passages",
    )
)  # fmt: skip
WARM_UP_NS = 30 * NS
PATIENCE_NS = 5 * NS  # for the step of a kill; then another one is drawn
BEFORE_M, BEHIND_M = 150.0, 90.0  # of the approach and the exit line: the simulated road
RESULTS = Path(__file__).parent / "results"
EXPLANATION = Path(__file__).parents[1] / "docs/explanation/charging.md"
BEGIN, END = "<!-- printed by `python -m benchmarks.toll_campaign` -->\n", "<!-- end -->\n"
TITLE = """# Charging under kills

By `python -m benchmarks.toll_campaign`: simulated vehicles on the example plaza, 5 % of the frames lost, 2 % repeated,
5 % delayed by up to 1 s; `core.toll` or the ledger is killed at each of its steps.

"""


class ProcessKilled(Exception):
    """The process was killed here."""


def batches(world: World) -> Iterator[tuple[int, list[tuple[int, Frame | Message]]]]:
    """Cut what a simulated plaza sends into what is delivered together, with the time [ns] of the end of each."""
    now_ns = START_NS
    batch: list[tuple[int, Frame | Message]] = []
    for due_ns, item in world:
        while due_ns >= now_ns + BATCH_NS:
            now_ns += BATCH_NS
            yield now_ns, batch
            batch = []
        batch.append((due_ns, item))


@dataclass
class Result:
    """What a campaign amounted to."""

    passages: int = 0
    registered: int = 0
    charged: int = 0
    double_charges: int = 0
    wrong_charges: int = 0  # of a contract that has not passed
    lanes_right: int = 0
    decided: int = 0  # registered, and core.toll has found the lane
    in_review: int = 0  # registered, and left to a person: not derivable, of two contracts, or ghosts
    decided_uncharged: dict[str, int] = field(default_factory=dict)  # decided, but not charged: what it ended as
    undecided: dict[str, int] = field(default_factory=dict)  # registered, and no lane was found: what it ended as
    kills_core: int = 0
    kills_ledger: int = 0
    kills_by_step: dict[str, int] = field(default_factory=dict)  # of each step that there was, also of none
    detections: int = 0
    outcomes: dict[str, int] = field(default_factory=dict)
    reconciliation_exact: bool = True
    charged_without_detection: int = 0
    outbox: int = 0
    simulated_s: float = 0.0
    cpu_s: float = 0.0

    @property
    def charged_share_of_decided(self) -> float:
        """Share of the decided, registered passages that were charged; 1 if there are none."""
        return 1.0 - sum(self.decided_uncharged.values()) / self.decided if self.decided else 1.0

    @property
    def is_good(self) -> bool:
        """Whether the goals of the protocol are met."""
        return (
            self.double_charges == self.wrong_charges == self.charged_without_detection == 0
            and self.reconciliation_exact
            and self.charged_share_of_decided >= 0.99
        )

    def plus(self, other: "Result") -> "Result":
        """Add the numbers of another part; the reconciliation is exact if it is in both."""
        mine, theirs = asdict(self), asdict(other)
        total = {name: _sum(mine[name], theirs[name]) for name in mine}
        return Result(**total | {"reconciliation_exact": self.reconciliation_exact and other.reconciliation_exact})

    def as_json(self) -> str:
        """Give the numbers, and the shares of registered passages, as JSON."""
        undecided = sum(self.undecided.values()) / self.registered if self.registered else 0.0
        shares = {
            "charged_share_of_decided": round(self.charged_share_of_decided, 5),
            "undecided_share_of_registered": round(undecided, 4),
        }
        return json.dumps(asdict(self) | shares, indent=1)


def _sum(one: Any, other: Any) -> Any:
    """Add two numbers, or two dictionaries of numbers by their keys."""
    return {key: one.get(key, 0) + other.get(key, 0) for key in one | other} if isinstance(one, dict) else one + other


class KillableStore(Store):
    """A store that is killed before a given statement."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.deadly: str | None = None

    def execute(self, sql: str, *values: Value) -> int:
        """Run a statement, or die before it."""
        if self.deadly and f"ledger before {sql}".startswith(self.deadly):
            raise ProcessKilled
        return super().execute(sql, *values)


class Campaign:
    """The processes of a road-side unit, their bus, and who kills them."""

    def __init__(self, folder: Path, seed: int, vehicles: int, passages_per_kill: float) -> None:
        self.rng = np.random.default_rng((seed, 7))
        self.plaza = load_plaza(PLAZA_FILE)
        channel = Channel(loss=0.05, duplicates=0.02, reordered=0.05, reorder_s=1.0)
        self.world = World(near_gate(self.plaza), Traffic(vehicles=vehicles, channel=channel), seed, START_NS)
        self.path = folder / "ledger.sqlite"
        self.gnss, self.v2x = GnssParser(GnssConfig()), V2xParser(V2xConfig())
        self.core: Toll | None = Toll(TollConfig())
        self.core_back_ns = self.ledger_back_ns = START_NS
        self.store: KillableStore | None = None
        self.ledger: Ledger | None = None
        self.inbox: list[Message] = []  # of the ledger
        self.operator, self.receipts = Operator(), list[TollReceipt]()
        self.kills: Counter[str] = Counter()
        self.passages_per_kill, self.next_kill = passages_per_kill, passages_per_kill
        self.armed: str | None = None  # step of the next kill, once that is due
        self.armed_ns = START_NS
        self.steps: dict[str, list[str]] = {"core": [], "ledger": []}  # still to be drawn in this turn
        self.world_now_ns = START_NS
        self.truth: dict[int, TrafficPassage] = {}
        self.contract_of: dict[int, str] = {}
        self.ends: dict[str, set[str]] = defaultdict(set)  # final statements by contract, with their reasons
        self.decided: set[str] = set()  # contracts with a crossing in a lane
        self.reviewed: set[str | None] = set()  # contracts of passages that were left to a person
        self.delta: TollDelta | None = None  # retained by the broker
        self._begin_ledger(START_NS)

    def run(self, passages: int) -> Result:
        """Drive until so many vehicles have passed, then let everything settle."""
        started = time.process_time()
        stop_ns: int | None = None
        counted: set[int] = set()
        for step, (now_ns, items) in enumerate(batches(self.world)):
            self._receive(now_ns, items)
            self._serve_ledger(now_ns, second=step % SECOND_STEPS == 0)
            if step % SECOND_STEPS == 0 and self.core is not None:
                self._publish(self._answers(Tick(now_ns=now_ns)), now_ns)
            if stop_ns is None and len(self.truth) >= passages:
                stop_ns = now_ns + round(DRAIN_S * NS)
                counted = {n for n, p in self.truth.items() if p.crossing_ns >= START_NS + WARM_UP_NS}
                self.next_kill, self.world.entry_open = float("inf"), False
            if stop_ns is not None and now_ns >= stop_ns:
                break
            if step % (60 * SECOND_STEPS) == 0:
                print(f"{(now_ns - START_NS) / NS:.0f} s, {len(self.truth)} passages, {self.kills.total()} kills",
                      file=sys.stderr, flush=True)  # fmt: skip
        return self._result(counted, (now_ns - START_NS) * 1e-9, time.process_time() - started)

    def _receive(self, now_ns: int, items: list[tuple[int, Frame | Message]]) -> None:
        """Deliver what arrives within 100 ms; a kill is due every so many passages."""
        if len(self.truth) >= self.next_kill and self.armed is None:
            self.next_kill += self.passages_per_kill * float(self.rng.uniform(0.5, 1.5))
            self._arm("core" if self.rng.random() < 0.5 else "ledger", now_ns)
        if self.armed is not None and now_ns - self.armed_ns > PATIENCE_NS:
            process = "core" if self.armed in CORE_STEPS else "ledger"
            self.steps[process].insert(0, self.armed)
            self._arm(process, now_ns)
        if self.core is None and now_ns >= self.core_back_ns:
            self.core = Toll(TollConfig())
            if self.delta is not None:
                self._publish(self._answers(self.delta), now_ns)
        for _, item in items:
            if not isinstance(item, Frame):
                self._deliver(item, now_ns)
        received = [(due_ns, item.data) for due_ns, item in items if isinstance(item, Frame)]
        batch = CamFrames(received_ns=now_ns, source="v2x0", encapsulation=Encapsulation.GEONETWORKING,
                          data=frames.pack(received))  # fmt: skip
        for cams in self.v2x.handle(batch):
            if isinstance(cams, CamList):
                self._publish(self._answers(cams), now_ns)

    def _arm(self, process: str, now_ns: int) -> None:
        """Draw the step of the next kill; each once in a turn, or again if it does not come."""
        steps = CORE_STEPS if process == "core" else LEDGER_STEPS
        self.steps[process] = self.steps[process] or self.rng.permutation(steps).tolist()
        self.armed, self.armed_ns = self.steps[process].pop(), now_ns

    def _deliver(self, item: Message, now_ns: int) -> None:
        match item:
            case GnssRaw():
                for fix in self.gnss.handle(item):
                    if isinstance(fix, GnssFix):
                        list(self.v2x.handle(fix))
                        self._publish(self._answers(fix), now_ns)
            case TollRegistration():
                assert item.station_id is not None, "the simulated traffic registers station IDs"
                self.contract_of[item.station_id] = item.contract
                self._publish(self._answers(item), now_ns)
                self.inbox.append(item)
            case PlazaDetector():
                self.inbox.append(item)
            case PlazaTruth():
                self.truth.update({passage.vehicle: passage for passage in item.passages})
            case _:
                pass

    def _answers(self, message: Message) -> list[Message]:
        """Let core.toll handle a message; a kill loses what it would have said from some answer on."""
        if self.core is None:
            return []
        answers: list[Message] = list(self.core.handle(message))  # type: ignore[arg-type]  # one of those that it consumes
        events = [a for a in answers if isinstance(a, TollPassage)]
        for event in events:
            contracts = {self.contract_of[station] for station in event.station_ids if station in self.contract_of}
            if event.crossing_ns is not None and event.lane is not None:
                self.decided |= contracts
            if event.state.is_final:
                for contract in contracts:
                    self.ends[contract].add(f"{event.state}: {event.reason}")
        for number, event in enumerate(events):
            name = "checkpoint" if event.checkpoint else event.state.value
            if self.armed in (f"core.toll before {name}", f"core.toll after {name}"):
                said = number + self.armed.startswith("core.toll after")
                self._count_kill()
                self.core = None
                self.core_back_ns = self.world_now_ns + round(float(self.rng.uniform(0.5, 2.0)) * NS)
                return answers[: answers.index(event) + said - number]
        return answers

    def _count_kill(self) -> None:
        assert self.armed is not None
        self.kills[self.armed] += 1
        self.armed = None

    def _publish(self, answers: list[Message], now_ns: int) -> None:
        self.world_now_ns = now_ns
        for answer in answers:
            if isinstance(answer, TollPassage | UsedCams):
                self.inbox.append(answer)
            elif isinstance(answer, TollDelta):
                self.delta = answer

    # The ledger's process

    def _begin_ledger(self, now_ns: int) -> None:
        self.store = KillableStore(self.path)
        plaza_file = plaza_path(PLAZA_FILE).read_text()
        self.ledger = Ledger(self.store, self.plaza, plaza_file, Settings(), now_ns, key=KeyFile(self.path.parent))

    def _serve_ledger(self, now_ns: int, *, second: bool) -> None:
        self.world_now_ns = now_ns
        messages, self.inbox = [*self.inbox, *self.receipts], []
        self.receipts = []
        if self.ledger is None:
            if now_ns < self.ledger_back_ns:
                return  # lost
            self._begin_ledger(now_ns)
        assert self.ledger is not None and self.store is not None
        self.store.deadly = self.armed
        try:
            with self.store.transaction():
                for message in messages:
                    self.ledger.use(message, now_ns)
                if messages:
                    self._die_at("COMMIT")
            if second:
                with self.store.transaction():
                    self.ledger.reconcile(now_ns)
                    self.ledger.expire(now_ns)
            for transaction in self.ledger.due(now_ns):
                self._die_at("publishing a transaction")
                receipt = self.operator.receive(transaction, now_ns)
                if self.rng.random() >= ANSWERS_LOST:
                    self.receipts.append(receipt)
            self._publish_reviews(self.ledger, self.store)
            if second:
                self._die_at("publishing open passages")
                self._inform_core(self.ledger, now_ns)
        except ProcessKilled:
            self._count_kill()
            self.store.close()
            self.ledger = self.store = None
            self.ledger_back_ns = now_ns + round(float(self.rng.uniform(0.5, 2.0)) * NS)

    def _publish_reviews(self, ledger: Ledger, store: Store) -> None:
        """Note who is left to a person: the ledger forgets a review without evidence after minutes."""
        if reviews := ledger.reviews():
            self._die_at("publishing a review")
            for review in reviews:
                self.reviewed |= {review.contract, *review.contracts}
            with store.transaction():
                for review in reviews:
                    ledger.reviewed(review)

    def _inform_core(self, ledger: Ledger, now_ns: int) -> None:
        """Send core.toll what an earlier process of it has used, and the open passages."""
        for message in (*ledger.restored(), ledger.open_passages(now_ns)):
            self._publish(self._answers(message), now_ns)

    def _die_at(self, step: str) -> None:
        if self.armed == f"ledger before {step}":
            raise ProcessKilled

    def _result(self, counted: set[int], simulated_s: float, cpu_s: float) -> Result:
        assert self.ledger is not None
        booked = [t for t in self.operator.booked.values() if t.kind is TransactionKind.CHARGE]
        charges = Counter(t.contract for t in booked)
        passed = {p.contract: p for p in self.truth.values() if p.contract}
        registered = {p.contract: p for n, p in self.truth.items() if n in counted and p.contract}
        uncharged = {contract for contract in registered if contract not in charges}
        decided = {contract for contract in registered if contract in self.decided or contract in charges}
        balances = self.ledger.balances(0)
        outcomes: Counter[str] = Counter()
        for lane in balances:
            for name in (
                "charged",
                "review",
                "undecided",
                "unregistered",
                "paid_otherwise",
                "suspect",
                "void",
                "missed",
                "held",
                "pending",
            ):
                outcomes[name] += getattr(lane, name)
        detections = sum(lane.detections for lane in balances)
        return Result(
            passages=len(counted),
            registered=len(registered),
            charged=len(registered) - len(uncharged),
            double_charges=sum(n - 1 for n in charges.values()),
            wrong_charges=sum(contract not in passed for contract in charges),
            lanes_right=sum(t.lane == passed[t.contract].lane for t in booked if t.contract in registered),
            decided=len(decided),
            in_review=len(uncharged & self.reviewed),
            decided_uncharged=self._endings((decided & uncharged) - self.reviewed),
            undecided=self._endings(uncharged - decided - self.reviewed),
            kills_core=sum(n for step, n in self.kills.items() if step.startswith("core")),
            kills_ledger=sum(n for step, n in self.kills.items() if step.startswith("ledger")),
            kills_by_step={step: self.kills[step] for step in CORE_STEPS + LEDGER_STEPS},
            detections=detections,
            outcomes=dict(outcomes),
            reconciliation_exact=detections == sum(outcomes.values()),
            charged_without_detection=sum(lane.charged_without_detection for lane in balances),
            outbox=self.ledger.state(self.world_now_ns).outbox,
            simulated_s=round(simulated_s, 1),
            cpu_s=round(cpu_s, 1),
        )

    def _endings(self, contracts: set[str]) -> dict[str, int]:
        """Count what the passages of contracts ended as."""
        return dict(Counter(" + ".join(sorted(self.ends[c])) or "no passage" for c in contracts))


def near_gate(plaza: Plaza) -> Plaza:
    """Shorten the lanes to what the passages need."""
    return plaza.model_copy(update={"lanes": tuple(_shortened(lane) for lane in plaza.lanes)})


def _shortened(lane: Lane) -> Lane:
    approach, leave = along(lane.centre, lane.approach), along(lane.centre, lane.exit)
    assert approach is not None and leave is not None, "the plaza's file was checked for it"
    steps = np.hypot(*np.diff(lane.centre, axis=0).T)
    distance = np.concatenate([[0.0], np.cumsum(steps)])
    begin, end = approach - BEFORE_M, leave + BEHIND_M
    kept = [begin, *distance[(distance > begin) & (distance < end)], end]
    points = np.stack([np.interp(kept, distance, lane.centre[:, axis]) for axis in range(2)], axis=1)
    return lane.model_copy(update={"centre": points})


def campaign(passages: int, kills: int, seed: int, vehicles: int, folder: Path) -> Result:
    """Run one campaign in a folder of its own."""
    made = Campaign(folder, seed, vehicles, max(passages / kills * 0.9, 1.0) if kills else float("inf"))
    return made.run(passages)


def table(result: Result) -> str:
    """Write the result as a table."""
    undecided = sum(result.undecided.values())
    ends = result.decided_uncharged | ({"in review": result.in_review} if result.in_review else {})
    rows = {
        "simulated passages, each with a detection": f"{result.detections}",
        "of these after 30 s of a part, before its end": f"{result.passages} ({result.registered} registered)",
        "kills": f"{result.kills_core} of `core.toll`, {result.kills_ledger} of the ledger, "
        f"at {sum(kills > 0 for kills in result.kills_by_step.values())} of {len(result.kills_by_step)} steps",
        "double charges, charges of who has not passed": f"{result.double_charges}, {result.wrong_charges}",
        "lane decided": f"{result.decided}, charged {100.0 * result.charged_share_of_decided:.2f} %",
        "charged in the right lane": f"{result.lanes_right} of {result.charged}",
        "decided and not charged": "; ".join(f"{n} {end}" for end, n in ends.items()) or "none",
        "undecided": f"{undecided} ({100.0 * undecided / max(result.registered, 1):.1f} % of the registered)",
        "outcomes of all detections": ", ".join(f"{name} {n}" for name, n in result.outcomes.items()),
        "every detection has one outcome": "yes" if result.reconciliation_exact else "no",
        "charges without a detection": f"{result.charged_without_detection}",
        "simulated time, processor time": f"{result.simulated_s:.0f} s, {result.cpu_s:.0f} s",
    }
    return _table(("quantity", "value"), rows)


def _table(head: tuple[str, str], rows: Mapping[str, object]) -> str:
    return "".join(f"| {name} | {value} |\n" for name, value in [head, ("---", "---"), *rows.items()])


def part(seed: int, passages: int, kills: int, vehicles: int) -> Result:
    """Compute a part of the campaign."""
    with tempfile.TemporaryDirectory() as folder:
        return campaign(passages, kills, seed, vehicles, Path(folder))


def store(result: Result) -> None:
    """Write the result as JSON, as a page, and into the explanation of charging."""
    (RESULTS / "toll_campaign.json").write_text(result.as_json() + "\n", encoding="utf-8")
    page = TITLE + table(result) + "\n" + _table(("killed", "times"), result.kills_by_step)
    tables.publish(RESULTS / "toll_campaign.md", page)
    before, rest = EXPLANATION.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END, 1)[1]
    EXPLANATION.write_text(before + BEGIN + table(result) + END + after, encoding="utf-8")


def stored() -> Result:
    """Read the result of the stored campaign."""
    return _result(RESULTS / "toll_campaign.json")


def _result(path: Path) -> Result:
    content = json.loads(path.read_text(encoding="utf-8"))
    return Result(**{field.name: content[field.name] for field in fields(Result) if field.name in content})


def main() -> None:
    """Print the sum of the parts as JSON; end with 1 where a goal of the protocol is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    options = options_of(parser, None, SIZE)
    seeds = range(options.seed, options.seed + options.runs)
    jobs = [Job(f"part {seed}", part, (seed, PASSAGES, KILLS, VEHICLES)) for seed in seeds]
    outcome = run("toll", jobs, workers=options.workers, fresh=options.fresh, smoke=options.smoke)
    result = Result()
    for item in outcome.results:
        result = result.plus(item)
    print(result.as_json())
    if worth_storing(options, outcome):
        store(result)
    sys.exit(0 if outcome.complete and result.is_good else 1)


if __name__ == "__main__":
    main()
