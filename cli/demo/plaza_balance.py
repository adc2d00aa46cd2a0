"""What a run of the road-side unit amounted to: passages and charges against the simulator's truth, rates, load."""

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

from shared.messages.base import Message
from shared.messages.operation import DeadlineReport, ProcessHealth, ProcessState
from shared.messages.toll import (
    LaneBalance,
    LedgerState,
    PassageState,
    PlazaTruth,
    TollPassage,
    TollReceipt,
    TollTransaction,
    TrafficPassage,
    TransactionKind,
)
from shared.messages.v2x import CamList

OBSERVED = (
    "plaza/truth", "toll/passage", "toll/transaction", "toll/receipt", "ledger/state", "v2x/cam", "deadline/report",
    "health/+",
)  # fmt: skip
SETTLING_TIME_NS = 20_000_000_000  # a passage needs so long from the gate line to its transaction


@dataclass(frozen=True)
class PlazaSummary:
    """The summary of a run; passages are those of the simulator's truth at the gate line."""

    healthy: bool
    duration_s: float
    processes_alive: int
    processes_expected: int
    restarts: int
    messages_per_second: float
    broken_messages: int
    passages: int
    passages_equipped: int
    passages_registered: int
    transactions: int  # distinct charges
    double_charges: int  # contracts that were charged more than once: each passes once
    wrong_charges: int  # charges of a contract that has not passed the gate
    missed: int  # registered passages, settled by now, that were neither charged nor ended in another state
    undecided: int
    suspect: int
    void: int
    lane_decisions: int  # charges of vehicles whose true lane is known
    lane_decisions_right: int
    receipts: int
    outbox: int
    detections: int
    detections_missed: int
    accounts_agree: bool | None  # None: no detection is accounted for to the end yet
    accounts_closed: int  # detections with a final outcome
    accounts_provisional: int  # detections whose outcome may still change
    accounts_pending: int  # detections that no passage explains yet
    held: int  # complete passages that wait for a detector
    in_review: int  # passages that a person has to judge
    unconfirmed: int  # charges that are not confirmed by a detector
    cams_per_second: float
    cpu_share: float  # of one core, all processes
    cpu_share_by_process: dict[str, float]


@dataclass(frozen=True)
class Accounts:
    """The reconciliation of all lanes: what is closed, and what is not known yet."""

    agree: bool | None
    closed: int
    provisional: int
    pending: int

    @classmethod
    def of(cls, lanes: Sequence[LaneBalance]) -> "Accounts":
        """Sum up the lanes; that all agree says nothing while no detection is closed."""
        provisional, pending = sum(lane.provisional for lane in lanes), sum(lane.pending for lane in lanes)
        closed = sum(lane.detections for lane in lanes) - provisional - pending
        wrong = any(not lane.agrees for lane in lanes)
        return cls(False if wrong else True if closed > 0 else None, closed, provisional, pending)


class PlazaBalance:
    """Collects what the bus carries during a run."""

    def __init__(self) -> None:
        self._truth: dict[int, TrafficPassage] = {}
        self._charges: dict[str, TollTransaction] = {}
        self._ends: dict[str, PassageState] = {}
        self._receipts: set[str] = set()
        self._ledger: LedgerState | None = None
        self._report: DeadlineReport | None = None
        self._first_health: dict[tuple[str, int], ProcessHealth] = {}
        self._health: dict[tuple[str, int], ProcessHealth] = {}
        self._first_ns = self._last_ns = self._truth_ns = 0
        self._cams = 0
        self.messages = self.broken_messages = 0

    def add(self, _topic: str, message: Message, received_ns: int) -> None:
        """Take one message as it arrived."""
        match message:
            case PlazaTruth():
                self.messages += 1
                self._first_ns = self._first_ns or received_ns
                self._last_ns, self._truth_ns = received_ns, message.sampled_ns
                self._truth.update({passage.vehicle: passage for passage in message.passages})
            case CamList():
                self._cams += len(message.cams)
            case TollPassage() if message.state.is_final:
                self._ends[message.passage_id] = message.state
            case TollTransaction() if message.kind is TransactionKind.CHARGE:
                self._charges[message.transaction_id] = message
            case TollReceipt():
                self._receipts.add(message.transaction_id)
            case LedgerState():
                self._ledger = message
            case DeadlineReport():
                self._report = message
            case ProcessHealth():
                incarnation = (message.process, message.incarnation)
                self._first_health.setdefault(incarnation, message)
                if message.state is ProcessState.READY:
                    self._health[incarnation] = message
            case _:
                pass

    def summary(self, alive: int, expected: int, restarts: int) -> PlazaSummary:
        """Add everything up."""
        duration_s = max((self._last_ns - self._first_ns) * 1e-9, 1e-9)
        charged = Counter(charge.contract for charge in self._charges.values())
        truth = {passage.contract: passage for passage in self._truth.values() if passage.contract}
        judged = [charge for charge in self._charges.values() if charge.contract in truth]
        settled = [p for p in truth.values() if p.crossing_ns < self._truth_ns - SETTLING_TIME_NS]
        ends = Counter(self._ends.values())
        ready = {name for (name, _), health in self._health.items() if health.state is ProcessState.READY}
        cpu = self._cpu(duration_s)
        ledger = self._ledger
        lanes = ledger.lanes if ledger else ()
        uncharged = sum(passage.contract not in charged for passage in settled)
        other_ends = ends[PassageState.UNDECIDED] + (ledger.held + ledger.in_review if ledger else 0)
        accounts = Accounts.of(lanes)
        return PlazaSummary(
            healthy=alive == expected and len(ready) >= expected - 1 and bool(self._charges),
            duration_s=round(duration_s, 1),
            processes_alive=alive,
            processes_expected=expected,
            restarts=restarts,
            messages_per_second=round(sum(t.rate_hz for t in self._report.topics), 1) if self._report else 0.0,
            broken_messages=self.broken_messages,
            passages=len(self._truth),
            passages_equipped=sum(passage.equipped for passage in self._truth.values()),
            passages_registered=len(truth),
            transactions=len(self._charges),
            double_charges=sum(n - 1 for n in charged.values()),
            wrong_charges=sum(contract not in truth for contract in charged),
            missed=max(uncharged - other_ends, 0),
            undecided=ends[PassageState.UNDECIDED],
            suspect=ends[PassageState.SUSPECT],
            void=ends[PassageState.VOID],
            lane_decisions=len(judged),
            lane_decisions_right=sum(charge.lane == truth[charge.contract].lane for charge in judged),
            receipts=len(self._receipts),
            outbox=ledger.outbox if ledger else 0,
            detections=sum(lane.detections for lane in lanes),
            detections_missed=sum(lane.missed for lane in lanes),
            accounts_agree=accounts.agree,
            accounts_closed=accounts.closed,
            accounts_provisional=accounts.provisional,
            accounts_pending=accounts.pending,
            held=ledger.held if ledger else 0,
            in_review=ledger.in_review if ledger else 0,
            unconfirmed=ledger.unconfirmed if ledger else 0,
            cams_per_second=round(self._cams / duration_s, 1),
            cpu_share=round(sum(cpu.values()), 3),
            cpu_share_by_process=cpu,
        )

    def _cpu(self, duration_s: float) -> dict[str, float]:
        shares: dict[str, float] = defaultdict(float)
        for incarnation, last in self._health.items():
            shares[incarnation[0]] += (last.cpu_s - self._first_health[incarnation].cpu_s) / duration_s
        return {name: round(share, 3) for name, share in sorted(shares.items())}
