"""Honest traffic at a plaza, counted by what became of it: `python -m benchmarks.v2x.honest`.

Simulated vehicles that sign, with all that the simulation has of losses, silence and new tickets; `core.toll` and the
ledger are called as functions, messages in and facts out, in one thread on simulated time. Signatures of CAM are not
made and not verified here: each carries the ticket that `parsers.v2x` would have found. Registrations are signed and
verified. What is charged is compared with who has passed, and each pulse of a charge with whose it was.
"""

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from datetime import date
from pathlib import Path
from typing import Any

from benchmarks import tables
from benchmarks.toll_campaign import BATCH_NS, START_NS, batches, near_gate
from cli.campaign import Job, Size, options_of, run, worth_storing
from services.core.toll.core import VERSION, Core
from services.core.toll.settings import Settings as CoreSettings
from services.monitoring.ledger.ledger import Ledger, Settings
from services.monitoring.ledger.store import Store
from services.parsers.gnss.process import Config as GnssConfig
from services.parsers.gnss.process import Process as GnssParser
from services.sensors.traffic.operator import Operator
from services.sensors.traffic.vehicle import Vehicle
from services.sensors.traffic.world import Frame, Traffic, World
from shared.messages.base import Message
from shared.messages.gnss import GnssFix, GnssRaw
from shared.messages.toll import (
    EvidencePack,
    PlazaDetector,
    PlazaTruth,
    TollPassage,
    TollRegistration,
    TrafficPassage,
    TransactionKind,
)
from shared.messages.v2x import Authentication, Cam, CamContent
from shared.toll.plaza import Plaza, parse_plaza, plaza_path
from shared.v2x import its_time

NS = 1_000_000_000
WARM_UP_NS = 30 * NS  # before the first delta position; these vehicles are not counted
DRAIN_S = 200.0  # until each pulse has its outcome
PASSAGES, VEHICLES = 850, 140  # of a part, all vehicles; a part has some 600 counted contracts
SIZE = Size(short=1, usual=12, full=12, unit="parts of each setting")
PLAZA_FILE = Path("deploy/plazas/example.geojson")
SHORT_PASSAGES = 100
RESULTS = Path(__file__).parents[1] / "results"
EXPLANATION = Path(__file__).parents[2] / "docs/explanation/charging.md"
BEGIN, END = "<!-- printed by `python -m benchmarks.v2x.honest` -->\n", "<!-- end of honest traffic -->\n"
TITLE = """# Honest traffic

By `python -m benchmarks.v2x.honest`: simulated vehicles on the example plaza, with the shares of the simulation that
send nothing (10 %), have no contract (10 %), fall silent for seconds (3 %), change their ticket (10 %), use corrections
(10 %) or turn around (2 %); 5 % of the frames lost.

"""
REAL_ELLIPSE_M = 2.84  # semi-major axis that the car of field_secured_cam.pcapng states
SCENARIOS: dict[str, dict[str, Any]] = {
    "ideal pulses": {},
    "1 % of pulses missed": {"detectors": {"jitter_s": 0.02, "missed": 0.01}},
    "a real car's ellipse": {"errors": {"ellipse_m": REAL_ELLIPSE_M}},
    "a real car's ellipse, and errors as stated": {"errors": {"ellipse_m": REAL_ELLIPSE_M, "common_sd_m": 0.9}},
    "detectors that err": {
        "detectors": {"jitter_s": 0.05, "missed": 0.01, "doubled": 0.005, "false_per_hour": 2.0},
    },
}
OUTCOMES = ("charged", "review", "undecided", "unregistered", "paid_otherwise", "suspect", "void", "missed", "held",
            "pending", "detections", "charged_without_detection")  # fmt: skip
GOALS = {"ideal pulses": 1.5, "1 % of pulses missed": 3.0, "a real car's ellipse": 3.5}  # [%] of reviews


class QuickStore(Store):
    """A ledger's file that no power cut threatens."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._db.execute("PRAGMA synchronous=OFF")


class AuthenticatedWorld(World):
    """Vehicles whose CAM are as `parsers.v2x` has verified them."""

    def __init__(self, plaza: Plaza, traffic: Traffic, seed: int, start_ns: int) -> None:
        self.contents: dict[bytes, tuple[CamContent, int, str | None]] = {}
        super().__init__(plaza, traffic, seed, start_ns)

    def sent(self, vehicle: Vehicle, content: CamContent, sent_ns: int) -> Frame:
        """Give a frame that stands for a CAM."""
        data = b"%d %d" % (content.station_id, sent_ns)
        ticket = vehicle.station.holder.certificate.digest.hex() if vehicle.station else None
        self.contents[data] = content, sent_ns, ticket
        return Frame(data)

    def cam(self, data: bytes, received_ns: int) -> Cam:
        """The CAM of a frame."""
        content, sent_ns, ticket = self.contents[data]
        stamp_ns = sent_ns // 1_000_000 * 1_000_000
        known = Authentication.AUTHENTICATED if ticket else Authentication.UNSIGNED
        return Cam(
            **dict(content), sampled_ns=stamp_ns, received_ns=received_ns, frame=data, authentication=known,
            signer=ticket, generation_delta_time=its_time.its_time_ms(stamp_ns) % its_time.CYCLE_MS,
        )  # fmt: skip


@dataclass
class Result:
    """What became of the contracts that have passed."""

    passages: int = 0  # of all vehicles
    contracts: int = 0  # passages of contracts
    charged: int = 0
    reviews: int = 0
    free: int = 0  # neither charged nor reviewed
    wrong: int = 0  # charges of a contract that has not passed
    double: int = 0
    other_pulse: int = 0  # charges confirmed by the pulse of another vehicle: that one has none left
    lanes_wrong: int = 0
    reasons: dict[str, int] = field(default_factory=dict)  # of reviews, by code of core.toll or ledger
    outcomes: dict[str, int] = field(default_factory=dict)  # of pulses
    seconds: float = 0.0

    @property
    def review_share(self) -> float:
        """Share of the passages of contracts that a person has to judge."""
        return self.reviews / max(self.contracts, 1)

    @property
    def is_right(self) -> bool:
        """Whether nobody was charged wrongly or twice, or passed for free."""
        return self.wrong == self.double == self.free == self.other_pulse == 0

    def plus(self, other: "Result") -> "Result":
        """Add the numbers of another part."""
        mine, theirs = asdict(self), asdict(other)
        return Result(**{name: _sum(mine[name], theirs[name]) for name in mine})


def _sum(one: Any, other: Any) -> Any:
    return dict(Counter(one) + Counter(other)) if isinstance(one, dict) else one + other


class Run:
    """A plaza and its traffic."""

    def __init__(self, folder: Path, seed: int, vehicles: int, changes: dict[str, Any]) -> None:
        text = plaza_path(PLAZA_FILE).read_text()
        text = text.replace('"require_authenticated": false', '"require_authenticated": true')
        self.plaza = parse_plaza(text.encode())
        traffic = Traffic.model_validate({"vehicles": vehicles, "signed": 1.0} | changes)
        self.world = AuthenticatedWorld(near_gate(self.plaza), traffic, seed, START_NS)
        self.gnss = GnssParser(GnssConfig())
        self.core = Core(self.plaza, CoreSettings())
        self.store = QuickStore(folder / "ledger.sqlite")
        self.ledger = Ledger(self.store, self.plaza, text, Settings(), START_NS)
        self.operator = Operator()
        self.inbox: list[Message] = []
        self.truth: dict[int, TrafficPassage] = {}
        self.reasons: dict[str, str] = {}  # of reviews, by contract
        self.passage_of: dict[str, str] = {}  # contract by passage

    def run(self, passages: int, drain_s: float = DRAIN_S) -> Result:
        """Drive until so many vehicles have passed, then let everything settle."""
        started = time.process_time()
        stop_ns: int | None = None
        counted: set[int] = set()
        for step, (now_ns, items) in enumerate(batches(self.world)):
            self._receive(now_ns, items)
            if step % (NS // BATCH_NS) == 0:
                self._second(now_ns)
            if stop_ns is None and len(self.truth) >= passages:
                stop_ns = now_ns + round(drain_s * NS)
                counted = {n for n, p in self.truth.items() if p.crossing_ns >= START_NS + WARM_UP_NS}
                self.world.entry_open = False
            if stop_ns is not None and now_ns >= stop_ns:
                break
        return self._result(counted, time.process_time() - started)

    def _receive(self, now_ns: int, items: list[tuple[int, Frame | Message]]) -> None:
        cams = [self.world.cam(item.data, due_ns) for due_ns, item in items if isinstance(item, Frame)]
        for _, item in items:
            match item:
                case GnssRaw():
                    for fix in self.gnss.handle(item):
                        if isinstance(fix, GnssFix):
                            self.core.fix(fix)
                            self.core.use_delta(self.core.estimate_delta(fix.sampled_ns))
                case TollRegistration():
                    self.core.register(item)
                    self.inbox.append(item)
                case PlazaDetector():
                    self.inbox.append(item)
                case PlazaTruth():
                    self.truth.update({passage.vehicle: passage for passage in item.passages})
                case _:
                    pass
        self.inbox += [said for said in self.core.use(cams) if isinstance(said, TollPassage)]

    def _second(self, now_ns: int) -> None:
        self.inbox += [said for said in self.core.tick(now_ns) if isinstance(said, TollPassage)]
        self.core.used()
        with self.store.transaction():
            for message in self.inbox:
                self.ledger.use(message, now_ns)
            self.inbox.clear()
            self.ledger.reconcile(now_ns)
            self.ledger.expire(now_ns)
            for transaction in self.ledger.due(now_ns):
                self.ledger.receipt(self.operator.receive(transaction, now_ns), now_ns)
            for review in self.ledger.reviews():
                for contract in {review.contract, *review.contracts} - {None}:
                    self.reasons.setdefault(str(contract), review.reason_code.code if review.reason_code else "")
                self.ledger.reviewed(review)
        for statement in self.core.continue_passages(self.ledger.open_passages(now_ns)):
            if isinstance(statement, TollPassage):
                self.inbox.append(statement)

    def _result(self, counted: set[int], seconds: float) -> Result:
        charges = [t for t in self.operator.booked.values() if t.kind is TransactionKind.CHARGE]
        number = Counter(t.contract for t in charges)
        passed = {p.contract: p for p in self.truth.values() if p.contract}
        contracts = {p.contract for n, p in self.truth.items() if n in counted and p.contract}
        reviewed = {contract for contract in contracts if contract in self.reasons}
        outcomes: Counter[str] = Counter()
        for lane in self.ledger.balances(0):
            outcomes.update({k: v for k, v in dict(lane).items() if k in OUTCOMES and v})
        return Result(
            passages=len(counted),
            contracts=len(contracts),
            charged=sum(contract in number for contract in contracts),
            reviews=len(reviewed),
            free=sum(contract not in number and contract not in reviewed for contract in contracts),
            wrong=sum(contract not in passed for contract in number),
            double=sum(n - 1 for n in number.values()),
            other_pulse=sum(self._is_of_another(t.passage_id, passed.get(t.contract)) for t in charges),
            lanes_wrong=sum(t.contract in passed and t.lane != passed[t.contract].lane for t in charges),
            reasons=dict(Counter(self.reasons[contract] for contract in sorted(reviewed))),
            outcomes=dict(outcomes),
            seconds=round(seconds, 1),
        )

    def _is_of_another(self, passage_id: str, passage: TrafficPassage | None) -> bool:
        """Whether the pulse that confirms a charge is that of another vehicle."""
        found = self.ledger.evidence(passage_id)
        pulses = EvidencePack.model_validate_json(found).pulses if found else ()
        if not pulses or passage is None:
            return False
        pulse = pulses[0]
        near = [p for p in self.truth.values() if p.lane == pulse.lane]
        owner = min(near, key=lambda p: abs(p.crossing_ns - pulse.sampled_ns), default=None)
        return owner is not None and owner.vehicle != passage.vehicle


def part(name: str, seed: int, passages: int, drain_s: float = DRAIN_S) -> Result:
    """Compute a part of a setting."""
    with tempfile.TemporaryDirectory() as folder:
        return Run(Path(folder), seed, VEHICLES, SCENARIOS[name]).run(passages, drain_s)


def table(results: dict[str, dict[str, Any]]) -> str:
    """Write the results as a table, a column for each setting."""
    names = [name for name in SCENARIOS if name in results]
    found = {name: Result(**results[name]["result"]) for name in names}
    rows: dict[str, Callable[[str, Result], str]] = {
        "passages, of contracts": lambda _, r: f"{r.passages}, {r.contracts}",
        "charged": lambda _, r: f"{r.charged}",
        "reviews": lambda _, r: f"{r.reviews} ({100.0 * r.review_share:.2f} %)",
        "goal": lambda name, _: f"{GOALS[name]:g} %" if name in GOALS else "",
        "because of": lambda _, r: ", ".join(f"{code} {n}" for code, n in sorted(r.reasons.items())) or "none",
        "charged wrongly, twice; passed for free": lambda _, r: f"{r.wrong}, {r.double}; {r.free}",
        "such passages, at 95 %": lambda _, r: "above 0" if not r.is_right else f"< {3.0 / max(r.contracts, 1):.1e}",
        "charged with another vehicle's pulse": lambda _, r: f"{r.other_pulse}",
        "in a wrong lane": lambda _, r: f"{r.lanes_wrong}",
        "outcomes of all pulses": lambda _, r: ", ".join(f"{name} {n}" for name, n in r.outcomes.items()),
        "measured": lambda name, _: f"{results[name]['date']}, algorithms {results[name]['version']}",
        "processor time": lambda _, r: f"{r.seconds:.0f} s",
    }
    head = ["quantity", *names]
    lines = [head, ["---"] * len(head)]
    lines += [[title, *(cell(name, found[name]) for name in names)] for title, cell in rows.items()]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def stored() -> dict[str, dict[str, Any]]:
    """Read the stored results."""
    path = RESULTS / "toll_honest.json"
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.exists() else {}


def store(results: dict[str, Result]) -> None:
    """Store the results of some settings beside those of the others, as JSON, as a page and in the documentation."""
    now = {"date": date.today().isoformat(), "version": VERSION}
    found = stored() | {name: now | {"result": asdict(result)} for name, result in results.items()}
    (RESULTS / "toll_honest.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    tables.publish(RESULTS / "toll_honest.md", TITLE + table(found))
    before, rest = EXPLANATION.read_text(encoding="utf-8").split(BEGIN)
    EXPLANATION.write_text(before + BEGIN + table(found) + END + rest.split(END, 1)[1], encoding="utf-8")


def main() -> None:
    """Print the results as JSON; end with 1 if somebody was charged wrongly or passed for free, or a goal is missed."""
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0],
        epilog='Example: python -m benchmarks.v2x.honest --runs 12 --setting "ideal pulses"',
    )
    parser.add_argument("--setting", choices=list(SCENARIOS), action="append", help="only this one; default: all")
    parser.add_argument("--seed", type=int, default=1, help="of the first part; default: %(default)s")
    options = options_of(parser, None, SIZE)
    names = options.setting or list(SCENARIOS)
    passages = SHORT_PASSAGES if options.short else PASSAGES
    seeds = range(options.seed, options.seed + options.runs)
    jobs = [Job(f"{name}, part {seed}", part, (name, seed, passages)) for name in names for seed in seeds]
    outcome = run("toll-honest", jobs, workers=options.workers, fresh=options.fresh, smoke=options.smoke)
    results: dict[str, Result] = {}
    for job, result in zip(jobs, outcome.results, strict=False):
        name = str(job.arguments[0])
        results[name] = results.get(name, Result()).plus(result)
    print(json.dumps({name: asdict(result) for name, result in results.items()}, indent=1))
    if worth_storing(options, outcome):
        store(results)
    is_good = all(
        result.is_right and (options.short or 100.0 * result.review_share <= GOALS.get(name, 100.0))
        for name, result in results.items()
    )
    sys.exit(0 if outcome.complete and is_good else 1)


if __name__ == "__main__":
    main()
