"""The rules of the ledger: what is stored of a passage, when it is charged, and what is deleted again.

Every method that changes something runs inside a transaction of the store; what is published is read from the store
after the commit. Messages may come twice, late, or after a restart: each is stored once.
"""

import hashlib
import json
import zlib
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import hypot
from typing import TypeVar

from pydantic import Field, ValidationError, model_validator

from shared.evidence import KeyFile
from shared.messages.base import Message
from shared.messages.explanation import QUOTED_LENGTH, Explanation, QuotedText, explain
from shared.messages.explanation import passage as passage_of
from shared.messages.fitting import fitting
from shared.messages.toll import (
    CONTRACTS,
    MAX_SETTLED,
    OVERLAPS,
    PASSAGES,
    PULSES,
    STATION_IDS,
    STATIONS,
    CrossingMode,
    EvidencePack,
    LaneBalance,
    LaneProbability,
    LaneTraffic,
    LedgerHead,
    LedgerState,
    OpenPassages,
    PassageState,
    PassageSummary,
    PictureAction,
    PictureState,
    PlazaDetector,
    PulseAssignment,
    PulseEvidence,
    RestoredCams,
    ReviewSummary,
    RivalCrossing,
    TollPassage,
    TollPayment,
    TollReceipt,
    TollRegistration,
    TollReview,
    TollTransaction,
    TransactionKind,
    UsedCams,
)
from shared.runtime.config import Section
from shared.toll.plaza import Plaza
from shared.toll.registration import identity_of
from shared.unpacked import MIN_LIMIT_BYTES, BadPack, unpacked
from shared.words.words import CodedText, reason, stated

from .accounts import close, is_closed
from .alarms import Alarms, tickets_of
from .chain import Chain
from .codes import DECIDED_BY, Code
from .confirmation import TIGHT_SD, Claim, Judgement, Verdict, groups, judge
from .pictures import Pictures
from .reconciliation import (
    MINIMUM_PROBABILITY,
    Crossing,
    Mode,
    Ownership,
    Pulse,
    PulseModel,
    is_one_vehicle,
    match,
    near,
    ownership,
)
from .registrations import Contract, Registrations, contracts_of, identities_of
from .replays import Replays
from .store import Row, Store

NS = 1_000_000_000
HOUR_NS = 3600 * NS
DAY_NS = 24 * HOUR_NS
SAME_CROSSING_S = 1.0  # within it two crossings of one vehicle in one lane are one
DOUBTFUL_NS = 30 * DAY_NS  # since the newest evidence, after which a date at the start is not believed at once
PASSAGES_BYTES = 120_000  # in one message, beside 50 kB of settled ones and 70 kB of stations
RECENT_PASSAGES = 50
USED_RETENTION_NS = 70 * NS
REVIEW, PAID_OTHERWISE = "review", "paid_otherwise"  # outcomes that are no states of a passage
OUTCOMES = (
    "charged", REVIEW, "undecided", "unregistered", PAID_OTHERWISE, "suspect", "void", "missed", "held",
)  # fmt: skip
SHOWN_REVIEWS = 50
MAX_TICKETS = 2000
RATES_NS, RATE_WINDOW_NS = 60 * NS, 1800 * NS  # how often pulses without a passage are counted, and over what time
RATE_PRIOR_S = 600.0  # [s] of a lane's pulses that its settings are worth
FORM = 2  # of evidence packs: with registrations, pulses and verdict
SILENT_BEFORE = "toll.silent_before"  # code of core.toll: the gate line was not seen
SILENT_BETWEEN = "toll.silent_between"  # code of core.toll: the exit line was not seen
UNCHARGED = (PassageState.VOID, PassageState.UNDECIDED, PassageState.SUSPECT)  # as core.toll states it
MAX_STRANGERS = 2000  # crossings without a contract that are not authenticated and wait for their pulse
UNCONFIRMED, NOT_AUTHENTICATED = "unconfirmed", "not authenticated"  # counts
AnyMessage = TypeVar("AnyMessage", bound=Message)


class Settings(Section):
    """How long the ledger waits, and how long it keeps what."""

    registration_limit_s: float = Field(default=300.0, gt=0, le=600.0, description="longest validity of a registration")
    registration_wait_s: float = Field(
        default=15.0,
        ge=0,
        description="time that a registration behind the exit line is waited for, because it may have been lost",
    )
    silence_limit_s: float = Field(
        default=120.0, gt=0, description="time without a statement after which a passage is settled"
    )
    uncharged_kept_s: float = Field(
        default=300.0, gt=0, le=600.0, description="time for which a settled passage without a charge is remembered"
    )
    evidence_kept_days: float = Field(
        default=60.0, gt=0, description="objection period: time for which evidence is kept"
    )
    match_after_s: float = Field(
        default=150.0, gt=0, description="time after which a detector pulse without a crossing is an unmatched one"
    )
    match_gate_s: float = Field(
        default=5.0,
        gt=0,
        description="largest time between a pulse and its crossing, or three standard deviations of that",
    )
    detector_sd_s: float = Field(default=0.1, gt=0, description="standard deviation of a pulse's time")
    detector_missed: float = Field(default=0.01, gt=0, lt=0.5, description="share of vehicles that detectors miss")
    other_pulses_per_s: float = Field(
        default=0.03,
        gt=0,
        le=10.0,
        description="pulses of a lane that are of no vehicle which sends CAM, until the lane has shown how many",
    )
    counted_probability: float = Field(
        default=0.99,
        gt=0.5,
        lt=1.0,
        description="probability that a detector has counted a passage in its lane, below which it goes to review",
    )
    confirm_wait_s: float = Field(
        default=30.0,
        gt=0,
        le=120.0,
        description="time after which a passage that its lane's detector does not confirm goes to review",
    )
    drive_round_s: float = Field(
        default=60.0,
        ge=0,
        le=280.0,
        description="shortest time in which a vehicle can pass the plaza twice; a contract that does it in less goes "
        "to review",
    )
    picture_undecided_s: float = Field(
        default=600.0, gt=0, le=3600.0, description="time after which a camera deletes a picture without a decision"
    )
    picture_kept_days: float = Field(
        default=7.0,
        gt=0,
        le=90.0,
        description="time for which the picture of a review, or of a vehicle without contract, is kept",
    )
    resend_first_s: float = Field(
        default=1.0, gt=0, description="time until a transaction without receipt is sent again; it doubles each time"
    )
    resend_longest_s: float = Field(
        default=60.0, gt=0, description="longest time between two attempts to send a transaction"
    )

    @model_validator(mode="after")
    def _check_times(self) -> "Settings":
        """Refuse times of which one ends what another one still waits for.

        Raises
        ------
        ValueError
            A time is too short.
        """
        passage_s = self.silence_limit_s  # the longest time from one statement on a passage to the next
        least = (
            ("uncharged_kept_s", self.confirm_wait_s, "confirm_wait_s"),
            ("uncharged_kept_s", self.drive_round_s + passage_s, "drive_round_s + silence_limit_s"),
            ("match_after_s", self.confirm_wait_s, "confirm_wait_s"),
            ("picture_undecided_s", self.match_after_s + self.match_gate_s, "match_after_s + match_gate_s"),
        )
        for name, least_s, sum_of in least:
            if getattr(self, name) < least_s:
                raise ValueError(f"{name} is {getattr(self, name):g} s: at least {sum_of}, {least_s:g} s")
        return self


@dataclass(frozen=True)
class PulseMatches:
    """Pulses and crossings that wait for their final account, and which belong to each other."""

    pulses: Mapping[int, Row] = field(default_factory=dict)  # by row
    crossings: Mapping[int, Row] = field(default_factory=dict)  # by number
    found: Mapping[int, int] = field(default_factory=dict)  # number of the crossing by row of the pulse
    given: frozenset[int] = frozenset()  # pulses that have confirmed a charge

    @property
    def pulse_of(self) -> dict[int, Row]:
        """Pulse by number of the crossing."""
        return {number: self.pulses[key] for key, number in self.found.items()}


class PulseTimes:
    """Pulses forward by lane and time."""

    def __init__(self, pulses: Mapping[int, Row]) -> None:
        self._lanes: dict[str, list[tuple[int, int]]] = {}  # time and key, in their order
        for key, row in pulses.items():
            if not row["backward"]:
                self._lanes.setdefault(row["lane"], []).append((row["sampled_ns"], key))
        for pulses_of_lane in self._lanes.values():
            pulses_of_lane.sort()

    def near(self, lane: str | None, time_ns: int, within_ns: int) -> list[int]:
        """Keys of the pulses of a lane within a time from another one."""
        pulses = self._lanes.get(lane or "", [])
        begin = bisect_left(pulses, (time_ns - within_ns, -1))
        return [key for _, key in pulses[begin : bisect_left(pulses, (time_ns + within_ns + 1, -1))]]


class Around:
    """What is around a crossing: pulses, and the other crossings that they may be of."""

    def __init__(self, matched: PulseMatches, settings: Settings, rates: Mapping[str, float]) -> None:
        self.matched, self.times = matched, PulseTimes(matched.pulses)
        self._charged = {matched.found[key] for key in matched.given}  # crossings with a pulse of their own
        self._settings, self._rates = settings, rates
        self._crossings: dict[bool, dict[int, Crossing]] = {True: {}, False: {}}  # by whether they are authenticated
        for number, row in matched.crossings.items():
            self._crossings[bool(row["authenticated"])][number] = _crossing(row)

    def _model(self, crossing: Crossing) -> PulseModel:
        """The model of the lanes that a crossing may be in: the rate is that of the busiest."""
        settings = self._settings
        rates = [rate for lane, rate in self._rates.items() if crossing.probability(lane) > MINIMUM_PROBABILITY]
        return PulseModel(
            settings.detector_sd_s, settings.match_gate_s, settings.detector_missed,
            max(rates, default=settings.other_pulses_per_s),
        )  # fmt: skip

    def _near(self, row: Row) -> tuple[Crossing, list[Row], list[Row], PulseModel]:
        """A crossing with its pulses and rivals; nothing that is not authenticated is a rival of what is."""
        crossing = _crossing(row)
        matched, known = self.matched, bool(row["authenticated"])
        within_ns = round(max(self._settings.match_gate_s, 3.0 * crossing.sd_s) * NS)
        possible = _possible_lanes(crossing)
        others = {
            number: other.time_ns for number, other in self._crossings[known].items()
            if number != crossing.key and number not in self._charged
            and matched.crossings[number]["state"] != PassageState.VOID
            and abs(other.time_ns - crossing.time_ns) <= within_ns and possible & _possible_lanes(other)
        }  # fmt: skip
        rivals = [matched.crossings[number] for number in near(crossing, others)]
        lanes = possible.union(*(_possible_lanes(self._crossings[known][row["number"]]) for row in rivals))
        free = {
            key: matched.pulses[key]["sampled_ns"]
            for lane in sorted(lanes)
            for key in self.times.near(lane, crossing.time_ns, within_ns)
            if self.is_free(key, crossing.key) and (known or not self._is_of_known(key))
        }
        pulses = [matched.pulses[key] for key in near(crossing, free)]
        return crossing, pulses, rivals, self._model(crossing)

    def is_free(self, key: int, number: int) -> bool:
        """Whether a pulse has not confirmed the charge of another crossing than this one."""
        return key not in self.matched.given or self.matched.found[key] == number

    def _is_of_known(self, key: int) -> bool:
        """Whether a pulse is that of an authenticated vehicle."""
        number = self.matched.found.get(key)
        return number is not None and bool(self.matched.crossings[number]["authenticated"])

    def ownership(self, row: Row) -> Ownership | None:
        """Find the pulse with which a crossing was counted."""
        crossing, pulses, rivals, model = self._near(row)
        return ownership(crossing, [_keyed(pulse) for pulse in pulses], [_crossing(rival) for rival in rivals], model)

    def evidence(self, row: Row, probability: float | None) -> PulseAssignment | None:
        """What the ownership of a crossing follows from."""
        if probability is None:
            return None
        _, pulses, rivals, model = self._near(row)
        return PulseAssignment(
            pulses=tuple(map(_pulse_evidence, pulses)),
            rivals=tuple(
                RivalCrossing(
                    crossing_ns=rival.time_ns, crossing_sd_s=rival.sd_s, lane=rival.lane,
                    lanes=_lanes(rival.lanes),
                    modes=tuple(
                        CrossingMode(offset_s=mode.offset_s, sd_s=mode.sd_s, lanes=_lanes(mode.lanes))
                        for mode in rival.modes
                    ),
                )
                for rival in map(_crossing, rivals)
            ),
            detector_sd_s=model.detector_sd_s, missed=model.missed, others_per_s=model.others_per_s,
            least_probability=self._settings.counted_probability, probability=probability,
        )  # fmt: skip


class Ledger:
    """Charges passages, keeps what proves them, and accounts for every detection."""

    def __init__(
        self,
        store: Store,
        plaza: Plaza,
        plaza_file: str,
        settings: Settings,
        now_ns: int,
        *,
        key: KeyFile | None = None,
    ) -> None:
        self._store, self._plaza, self._plaza_file, self._settings = store, plaza, plaza_file, settings
        self.chain = Chain(store, key, plaza.name)
        self.chain.begin()
        self.registrations = Registrations(store, plaza, self.chain)
        self.pictures = Pictures(
            store, plaza, undecided_s=settings.picture_undecided_s, kept_days=settings.picture_kept_days
        )
        self.alarms = Alarms(store, plaza)
        self._replays = Replays(store, key)
        self._started_ns = now_ns
        self.rejects: Counter[str] = Counter()
        self._unregistered: dict[str, TollPassage] = {}  # in progress; in memory only
        self._tickets: dict[str, str] = {}  # of authenticated passages that have ended; in memory only
        # What `core.toll` has used, this process and the one before: time, start of the process, message as JSON.
        self._used: deque[tuple[int, int, str]] = deque()
        self._core_since_ns: int | None = None
        self._asked = False  # for them, by a new process
        self._next_send: dict[str, tuple[int, int]] = {}  # attempts and time of the next, by transaction
        self._numbers: Counter[str] = Counter()  # bookings by kind, up to the row `_summed`: none is ever changed
        self._detectors = {lane.name for lane in plaza.lanes if lane.detector}
        self._directed = {lane.name for lane in plaza.lanes if lane.detector and lane.detector_direction}
        self._lanes = {lane.name: lane for lane in plaza.lanes}
        self._amount_cents = self._summed = 0
        newest = store.row("SELECT max(stored_ns) AS stored_ns FROM evidence")
        newest_ns = newest["stored_ns"] if newest is not None else None
        doubtful = isinstance(newest_ns, int) and now_ns - newest_ns > DOUBTFUL_NS
        self._trusted_ns = now_ns + DAY_NS if doubtful else now_ns  # from when on the date decides what is deleted
        self._rates: Mapping[str, float] = {}  # of pulses that no passage explains, by lane
        self._rates_ns = -RATES_NS
        self._cleaned_ns = 0  # what was settled before and not charged is deleted

    # Received messages

    def use(self, message: Message, now_ns: int) -> None:
        """Store what a message states; those that are not of the ledger's topics change nothing."""
        match message:
            case TollRegistration():
                self.register(message, now_ns)
            case PlazaDetector():
                self.detect(message, now_ns)
            case TollPassage():
                self.passage(message, now_ns)
            case TollReceipt():
                self.receipt(message, now_ns)
            case TollPayment():
                self.pay(message, now_ns)
            case UsedCams():
                self.remember(message)
            case PictureState() if message.plaza == self._plaza.name:
                self.pictures.note(message, now_ns)
            case _:
                pass

    def register(self, message: TollRegistration, now_ns: int) -> None:
        """Store which contract a ticket or a station ID belongs to now, if its signatures hold."""
        until_ns = min(message.valid_until_ns, now_ns + round(self._settings.registration_limit_s * NS))
        if (fault := self.registrations.accept(message, until_ns)) is not None:
            self.rejects[fault] += 1

    def pay(self, message: TollPayment, now_ns: int) -> None:
        """Store that the vehicle at the gate line of a mixed lane has paid otherwise."""
        lane = self._lanes.get(message.lane)
        if message.plaza != self._plaza.name or lane is None:
            self.rejects["another plaza"] += 1
        elif lane.traffic is not LaneTraffic.MIXED:
            self.rejects["payment in a lane for C-ITS only"] += 1
        elif now_ns - DAY_NS < message.sampled_ns < now_ns + HOUR_NS:
            self._store.execute(
                "INSERT OR IGNORE INTO payment (payment, lane, sampled_ns) VALUES (?, ?, ?)",
                message.payment, message.lane, message.sampled_ns,
            )  # fmt: skip

    def detect(self, message: PlazaDetector, now_ns: int) -> None:
        """Store a pulse, and the earlier ones of the message that were lost on the way."""
        if message.plaza != self._plaza.name or message.lane not in self._lanes:
            self.rejects["another plaza"] += 1
            return
        backward = set(message.backward_ns) if message.lane in self._directed else set()
        for number, sampled_ns in enumerate((message.sampled_ns, *message.earlier_ns)):
            if message.pulse < number or not now_ns - DAY_NS < sampled_ns < now_ns + HOUR_NS:
                continue
            if is_closed(self._store, sampled_ns // HOUR_NS * HOUR_NS):
                known = self._store.row(
                    "SELECT 1 FROM pulse WHERE lane = ? AND since_ns = ? AND number = ?",
                    message.lane, message.since_ns, message.pulse - number,
                )  # fmt: skip
                self.rejects["pulse of a closed hour"] += known is None
                continue
            new = self._store.execute(
                "INSERT OR IGNORE INTO pulse (lane, since_ns, number, sampled_ns, backward) VALUES (?, ?, ?, ?, ?)",
                message.lane, message.since_ns, message.pulse - number, sampled_ns, sampled_ns in backward,
            )  # fmt: skip
            if new:
                self._count(message.lane, sampled_ns, "detections")
                self.chain.detections += 1
                self.pictures.take(message.lane, message.since_ns, message.pulse - number, sampled_ns)

    def passage(self, message: TollPassage, now_ns: int) -> None:
        """Follow a passage, and settle it when its state is final."""
        if (message.plaza, message.plaza_digest) != (self._plaza.name, self._plaza.digest):
            self.rejects["another plaza"] += 1
        elif self._store.execute("UPDATE settled SET final_ns = ? WHERE passage_id = ?", now_ns, message.passage_id):
            if message.state in (PassageState.VOID, PassageState.SUSPECT) and not self._is_turned(message):
                self._withdraw(message.passage_id, message.state, _why(message), now_ns)
        else:
            self._follow(message, now_ns)

    def _is_turned(self, message: TollPassage) -> bool:
        """Whether a statement repeats that a vehicle has turned around, and the detector has not decided yet."""
        row = self._store.row("SELECT charged FROM held WHERE passage_id = ?", message.passage_id)
        return row is not None and (
            self._read(TollPassage, row["charged"], message.passage_id).state is PassageState.VOID
        )

    def receipt(self, message: TollReceipt, now_ns: int) -> None:
        """Take a transaction out of the outbox; what the operator does not accept is reversed."""
        if not self._store.row("SELECT 1 FROM booking WHERE transaction_id = ?", message.transaction_id):
            self.rejects["receipt of an unknown transaction"] += 1
            return
        self._store.execute(
            "INSERT OR IGNORE INTO receipt VALUES (?, ?, ?)",
            message.transaction_id, now_ns, message.model_dump_json(exclude_none=True),
        )  # fmt: skip
        self._store.execute("DELETE FROM outbox WHERE transaction_id = ?", message.transaction_id)
        self._next_send.pop(message.transaction_id, None)
        if not message.accepted:
            why = explain(Code.NOT_ACCEPTED, operator=_quoted(message.operator), answer=_quoted(message.reason))
            self._reverse(message.passage_id, stated(why), now_ns)

    def remember(self, used: UsedCams) -> None:
        """Keep the CAM that `core.toll` has used, in memory only; a new process gets those of the one before."""
        self._asked = self._asked or used.since_ns != self._core_since_ns
        self._core_since_ns = used.since_ns
        if used.anew:
            self._used.clear()
        if used.cams or used.deltas:
            self._used.append((used.sampled_ns, used.since_ns, used.model_dump_json(exclude_none=True)))
        self._forget_used(used.sampled_ns)

    def _forget_used(self, now_ns: int) -> None:
        while self._used and now_ns - self._used[0][0] > USED_RETENTION_NS:
            self._used.popleft()

    # Periodic work

    def expire(self, now_ns: int) -> None:
        """Settle passages that fell silent, and delete what may not be kept longer.

        After a start more than 30 days behind the newest evidence, evidence stays for another day: the clock may have
        jumped ahead, and who sees its date has the time to correct it.
        """
        silent_ns = now_ns - round(self._settings.silence_limit_s * NS)
        if self._started_ns < silent_ns:
            rows = self._store.rows("SELECT * FROM passage WHERE sampled_ns < ?", silent_ns)
            for row in rows:
                self._end_silent(row, now_ns)
            for passage in [p for p in self._unregistered.values() if p.sampled_ns < silent_ns]:
                state = PassageState.VOID if passage.crossing_ns is None else PassageState.UNDECIDED
                self._settle(passage, state, stated(explain(Code.NO_STATEMENT)), now_ns)
        kept_ns = now_ns - round(self._settings.uncharged_kept_s * NS)
        self.registrations.expire(now_ns)
        self.pictures.expire(now_ns)
        self.alarms.expire(kept_ns)
        self._store.execute("DELETE FROM payment WHERE sampled_ns < ?", now_ns - DAY_NS)
        self._close_hours(now_ns)
        self._forget_used(now_ns)
        self._store.execute("DELETE FROM chain WHERE to_ns < ?", kept_ns)
        self._forget_reviews("since_ns >= ? AND since_ns < ? AND NOT EXISTS (SELECT 1 FROM evidence "
                             "WHERE evidence.passage_id = review.passage_id)", self._cleaned_ns, kept_ns)  # fmt: skip
        self._store.execute(
            "DELETE FROM settled WHERE final_ns >= ? AND final_ns < ? "
            "AND NOT EXISTS (SELECT 1 FROM booking WHERE booking.passage_id = settled.passage_id) "
            "AND NOT EXISTS (SELECT 1 FROM held WHERE held.passage_id = settled.passage_id) "
            "AND NOT EXISTS (SELECT 1 FROM review WHERE review.passage_id = settled.passage_id)",
            self._cleaned_ns, kept_ns,
        )  # fmt: skip
        self._cleaned_ns = max(self._cleaned_ns, kept_ns)
        self._store.execute("DELETE FROM pulse WHERE sampled_ns < ? AND done", now_ns - DAY_NS)
        if now_ns < self._trusted_ns:
            return
        evidence_ns = now_ns - round(self._settings.evidence_kept_days * DAY_NS)
        if self._store.execute("DELETE FROM evidence WHERE stored_ns < ?", evidence_ns):
            self.chain.evidence_deleted(evidence_ns, now_ns)
            self._replays.expire(evidence_ns)
        self.chain.refresh(now_ns)
        self._forget_reviews("since_ns < ?", evidence_ns)

    def _forget_reviews(self, condition: str, *values: int) -> None:
        """Delete reviews and, where nothing is booked, what else is left of their passages."""
        for row in self._store.rows(f"SELECT passage_id FROM review WHERE {condition}", *values):
            self._store.execute("DELETE FROM review WHERE passage_id = ?", row["passage_id"])
            self._store.execute(
                "DELETE FROM settled WHERE passage_id = ? AND NOT EXISTS (SELECT 1 FROM booking "
                "WHERE booking.passage_id = settled.passage_id)", row["passage_id"],
            )  # fmt: skip

    def reconcile(self, now_ns: int) -> None:
        """Charge what detectors confirm, and account for pulses that are old enough.

        Each pulse belongs to a passage, or its vehicle was missed.
        """
        self._confirm(self._matched(), now_ns)
        matched = self._matched()
        ripe_ns = now_ns - round(self._settings.match_after_s * NS)
        crossings, found = dict(matched.crossings), matched.found
        for row in matched.pulses.values():
            if row["sampled_ns"] >= ripe_ns:
                continue
            crossing = crossings.pop(found[row["rowid"]], None) if row["rowid"] in found else None
            outcome = self._outcome(row, crossing)
            self._count(row["lane"], row["sampled_ns"], outcome)
            self.pictures.settle(row, outcome)
            is_missed = outcome == PassageState.MISSED
            self._store.execute("UPDATE pulse SET done = ? WHERE rowid = ?", 2 if is_missed else 1, row["rowid"])
            if crossing:
                self._store.execute("DELETE FROM crossing WHERE number = ?", crossing["number"])
        waiting = set(found.values())
        held = {row["passage_id"] for row in self._store.rows("SELECT passage_id FROM held")}
        late_ns = ripe_ns - round(self._settings.match_gate_s * NS)
        for number, row in crossings.items():
            if row["crossing_ns"] < late_ns and number not in waiting and row["passage_id"] not in held:
                if row["state"] == PassageState.CHARGED:
                    self._count(row["lane"], row["crossing_ns"], self._without_detection(row["lane"]))
                self._store.execute("DELETE FROM crossing WHERE number = ?", number)

    def _outcome(self, pulse: Row, crossing: Row | None) -> str:
        """Name what came of a pulse: of its passage, of a payment, or nothing known."""
        if pulse["backward"]:
            return PassageState.VOID
        outcome = PassageState.MISSED if crossing is None else _state_of(crossing)
        if outcome in (PassageState.MISSED, PassageState.UNREGISTERED) and self._is_paid(pulse):
            return PAID_OTHERWISE
        return outcome

    def _is_paid(self, pulse: Row) -> bool:
        """Whether a payment of the lane is that of a pulse; the nearest one settles it, and no other pulse."""
        gate_ns = round(self._settings.match_gate_s * NS)
        row = self._store.row(
            "SELECT payment FROM payment WHERE lane = ? AND NOT done AND abs(sampled_ns - ?) <= ? "
            "ORDER BY abs(sampled_ns - ?) LIMIT 1", pulse["lane"], pulse["sampled_ns"], gate_ns, pulse["sampled_ns"],
        )  # fmt: skip
        if row is not None:
            self._store.execute("UPDATE payment SET done = 1 WHERE payment = ?", row["payment"])
        return row is not None

    def _close_hours(self, now_ns: int) -> None:
        """Close the accounts of hours that are over, once no outcome of them can change any more."""
        settings = self._settings
        late_ns = round((settings.match_after_s + settings.match_gate_s + settings.silence_limit_s) * NS)
        over_ns = (now_ns - late_ns) // HOUR_NS * HOUR_NS
        if now_ns - self._started_ns < late_ns:  # pulses of an outage come with the next ones
            return
        waits = (
            "SELECT 1 FROM pulse WHERE NOT done AND sampled_ns < ?", "SELECT 1 FROM crossing WHERE crossing_ns < ?"
        )  # fmt: skip
        if not any(self._store.row(f"{query} LIMIT 1", over_ns) for query in waits):
            close(self._store, over_ns)

    def _matched(self) -> PulseMatches:
        """Assign the pulses and crossings that are not accounted for yet.

        The pulse of a charge stays its own. Then those of authenticated vehicles: nothing that is not authenticated
        takes a pulse from them.
        """
        pulses = {row["rowid"]: row for row in self._store.rows("SELECT rowid, * FROM pulse WHERE NOT done")}
        crossings = {row["number"]: row for row in self._store.rows("SELECT * FROM crossing")}
        number_of = {row["passage_id"]: number for number, row in crossings.items() if row["passage_id"]}
        found = {
            key: number_of[row["owner"]] for key, row in pulses.items()
            if not row["backward"] and row["owner"] in number_of
        }  # fmt: skip
        given = frozenset(found)
        owners = set(found.values())
        for authenticated in (True, False):
            found |= match(
                [
                    _keyed(row)
                    for key, row in pulses.items() if key not in found and not row["backward"]
                ],
                [
                    _crossing(row)
                    for number, row in crossings.items()
                    if number not in owners and bool(row["authenticated"]) is authenticated
                ],
                detector_sd_s=self._settings.detector_sd_s,
                gate_s=self._settings.match_gate_s,
            )  # fmt: skip
        return PulseMatches(pulses, crossings, found, given)

    def _without_detection(self, lane: str) -> str:
        """Name the count of a charge without a pulse: a fault only where there is a detector."""
        return "charged_without_detection" if lane in self._detectors else "unconfirmed"

    def _confirm(self, matched: PulseMatches, now_ns: int) -> None:
        """Charge the held passages whose pulse is there; send to review what detectors contradict."""
        pulse_of = matched.pulse_of
        rows = {row["passage_id"]: row for row in matched.crossings.values() if row["passage_id"]}
        turned = {passage_id: row for passage_id, row in rows.items() if row["state"] == PassageState.VOID}
        held = {row["passage_id"] for row in self._store.rows("SELECT passage_id FROM held")} if turned else set()
        counted = [(row, pulse_of[row["number"]]) for row in turned.values() if row["number"] in pulse_of]
        back_of = self._pulses_backward(counted, held)
        for passage_id, row in turned.items():
            pulse, back = pulse_of.get(row["number"]), back_of.get(passage_id)
            self._judge_turned(matched, row, pulse, back, now_ns, is_held=passage_id in held)
        around = Around(matched, self._settings, self._others_per_s(now_ns))
        named = {other for row in rows.values() if row["overlaps"] != "[]" for other in json.loads(row["overlaps"])}
        claims = {
            passage_id: self._claim(row, pulse_of.get(row["number"]), around, now_ns)
            for passage_id, row in rows.items()
            if passage_id not in turned
            and (row["state"] == PassageState.HELD or row["overlaps"] != "[]" or passage_id in named)
        }  # fmt: skip
        claims = self._with_links(claims)
        for group in groups(claims):
            is_held = any(rows[claim.passage_id]["state"] == PassageState.HELD for claim in group)
            if not is_held and not any(claim.overlaps for claim in group):
                continue
            judgement = judge(group, {claim.passage_id for claim in group})
            if judgement.verdict is not Verdict.WAITS:
                self._carry_out(judgement, group, rows, around, now_ns)

    def _with_links(self, claims: dict[str, Claim]) -> dict[str, Claim]:
        """Link what is not authenticated to the authenticated vehicles that it overlaps, not the other way round."""
        linked = dict(claims)
        for claim in claims.values():
            if not claim.authenticated:
                continue
            others = {other for other in claim.overlaps if other in claims and not claims[other].authenticated}
            linked[claim.passage_id] = replace(claim, overlaps=claim.overlaps - others)
            for other in others:
                linked[other] = replace(linked[other], overlaps=linked[other].overlaps | {claim.passage_id})
                self._store.execute(
                    "UPDATE crossing SET overlaps = ? WHERE passage_id = ?", json.dumps(sorted(linked[other].overlaps)),
                    other,
                )  # fmt: skip
        return linked

    def _carry_out(
        self, judgement: Judgement, group: list[Claim], rows: Mapping[str, Row], around: "Around", now_ns: int
    ) -> None:
        """Charge, review or drop the passages of a group."""
        matched = around.matched
        members = {claim.passage_id for claim in group}
        pulses = [matched.pulses[claim.pulse] for claim in group if claim.pulse is not None]
        for claim in group:
            passage_id, row = claim.passage_id, rows[claim.passage_id]
            self._store.execute("UPDATE crossing SET overlaps = '[]' WHERE passage_id = ?", passage_id)
            others = sorted(members - {passage_id})
            if judgement.verdict is Verdict.REVIEW and judgement.why is not None:
                for pulse in pulses:
                    self.pictures.disputed(pulse)
                self._review(passage_id, judgement.why, others, now_ns)
            elif judgement.verdict is Verdict.GHOSTS:
                if claim.pulse is None:
                    self._drop_ghost(row, None, now_ns)
            elif passage_id in judgement.ghosts:
                self._drop_ghost(row, min(judgement.charged), now_ns)
            elif passage_id in judgement.charged:
                pulse = matched.pulses[judgement.charged[passage_id]]
                self._give_pulse(row, pulse)
                if row["state"] == PassageState.HELD:
                    self._charge_held(
                        passage_id, now_ns, pulses=[pulse], verdict=judgement.why, ghosts=judgement.ghosts
                    )
            elif row["state"] == PassageState.HELD:
                self._let_stand(claim, row, around, now_ns)

    def _let_stand(self, claim: Claim, row: Row, around: "Around", now_ns: int) -> None:
        """Charge a passage with the pulse that is its own, in the lane of that where its CAM leave the lane open."""
        own = [around.matched.pulses[claim.pulse]] if claim.pulse is not None else []
        for pulse in own:
            self._give_pulse(row, pulse)
        verdict = None
        if row["lane"] is None and claim.probability is not None:
            verdict = explain(Code.LANE_BY_PULSE, probability=claim.probability)
        assignment = around.evidence(row, claim.probability)
        self._charge_held(claim.passage_id, now_ns, pulses=own, verdict=verdict, assignment=assignment)

    def _give_pulse(self, row: Row, pulse: Row) -> None:
        """Assign a pulse to a passage that is charged: it confirms no other one, and ghosts cross nothing any more."""
        self._store.execute("UPDATE pulse SET owner = NULL WHERE owner = ? AND NOT backward", row["passage_id"])
        self._store.execute("UPDATE pulse SET owner = ? WHERE rowid = ?", row["passage_id"], pulse["rowid"])
        self._store.execute(
            "UPDATE crossing SET crossing_ns = ?, lane = ?, modes = '[]' WHERE number = ?",
            pulse["sampled_ns"], pulse["lane"], row["number"],
        )  # fmt: skip

    def _drop_ghost(self, row: Row, charged: str | None, now_ns: int) -> None:
        """Settle a station that no detector has counted; the pack of the vehicle that was there names it."""
        others = json.loads(row["overlaps"])
        there = charged or (others[0] if others else row["passage_id"])
        why = stated(explain(Code.GHOST, passage=passage_of(there)))
        self._change(row["passage_id"], state=PassageState.SUSPECT, reason=why.text, reason_code=why.code)
        self._store.execute("DELETE FROM crossing WHERE number = ?", row["number"])
        self.alarms.ghost(
            row["passage_id"], row["lane"], row["crossing_ns"], self._tickets.get(row["passage_id"]), now_ns
        )

    def _judge_turned(
        self, matched: PulseMatches, row: Row, pulse: Row | None, back: Row | None, now_ns: int, *, is_held: bool
    ) -> None:
        """Decide on a vehicle that says it has turned around behind the gate line, or fell silent before it.

        The detector decides: without a pulse it has not passed, and neither with one backwards behind it, of its own.
        Otherwise it is reviewed, or counts as a vehicle without contract.
        """
        waited = now_ns - row["settled_ns"] >= round(self._settings.confirm_wait_s * NS)
        if pulse is not None and back is None:
            is_silent = is_held and self._silent(row["passage_id"]) is not None
            if is_held and (waited or (row["lane"] not in self._directed and not is_silent)):
                self.pictures.disputed(pulse)
                code = Code.SILENT_COUNTED if is_silent else Code.TURNED_COUNTED
                self._review(row["passage_id"], explain(code), [], now_ns)
            elif not is_held:
                self._store.execute(
                    "UPDATE crossing SET state = ? WHERE number = ?", PassageState.UNREGISTERED, row["number"]
                )
        elif is_held and waited:
            if back is None and (silent := self._silent(row["passage_id"])) is not None:
                if self._passed_late(silent, matched, now_ns):
                    return
                if now_ns < self._silent_times(silent)[1] + round(self._settings.confirm_wait_s * NS):
                    return
            self._store.execute("DELETE FROM held WHERE passage_id = ?", row["passage_id"])
            if back is not None:
                self._store.execute("UPDATE pulse SET owner = ? WHERE rowid = ?", row["passage_id"], back["rowid"])

    def _silent(self, passage_id: str) -> TollPassage | None:
        """Final statement of a held passage whose vehicle fell silent before the gate line; None: it did not."""
        held = self._store.row("SELECT charged FROM held WHERE passage_id = ?", passage_id)
        if held is None:
            return None
        message = self._read(TollPassage, held["charged"], passage_id)
        why = message.reason_code
        return message if why is not None and why.code == SILENT_BEFORE else None

    def _passed_late(self, message: TollPassage, matched: PulseMatches, now_ns: int) -> bool:
        """Review a vehicle that fell silent before the gate line, if a pulse that nothing explains may be its own.

        It may have stood there without its radio, and have gone on. A pulse is judged when the passage of who caused
        it has had the time to be stated; if the vehicle was charged, or is to be, under another ID, nothing is open.
        """
        if self._is_seen_again(message):
            return False
        ripe_ns = now_ns - round(self._settings.confirm_wait_s * NS)
        from_ns, until_ns = self._silent_times(message)
        pulse = self._unexplained_pulse(message, matched, from_ns, min(until_ns, ripe_ns))
        if pulse is None:
            return False
        self.pictures.disputed(pulse)
        self._review(message.passage_id, explain(Code.SILENT_COUNTED), [], now_ns)
        return True

    def _silent_times(self, message: TollPassage) -> tuple[int, int]:
        """From its last CAM, when a vehicle that fell silent before the gate line may have crossed it.

        The crossing that is stated for it lies at most two standard deviations, or 2 s, behind that CAM.
        """
        last_ns = (message.crossing_ns or message.sampled_ns) - round(2.0 * (message.crossing_sd_s or 1.0) * NS)
        return last_ns, last_ns + round(self._settings.silence_limit_s * NS)

    def _is_seen_again(self, message: TollPassage) -> bool:
        """Whether a vehicle has crossed the gate line in another passage after this one was opened."""
        held = self._store.row("SELECT * FROM held WHERE passage_id = ?", message.passage_id)
        contracts = self._contracts_of_held(held) if held is not None else set()
        return any(
            self._store.row(
                "SELECT 1 FROM chain WHERE name = ? AND passage_id <> ? AND crossing_ns BETWEEN ? AND ?",
                name, message.passage_id, message.opened_ns, self._silent_times(message)[1],
            )
            for name in _names(message, contracts)
        )  # fmt: skip

    def _pulses_backward(self, turned: Sequence[tuple[Row, Row]], held: Collection[str]) -> dict[str, Row]:
        """Assign pulses backwards to vehicles that say they have turned around, at most one to one.

        A pulse is of a vehicle that was counted forward in its lane before it. Of several it is that of the one whose
        statement comes first; what is not authenticated, or has no contract, takes none from the others.

        Parameters
        ----------
        turned : sequence of pairs
            Crossing, and its pulse forward.
        held : collection of str
            IDs of those that have a contract.

        Returns
        -------
        dict
            Pulse by ID of the passage.
        """
        if not turned:
            return {}
        gate_ns = round(self._settings.match_gate_s * NS)
        waiting = sorted(turned, key=lambda pair: (
            not pair[0]["authenticated"], pair[0]["passage_id"] not in held, pair[0]["settled_ns"], pair[0]["number"],
        ))  # fmt: skip
        backward = self._store.rows(
            "SELECT rowid, * FROM pulse WHERE backward AND sampled_ns > ? ORDER BY sampled_ns",
            min(pulse["sampled_ns"] for _, pulse in turned),
        )  # fmt: skip
        found = {back["owner"]: back for back in backward if back["owner"] is not None}
        for back in (back for back in backward if back["owner"] is None):
            for row, pulse in waiting:
                passage_id, until_ns = row["passage_id"], row["settled_ns"] + gate_ns
                is_after = pulse["sampled_ns"] < back["sampled_ns"] <= until_ns and back["lane"] == pulse["lane"]
                if is_after and passage_id not in found:
                    found[passage_id] = back
                    break
        return found

    def _others_per_s(self, now_ns: int) -> Mapping[str, float]:
        """Rate of each lane's pulses that no passage explains, as far as it has shown one; computed once a minute.

        A lane in which few vehicles send CAM has many: there a pulse says less of who has caused it. The time is that
        since the oldest pulse that is stored: a restart changes nothing.
        """
        if not 0 <= now_ns - self._rates_ns < RATES_NS:
            self._rates_ns = now_ns
            settings = self._settings
            from_ns = now_ns - RATE_WINDOW_NS
            rows = self._store.rows(
                "SELECT lane, COUNT(*) AS n FROM pulse WHERE done = 2 AND sampled_ns > ? GROUP BY lane", from_ns
            )
            oldest = self._store.row("SELECT MIN(sampled_ns) AS ns FROM pulse WHERE sampled_ns > ?", from_ns)
            since_ns = now_ns if oldest is None or oldest["ns"] is None else oldest["ns"]
            prior_s, seen_s = RATE_PRIOR_S, max((now_ns - since_ns) / NS, 0.0)
            counts = {row["lane"]: row["n"] for row in rows}
            self._rates = {
                lane: max(
                    settings.other_pulses_per_s,
                    (settings.other_pulses_per_s * prior_s + counts.get(lane, 0)) / (prior_s + seen_s),
                )
                for lane in self._detectors
            }
        return self._rates

    def _claim(self, row: Row, pulse: Row | None, around: "Around", now_ns: int) -> Claim:
        def sds_of(other: Row) -> float:
            away_s = abs(other["sampled_ns"] - row["crossing_ns"]) * 1e-9
            return float(away_s / hypot(row["sd_s"], self._settings.detector_sd_s))

        held = self._store.row("SELECT crossed FROM held WHERE passage_id = ?", row["passage_id"])
        crossed = self._read(TollPassage, held["crossed"], row["passage_id"]) if held else None
        within_ns = round(TIGHT_SD * hypot(row["sd_s"], self._settings.detector_sd_s) * NS)
        near_it = around.times.near(row["lane"], row["crossing_ns"], within_ns)
        explains = [key for key in near_it if around.is_free(key, row["number"])]
        owned = around.ownership(row) if row["state"] == PassageState.HELD else None
        if owned is not None and owned.probability >= self._settings.counted_probability:
            pulse = around.matched.pulses[owned.pulse.key]
        return Claim(
            passage_id=row["passage_id"],
            overlaps=frozenset(json.loads(row["overlaps"])),
            has_detector=self._is_counted(row["lane"], json.loads(row["lanes"])),
            is_charge=row["state"] in (PassageState.CHARGED, PassageState.HELD),
            is_derivable=crossed is None or crossed.derivable,
            pulse_sds=None if pulse is None else sds_of(pulse),
            authenticated=bool(row["authenticated"]),
            pulse=None if pulse is None else pulse["rowid"],
            explains=frozenset(explains),
            has_second=pulse is not None
            and not all(is_one_vehicle(_keyed(pulse), _keyed(around.matched.pulses[key])) for key in explains),
            is_counted=row["state"] != PassageState.HELD
            or (owned is not None and owned.probability >= self._settings.counted_probability),
            probability=None if owned is None else owned.probability,
            has_lane=row["lane"] is not None,
            waited=now_ns - row["settled_ns"] >= round(self._settings.confirm_wait_s * NS),
        )

    def _is_counted(self, lane: str | None, lanes: Mapping[str, float]) -> bool:
        """Whether a vehicle is counted wherever it may have crossed the gate line."""
        if lane is not None:
            return lane in self._detectors
        possible = {name for name, probability in lanes.items() if probability > MINIMUM_PROBABILITY}
        return bool(possible) and possible <= self._detectors

    def _read(self, kind: type[AnyMessage], text: str, passage_id: str) -> AnyMessage:
        """Read a stored message.

        Raises
        ------
        LedgerFault
            The row is damaged: the text names the passage.
        """
        try:
            return kind.model_validate_json(text)
        except ValidationError as error:
            raise self._store.damaged(f"a row of passage {passage_id[:8]}", error) from error

    # Published messages

    def due(self, now_ns: int) -> list[TollTransaction]:
        """List the transactions to send now: those without a receipt, again after growing pauses."""
        rows = self._store.rows(
            "SELECT outbox.transaction_id, content FROM outbox JOIN booking USING (transaction_id) "
            "ORDER BY outbox.rowid LIMIT 100"
        )
        found = []
        for row in rows:
            attempts, next_ns = self._next_send.get(row["transaction_id"], (0, 0))
            if now_ns < next_ns:
                continue
            pause_s = min(self._settings.resend_first_s * 2.0**attempts, self._settings.resend_longest_s)
            self._next_send[row["transaction_id"]] = (min(attempts + 1, 30), now_ns + round(pause_s * NS))
            content = self._read(TollTransaction, row["content"], row["transaction_id"])
            seal = self.chain.seal(content.transaction_id)
            found.append(content.model_copy(update={"attempt": attempts + 1, "seal": seal}))
        return found

    def restored(self) -> list[RestoredCams]:
        """List what a new process of `core.toll` asks for, once; empty if none has asked, or nothing is kept."""
        if not self._asked or self._core_since_ns is None:
            return []
        self._asked = False
        mine = self._core_since_ns
        return [
            RestoredCams(since_ns=mine, used=UsedCams.model_validate_json(used))
            for _, since_ns, used in self._used
            if since_ns != mine
        ]

    def reviews(self) -> list[TollReview]:
        """List the passages to review that are not published yet."""
        rows = self._store.rows("SELECT content, passage_id FROM review WHERE NOT sent ORDER BY since_ns LIMIT 100")
        return [self._read(TollReview, row["content"], row["passage_id"]) for row in rows]

    def reviewed(self, sent: TollReview) -> None:
        """Note that a review is published; a kill before that repeats it."""
        self._store.execute("UPDATE review SET sent = 1 WHERE passage_id = ?", sent.passage_id)

    def open_passages(self, now_ns: int) -> OpenPassages:
        """List what `core.toll` continues after a restart, and what it need not repeat."""
        rows = self._store.rows("SELECT passage_id, statement FROM passage ORDER BY sampled_ns DESC LIMIT 300")
        stored = tuple(self._read(TollPassage, row["statement"], row["passage_id"]) for row in rows)
        open_ = stored + tuple(self._unregistered.values())[: PASSAGES - len(stored)]
        passages = fitting(open_, PASSAGES_BYTES)
        if len(passages) < len(open_):
            self.rejects["passages left out"] += len(open_) - len(passages)
        recently_ns = now_ns - round(self._settings.uncharged_kept_s * NS)
        settled = self._store.rows(
            "SELECT passage_id FROM settled WHERE final_ns >= ? ORDER BY final_ns DESC LIMIT ?",
            recently_ns,
            MAX_SETTLED,
        )
        return OpenPassages(
            sampled_ns=now_ns,
            passages=tuple(passages),
            settled=tuple(row["passage_id"] for row in settled),
            registered=tuple(self.registrations.listed(now_ns, STATIONS)),
            since_ns=self._started_ns,
            core_since_ns=None if self._asked else self._core_since_ns,
        )

    def state(self, now_ns: int) -> LedgerState:
        """Sum up charges, outbox and the account of this hour and the last."""
        for row in self._store.rows(
            "SELECT rowid, kind, amount_cents, json_extract(content, '$.confirmed') AS confirmed, "
            "json_extract(content, '$.authenticated') AS authenticated FROM booking WHERE rowid > ?", self._summed,
        ):  # fmt: skip
            self._summed = row["rowid"]
            self._numbers[row["kind"]] += 1
            self._numbers[UNCONFIRMED] += row["kind"] == TransactionKind.CHARGE and not row["confirmed"]
            self._numbers[NOT_AUTHENTICATED] += row["kind"] == TransactionKind.CHARGE and not row["authenticated"]
            self._amount_cents += row["amount_cents"]
        last = self._store.row("SELECT MAX(received_ns) AS ns FROM receipt")
        outbox = self._store.row("SELECT COUNT(*) AS n FROM outbox")
        held = self._store.row("SELECT COUNT(*) AS n FROM held")
        since_ns = now_ns // HOUR_NS * HOUR_NS - HOUR_NS
        reviews = self._store.row("SELECT COUNT(*) AS n FROM review WHERE since_ns >= ?", since_ns)
        return LedgerState(
            now_ns=now_ns,
            plaza=self._plaza.name,
            transactions=self._numbers[TransactionKind.CHARGE],
            reversals=self._numbers[TransactionKind.REVERSAL],
            amount_cents=self._amount_cents,
            held=held["n"] if held else 0,
            in_review=reviews["n"] if reviews else 0,
            unconfirmed=self._numbers[UNCONFIRMED],
            outbox=outbox["n"] if outbox else 0,
            last_receipt_ns=last["ns"] if last else None,
            lanes=self.balances(since_ns),
            recent=self._recent(),
            require_authenticated=self._plaza.require_authenticated,
            not_authenticated=self._numbers[NOT_AUTHENTICATED],
            reviews=self._open_reviews(),
            pictures=self.pictures.kept(),
            pictures_kept=self.pictures.count(PictureAction.KEEP),
            pictures_waiting=self.pictures.count(PictureAction.TAKE),
            pictures_failed=self.pictures.failed,
            alarms=self.alarms.count(since_ns),
            newest_alarm=self.alarms.newest(),
        )

    def _open_reviews(self) -> tuple[ReviewSummary, ...]:
        """The newest passages that a person has to judge, and what decides each."""
        rows = self._store.rows("SELECT content, passage_id FROM review ORDER BY since_ns DESC LIMIT ?", SHOWN_REVIEWS)
        reviews = [self._read(TollReview, row["content"], row["passage_id"]) for row in rows]
        return tuple(
            ReviewSummary(
                passage_id=review.passage_id, since_ns=review.sampled_ns, lane=review.lane,
                crossing_ns=review.crossing_ns, contracts=len(review.contracts) or int(review.contract is not None),
                authenticated=review.authenticated, reversed=review.reversed, reason=review.reason,
                reason_code=review.reason_code, decided_by_code=review.decided_by,
                decided_by=reason(review.decided_by) if review.decided_by else "",
            )
            for review in reviews
        )  # fmt: skip

    def head(self, now_ns: int) -> LedgerHead | None:
        """Give the newest signed statement for the operator, once; None if it has not changed."""
        statement = self.chain.head()
        if statement is None:
            return None
        return LedgerHead(sampled_ns=now_ns, plaza=self._plaza.name, statement=statement)

    def balances(self, since_ns: int) -> tuple[LaneBalance, ...]:
        """Account for the detections of each lane and hour from a time on.

        What is not closed yet has the outcome of the passage that explains it now; without one it is pending.
        """
        rows = self._store.rows("SELECT * FROM balance WHERE hour_ns >= ?", since_ns)
        counts = Counter({(row["hour_ns"], row["lane"], row["outcome"]): row["n"] for row in rows})
        matched = self._matched()
        for key, row in matched.pulses.items():
            place = (row["sampled_ns"] // HOUR_NS * HOUR_NS, row["lane"])
            number = matched.found.get(key)
            outcome = PassageState.VOID if row["backward"] else "pending"
            counts[*place, outcome if number is None else _state_of(matched.crossings[number])] += 1
            counts[*place, "provisional"] += number is not None
        explained = set(matched.found.values())
        for number, row in matched.crossings.items():
            if row["state"] == PassageState.CHARGED and number not in explained and row["lane"] not in self._detectors:
                counts[row["crossing_ns"] // HOUR_NS * HOUR_NS, row["lane"], "unconfirmed"] += 1
        return tuple(
            _balance(lane, hour_ns, {name: n for (*place, name), n in counts.items() if place == [hour_ns, lane]})
            for hour_ns, lane in sorted({key[:2] for key in counts})
            if hour_ns >= since_ns
        )

    def evidence(self, passage_id: str) -> bytes | None:
        """Give the evidence pack of a charge as JSON.

        Raises
        ------
        LedgerFault
            The pack is damaged.
        """
        row = self._store.row("SELECT pack, digest FROM evidence WHERE passage_id = ?", passage_id)
        if row is None:
            return None
        try:
            pack = unpacked(row["pack"], "zlib", MIN_LIMIT_BYTES)
        except BadPack as error:
            raise self._store.damaged(f"the evidence of passage {passage_id[:8]}", error) from error
        if hashlib.sha256(pack).hexdigest() != row["digest"]:
            raise self._store.damaged(f"the evidence of passage {passage_id[:8]}", "it has another digest")
        return pack

    # One passage

    def _follow(self, message: TollPassage, now_ns: int) -> None:
        stored = self._store.row("SELECT * FROM passage WHERE passage_id = ?", message.passage_id)
        if stored and not self._is_as_sealed("passage", stored):
            self._settle(message, PassageState.SUSPECT, stated(explain(Code.CHANGED)), now_ns)
            return
        registrations = self._registered(message, stored["registrations"] if stored else "[]")
        contracts = contracts_of(registrations)
        crossed = (
            self._read(TollPassage, stored["crossed"], message.passage_id) if stored and stored["crossed"] else None
        )
        if len(contracts) > 1 and message.state.is_final and message.state not in UNCHARGED:
            code = Code.TWO_CONTRACTS if len({name for name, _ in contracts}) > 1 else Code.TWO_CLASSES
            self._settle(message, PassageState.SUSPECT, stated(explain(code)), now_ns, contracts)
            return
        if message.state.is_final and self._merge(message, contracts, now_ns):
            return
        if message.state.is_final:
            self._end(message, crossed, registrations, now_ns)
        elif not contracts:
            newest = self._unregistered.get(message.passage_id, message)
            if message.sampled_ns >= newest.sampled_ns:
                self._unregistered[message.passage_id] = message.model_copy(update={"evidence": None})
        elif not stored or message.sampled_ns >= stored["sampled_ns"]:
            self._unregistered.pop(message.passage_id, None)
            with_evidence = message if message.evidence else crossed
            content = (
                message.sampled_ns, message.model_copy(update={"evidence": None}).model_dump_json(exclude_none=True),
                with_evidence.model_dump_json(exclude_none=True) if with_evidence else None, _as_text(registrations),
            )  # fmt: skip
            self._store.execute(
                "INSERT OR REPLACE INTO passage VALUES (?, ?, ?, ?, ?, ?)",
                message.passage_id, *content, self.chain.row_seal("passage", message.passage_id, *content),
            )  # fmt: skip

    def _end(
        self, message: TollPassage, crossed: TollPassage | None, registrations: list[TollRegistration], now_ns: int
    ) -> None:
        """Use the final statement on a passage."""
        contracts, crossing_ns = contracts_of(registrations), message.crossing_ns
        at_ns = crossing_ns or message.sampled_ns
        if message.state is PassageState.CHARGED or (message.state is PassageState.UNDECIDED and contracts):
            self._charge(message, crossed, registrations, now_ns)
        elif message.state is PassageState.VOID and contracts and crossing_ns and self._may_be_counted(message):
            self._hold(message, crossed or message, registrations, now_ns, PassageState.VOID)
        elif message.state is PassageState.UNREGISTERED and self.registrations.is_of_another(message, at_ns):
            self._settle(message, PassageState.SUSPECT, stated(explain(Code.IDENTITY)), now_ns)
        else:
            self._settle(message, message.state, _why(message), now_ns, contracts)

    def _may_be_counted(self, message: TollPassage) -> bool:
        """Whether a detector can say that a vehicle was at the gate line."""
        return message.lane in self._detectors if message.lane is not None else bool(self._detectors)

    def _end_silent(self, row: Row, now_ns: int) -> None:
        """End a passage of a contract that `core.toll` states nothing more of: it may have stopped, the vehicle not.

        What has crossed is left to a person, and so is what may be the vehicle of a pulse that nothing explains.
        """
        message = self._read(TollPassage, row["statement"], row["passage_id"])
        why = explain(Code.NO_STATEMENT)
        silent_ns = message.sampled_ns + round(self._settings.silence_limit_s * NS)
        if not self._is_as_sealed("passage", row):
            self._settle(message, PassageState.SUSPECT, stated(explain(Code.CHANGED)), now_ns)
            return
        registrations = self._registered(message, row["registrations"])
        if message.crossing_ns is not None:
            crossed = self._read(TollPassage, row["crossed"], row["passage_id"]) if row["crossed"] else message
            self._leave_to_person(message, crossed, registrations, why, now_ns)
        elif (pulse := self._unexplained_pulse(message, self._matched(), message.opened_ns, silent_ns)) is not None:
            self.pictures.disputed(pulse)
            self._settle(message, PassageState.SUSPECT, stated(why), now_ns, contracts_of(registrations))
        else:
            self._settle(message, PassageState.VOID, stated(why), now_ns)

    def _unexplained_pulse(
        self, message: TollPassage, matched: PulseMatches, from_ns: int, until_ns: int
    ) -> Row | None:
        """Find the first pulse that a passage may own within a time: of one of its lanes, and of no crossing."""
        lanes = {lane.lane for lane in message.lanes}
        free = [
            row for key, row in matched.pulses.items()
            if key not in matched.found and not row["backward"] and from_ns <= row["sampled_ns"] <= until_ns
            and (not lanes or row["lane"] in lanes)
        ]  # fmt: skip
        return min(free, key=lambda row: int(row["sampled_ns"]), default=None)

    def _registered(self, message: TollPassage, stored: str) -> list[TollRegistration]:
        """Registrations of a passage: those that held when they were stored with it, and those that hold now.

        Of each contract and ticket the newest counts. A registration of a ticket that the passage does not have is
        never one of it.
        """
        identities = identities_of(message)
        found = [TollRegistration.model_validate_json(json.dumps(each)) for each in json.loads(stored)]
        found += self.registrations.of(identities, message.crossing_ns or message.sampled_ns)
        newest: dict[tuple[str, str, str], TollRegistration] = {}
        for each in found:
            key = identity_of(each), each.contract, each.tariff_class
            if key[0] in identities and (key not in newest or each.sampled_ns > newest[key].sampled_ns):
                newest[key] = each
        return list(newest.values())[:CONTRACTS]

    def _is_as_sealed(self, table: str, row: Row) -> bool:
        """Whether a row of what is in progress is as the ledger has stored it."""
        names = {"passage": ("sampled_ns", "statement", "crossed", "registrations"),
                 "held": ("charged", "crossed", "registrations")}[table]  # fmt: skip
        return self.chain.is_row(row["seal"], table, row["passage_id"], *(row[name] for name in names))

    def _charge(
        self, message: TollPassage, crossed: TollPassage | None, registrations: list[TollRegistration], now_ns: int
    ) -> None:
        """Charge a passage that is complete, or say why not.

        `core.toll` knows a contract. Where the ledger does not, it was down when that was registered: the vehicle
        repeats the registration, and `core.toll` this statement.
        """
        proof, contracts = crossed or message, contracts_of(registrations)
        waited_ns = now_ns - (message.exit_ns or message.crossing_ns or message.sampled_ns)
        is_covered = {identity_of(each) for each in registrations} >= set(identities_of(message))
        if not is_covered and waited_ns < self._settings.registration_wait_s * NS:
            return
        lanes = {lane.lane: lane.probability for lane in message.lanes}
        if message.lane is None and not (contracts and self._is_counted(None, lanes)):
            why = _why(message) if message.reason else stated(explain(Code.NO_LANE))
            if contracts:
                code = message.reason_code or explain(Code.NO_LANE)
                self._leave_to_person(message, proof, registrations, code, now_ns)
            else:
                self._settle(message, PassageState.UNDECIDED, why, now_ns)
        elif not contracts:
            self._settle(message, PassageState.UNREGISTERED, stated(explain(Code.NO_CONTRACT)), now_ns)
        elif (doubt := self._doubt(message, proof, contracts, is_covered=is_covered)) is not None:
            self._leave_to_person(message, proof, registrations, doubt, now_ns)
        else:
            self._hold(message, proof, registrations, now_ns)
            if not self._is_counted(message.lane, lanes) and proof.derivable and not message.overlaps:
                self._charge_held(message.passage_id, now_ns)

    def _leave_to_person(
        self,
        message: TollPassage,
        crossed: TollPassage,
        registrations: list[TollRegistration],
        why: Explanation,
        now_ns: int,
    ) -> None:
        """Review a passage of a contract, with its evidence where there is any: a charge may follow."""
        if crossed.evidence is None or message.crossing_ns is None or len(contracts_of(registrations)) != 1:
            self._settle(message, PassageState.SUSPECT, stated(why), now_ns, contracts_of(registrations))
            return
        self._hold(message, crossed, registrations, now_ns)
        self._review(message.passage_id, why, [], now_ns)

    def _doubt(
        self, message: TollPassage, proof: TollPassage, contracts: set[Contract], *, is_covered: bool
    ) -> Explanation | None:
        """Say why a complete passage of a contract is left to a person; None: it is charged, if a detector agrees."""
        tariff_class = min(contracts)[1]
        is_silent = message.reason_code is not None and message.reason_code.code == SILENT_BETWEEN
        needs_ticket = self._plaza.require_authenticated or bool(message.tickets)
        if not is_covered:
            return explain(Code.NEW_TICKET)
        if needs_ticket and not message.authenticated:
            return explain(Code.NOT_AUTHENTICATED)
        if is_silent and message.lane is not None and message.lane not in self._detectors:
            return explain(Code.SILENT)
        if message.crossing_ns is None or message.crossing_sd_s is None or proof.evidence is None:
            return explain(Code.NO_EVIDENCE)
        if tariff_class not in self._plaza.tariff.classes:  # the file has changed since
            self.rejects["tariff class"] += 1
            return explain(Code.NO_CLASS, tariff_class=_quoted(tariff_class))
        return self._replays.found(message.passage_id, proof.evidence) or self._driven_round(message, contracts)

    def _driven_round(self, message: TollPassage, contracts: set[Contract]) -> Explanation | None:
        """Say that a contract has just passed, in less time than it takes to come back; None if it has not."""
        from_ns, _ = _interval(message)
        for contract, _ in sorted(contracts):
            row = self._store.row(
                "SELECT passage_id, to_ns FROM chain WHERE name = ? AND passage_id <> ? AND authenticated >= ? "
                "AND to_ns <= ? AND to_ns > ? ORDER BY to_ns DESC LIMIT 1", f"contract {contract}",
                message.passage_id, message.authenticated, from_ns,
                from_ns - round(self._settings.drive_round_s * NS),
            )  # fmt: skip
            if row is not None:
                before_s = (from_ns - row["to_ns"]) * 1e-9
                return explain(Code.DRIVE_ROUND, passage=passage_of(row["passage_id"]), before_s=before_s)
        return None

    def _hold(
        self,
        message: TollPassage,
        crossed: TollPassage,
        registrations: list[TollRegistration],
        now_ns: int,
        state: PassageState = PassageState.HELD,
    ) -> None:
        """Keep a complete passage until a detector confirms it, or the lane has none; nothing is booked."""
        if state is PassageState.HELD:
            self._note_chain(message, _names(message, contracts_of(registrations)), message.passage_id)
        content = (
            message.model_dump_json(exclude_none=True), crossed.model_dump_json(exclude_none=True),
            _as_text(registrations),
        )  # fmt: skip
        self._store.execute(
            "INSERT INTO held VALUES (?, ?, ?, ?, ?)",
            message.passage_id, *content, self.chain.row_seal("held", message.passage_id, *content),
        )  # fmt: skip
        why = stated(explain(Code.WAITS)) if state is PassageState.HELD else _why(message)
        self._settle(message, state, why, now_ns)

    def _note_chain(self, message: TollPassage, names: list[str], passage_id: str) -> None:
        from_ns, to_ns = _interval(message)
        for name in names:
            self._store.execute(
                "INSERT OR REPLACE INTO chain VALUES (?, ?, ?, ?, ?, ?, ?, ?)", name, passage_id, from_ns, to_ns,
                message.crossing_ns, message.crossing_sd_s or 1.0, message.lane, message.authenticated,
            )  # fmt: skip

    def _charge_held(
        self,
        passage_id: str,
        now_ns: int,
        *,
        pulses: Sequence[Row] = (),
        verdict: Explanation | None = None,
        ghosts: Sequence[str] = (),
        assignment: PulseAssignment | None = None,
    ) -> None:
        """Store charge, outbox row and evidence; `passage` has made sure that none is there, and UNIQUE insists."""
        held = self._store.row("SELECT * FROM held WHERE passage_id = ?", passage_id)
        if held is not None and not self._is_as_sealed("held", held):
            self._review(passage_id, explain(Code.CHANGED), [], now_ns)
            return
        if held is not None and len(self._contracts_of_held(held)) > 1:
            self._review(passage_id, explain(Code.TWO_CONTRACTS), [], now_ns)
            return
        confirmed_by = verdict or explain(Code.CONFIRMED if pulses else Code.UNCONFIRMED)
        pack = self._pack_of_held(passage_id, pulses=pulses, verdict=confirmed_by, ghosts=ghosts, assignment=assignment)
        if pack is None:  # the plaza's file has changed while it was held
            self._review(passage_id, explain(Code.LOST_CLASS), [], now_ns)
            return
        self._store.execute("DELETE FROM held WHERE passage_id = ?", passage_id)
        tariff, message, lane = self._plaza.tariff, pack.charged, pack.lane
        is_confirmed, unconfirmed = lane in self._detectors, explain(Code.UNCONFIRMED)
        transaction = TollTransaction(
            transaction_id=transaction_id(message.passage_id, TransactionKind.CHARGE),
            passage_id=message.passage_id,
            kind=TransactionKind.CHARGE,
            booked_ns=now_ns,
            plaza=self._plaza.name,
            lane=lane,
            lane_probability=_probability(message, lane) or 0.0,
            crossing_ns=message.crossing_ns or 0,
            crossing_sd_s=message.crossing_sd_s or 0.0,
            contract=pack.contract,
            tariff_class=pack.tariff_class,
            tariff_version=pack.tariff_version,
            amount_cents=pack.amount_cents,
            currency=tariff.currency,
            authenticated=message.authenticated,
            ticket=message.tickets[-1] if message.authenticated and message.tickets else None,
            ghosts=len(ghosts),
            confirmed=is_confirmed,
            reason=reason(verdict) if verdict else "" if is_confirmed else reason(unconfirmed),
            evidence_digest=_digest(pack),
        )
        self._enter(transaction)
        self._keep(pack, now_ns)
        for pulse in pulses:
            self.pictures.charged(pulse)
        self._change(
            passage_id, state=PassageState.CHARGED, lane=lane, reason=transaction.reason,
            reason_code=verdict or (None if is_confirmed else unconfirmed), tariff_class=pack.tariff_class,
            amount_cents=pack.amount_cents, currency=tariff.currency, confirmed=is_confirmed,
            authenticated=message.authenticated, ghosts=len(ghosts), evidence_digest=transaction.evidence_digest,
        )  # fmt: skip

    def _contracts_of_held(self, row: Row) -> set[Contract]:
        """Contracts of a held passage: another one may have registered its ticket meanwhile."""
        charged = self._read(TollPassage, row["charged"], row["passage_id"])
        return contracts_of(self._registered(charged, row["registrations"]))

    def _pack_of_held(
        self,
        passage_id: str,
        *,
        pulses: Sequence[Row] = (),
        verdict: Explanation | None = None,
        ghosts: Sequence[str] = (),
        assignment: PulseAssignment | None = None,
    ) -> EvidencePack | None:
        """Make the evidence pack of a held passage.

        None if it is not held, was changed in the file, has no contract, or the tariff has no such class.
        """
        row = self._store.row("SELECT * FROM held WHERE passage_id = ?", passage_id)
        if row is None or not self._is_as_sealed("held", row):
            return None
        charged, crossed = (self._read(TollPassage, row[name], passage_id) for name in ("charged", "crossed"))
        registrations = self._registered(charged, row["registrations"])
        tariff, contracts = self._plaza.tariff, contracts_of(registrations)
        if len(contracts) != 1 or (cents := tariff.classes.get(min(contracts)[1])) is None:
            return None
        contract, tariff_class = min(contracts)
        return EvidencePack(
            plaza_file=self._plaza_file, tariff_version=tariff.version, contract=contract,
            tariff_class=tariff_class, lane=charged.lane or _lane_of(pulses), amount_cents=cents, crossed=crossed,
            charged=charged, form=FORM, registrations=tuple(registrations), match_gate_s=self._settings.match_gate_s,
            pulses=tuple(_pulse_evidence(pulse) for pulse in pulses[:PULSES]),
            verdict=verdict, ghosts=tuple(ghosts[:OVERLAPS]), assignment=assignment,
        )  # fmt: skip

    def _keep(self, pack: EvidencePack, now_ns: int) -> None:
        """Store the evidence until the objection period ends."""
        passage_id, digest = pack.charged.passage_id, _digest(pack)
        self._store.execute(
            "INSERT INTO evidence (passage_id, digest, stored_ns, pack, seal) VALUES (?, ?, ?, ?, ?)",
            passage_id, digest, now_ns, zlib.compress(_encoded(pack)), self.chain.pack_seal(passage_id, digest, now_ns),
        )  # fmt: skip
        for statement in (pack.crossed, pack.charged):
            if statement.evidence is not None:
                self._replays.keep(passage_id, statement.evidence, now_ns)

    def _review(self, passage_id: str, explanation: Explanation, others: list[str], now_ns: int) -> None:
        """Leave a passage to a person: what is held is not booked, what is booked is reversed."""
        pack = self._pack_of_held(passage_id, verdict=explanation)
        self._store.execute("DELETE FROM held WHERE passage_id = ?", passage_id)
        if pack is not None:
            self._keep(pack, now_ns)
        why = stated(explanation)
        charge = self._reverse(passage_id, why, now_ns)
        about = charge or pack
        summary = self._change(passage_id, state=PassageState.SUSPECT, reason=why.text, reason_code=why.code)
        self._ask(
            TollReview(
                sampled_ns=now_ns, passage_id=passage_id, plaza=self._plaza.name, reason=why.text,
                reason_code=why.code, lane=summary.lane,
                crossing_ns=summary.crossing_ns, overlaps=tuple(others[:OVERLAPS]),
                contract=about.contract if about else None,
                tariff_class=about.tariff_class if about else None,
                amount_cents=about.amount_cents if about else None,
                currency=self._plaza.tariff.currency if about else None,
                reversed=charge is not None,
                authenticated=summary.authenticated,
                evidence_digest=charge.evidence_digest if charge else _digest(pack) if pack else None,
            )
        )  # fmt: skip

    def _ask(self, review: TollReview) -> None:
        code = review.reason_code.code if review.reason_code else ""
        review = review.model_copy(update={"decided_by": explain(_decides(code))})
        if review.contract or review.contracts:
            self._store.execute("UPDATE crossing SET in_review = 1 WHERE passage_id = ?", review.passage_id)
        self._change(review.passage_id, in_review=True)
        self._store.execute(
            "INSERT OR REPLACE INTO review (passage_id, since_ns, content) VALUES (?, ?, ?)",
            review.passage_id, review.sampled_ns, review.model_dump_json(exclude_none=True),
        )  # fmt: skip

    def _withdraw(self, passage_id: str, state: PassageState, why: CodedText, now_ns: int) -> None:
        """Take back what was held or charged, because the passage was none."""
        if self._store.execute("DELETE FROM held WHERE passage_id = ?", passage_id):
            self._change(passage_id, state=state, reason=why.text, reason_code=why.code)
        else:
            self._reverse(passage_id, why, now_ns)

    def _reverse(self, passage_id: str, why: CodedText, now_ns: int) -> TollTransaction | None:
        """Book the opposite of a charge, once; return the charge, or None if there is none or it is reversed."""
        rows = self._store.rows("SELECT kind, content FROM booking WHERE passage_id = ?", passage_id)
        content = {row["kind"]: row["content"] for row in rows}
        if TransactionKind.CHARGE not in content or TransactionKind.REVERSAL in content:
            return None
        charge = self._read(TollTransaction, content[TransactionKind.CHARGE], passage_id)
        opposite = {
            "transaction_id": transaction_id(passage_id, TransactionKind.REVERSAL),
            "kind": TransactionKind.REVERSAL,
            "booked_ns": now_ns,
            "amount_cents": -charge.amount_cents,
            "reason": why.text,
        }
        self._enter(charge.model_copy(update=opposite))
        self._change(passage_id, reversed=True, reason=why.text, reason_code=why.code)
        return charge

    def _merge(self, message: TollPassage, contracts: set[tuple[str, str]], now_ns: int) -> bool:
        """Settle a passage of a vehicle that another passage of the same time has; the ID of the first one stays.

        A vehicle is known by its contract and its chain of tickets or station IDs. Two passages of it whose intervals
        from approach to exit overlap, and that cross the gate line at one time in one lane, are one: frames that were
        lost or left out gave the second another ID. Of others a person has to judge, but what is not authenticated
        puts nothing in doubt that is. Station IDs of two contracts name no vehicle: `core.toll` may have taken two for
        one.
        """
        ends = (PassageState.CHARGED, PassageState.UNDECIDED, PassageState.UNREGISTERED)
        if message.state not in ends or len(contracts) > 1:
            return False
        from_ns, to_ns = _interval(message)
        names = _names(message, contracts)
        first_ns: dict[str, int] = {}
        elsewhere: dict[str, bool] = {}  # passages of other crossings, and whether they are authenticated
        for name in names:
            for row in self._store.rows(
                "SELECT * FROM chain WHERE name = ? AND passage_id <> ? AND from_ns < ? "
                "AND to_ns > ?", name, message.passage_id, to_ns, from_ns,
            ):  # fmt: skip
                if _is_same_crossing(message, row):
                    first_ns[row["passage_id"]] = min(row["from_ns"], first_ns.get(row["passage_id"], row["from_ns"]))
                else:
                    elsewhere[row["passage_id"]] = bool(row["authenticated"])
        if elsewhere and message.state is not PassageState.UNREGISTERED:
            return self._review_both(message, contracts, elsewhere, now_ns)
        if not first_ns:
            return False
        first, *others = sorted(first_ns, key=lambda passage_id: (first_ns[passage_id], passage_id))
        why = stated(explain(Code.SAME_VEHICLE, passage=passage_of(first)))
        self._note_chain(message, names, first)
        for other in others:
            self._withdraw(other, PassageState.VOID, why, now_ns)
        self._settle(message.model_copy(update={"crossing_ns": None}), PassageState.VOID, why, now_ns)
        return True

    def _review_both(
        self, message: TollPassage, contracts: set[Contract], elsewhere: Mapping[str, bool], now_ns: int
    ) -> bool:
        """Leave passages of one contract or station at two places to a person; whether this one is among them."""
        is_doubtful = False
        for other, authenticated in sorted(elsewhere.items()):
            if authenticated or not message.authenticated:
                is_doubtful = True
            if message.authenticated or not authenticated:
                here = explain(Code.ELSEWHERE, passage=passage_of(message.passage_id))
                self._review(other, here, [message.passage_id], now_ns)
        if is_doubtful:
            self._note_chain(message, _names(message, contracts), message.passage_id)
            there = explain(Code.ELSEWHERE, passage=passage_of(min(elsewhere)))
            self._settle(message, PassageState.SUSPECT, stated(there), now_ns, contracts)
        return is_doubtful

    def _enter(self, transaction: TollTransaction) -> None:
        booking: dict[str, str | int] = {
            "transaction_id": transaction.transaction_id,
            "passage_id": transaction.passage_id,
            "kind": transaction.kind.value,
            "booked_ns": transaction.booked_ns,
            "amount_cents": transaction.amount_cents,
            "content": transaction.model_dump_json(exclude_none=True),
        }
        self._store.execute("INSERT INTO booking VALUES (?, ?, ?, ?, ?, ?)", *booking.values())
        self.chain.add(booking, transaction.booked_ns)
        self._store.execute("INSERT INTO outbox VALUES (?)", transaction.transaction_id)

    def _settle(
        self,
        message: TollPassage,
        state: PassageState,
        why: CodedText,
        now_ns: int,
        contracts: Collection[tuple[str, str]] = (),
    ) -> None:
        """Store the end of a passage: its state, and its crossing without station IDs for the reconciliation."""
        self._unregistered.pop(message.passage_id, None)
        self._store.execute("DELETE FROM passage WHERE passage_id = ?", message.passage_id)
        summary = PassageSummary(
            passage_id=message.passage_id, state=state, lane=message.lane, crossing_ns=message.crossing_ns,
            probability=_probability(message), reason=why.text, reason_code=why.code,
            authenticated=message.authenticated,
        )  # fmt: skip
        self._store.execute(
            "INSERT INTO settled VALUES (?, ?, ?)",
            message.passage_id, now_ns, summary.model_dump_json(exclude_none=True),
        )  # fmt: skip
        if message.crossing_ns is not None and not self._is_one_too_many(message, state):
            lanes = json.dumps({lane.lane: lane.probability for lane in message.lanes})
            self._store.execute(
                "INSERT INTO crossing (crossing_ns, sd_s, state, lane, lanes, passage_id, overlaps, settled_ns, "
                "authenticated, modes) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                message.crossing_ns, message.crossing_sd_s or 1.0, state, message.lane, lanes, message.passage_id,
                json.dumps(message.overlaps), now_ns, message.authenticated, json.dumps(_modes_of(message.modes)),
            )  # fmt: skip
            if tickets := tickets_of(message):
                self._tickets[message.passage_id] = tickets[-1]
                while len(self._tickets) > MAX_TICKETS:
                    del self._tickets[next(iter(self._tickets))]
        if state is PassageState.SUSPECT:
            names = sorted({name for name, _ in contracts})
            self._ask(
                TollReview(
                    sampled_ns=now_ns, passage_id=message.passage_id, plaza=self._plaza.name, reason=why.text,
                    reason_code=why.code, lane=message.lane, crossing_ns=message.crossing_ns, overlaps=message.overlaps,
                    contract=names[0] if len(names) == 1 else None,
                    contracts=tuple(names[:STATION_IDS]) if len(names) > 1 else (),
                    authenticated=message.authenticated,
                )
            )  # fmt: skip

    def _is_one_too_many(self, message: TollPassage, state: PassageState) -> bool:
        """Whether a crossing is left out: of radios that nothing vouches for there is no end. Its pulse is missed."""
        if message.authenticated or state not in (PassageState.UNREGISTERED, PassageState.UNDECIDED):
            return False
        waiting = self._store.row(
            "SELECT COUNT(*) AS n FROM crossing WHERE state IN (?, ?) AND NOT authenticated",
            PassageState.UNREGISTERED,
            PassageState.UNDECIDED,
        )
        is_full = waiting is not None and waiting["n"] >= MAX_STRANGERS
        if is_full:
            self.rejects["crossings without a contract left out"] += 1
        return is_full

    def _change(self, passage_id: str, **changes: object) -> PassageSummary:
        """Change the summary of a settled passage, and what its crossing counts as.

        Of one that is not remembered any more there is nothing to change: what is known is returned.
        """
        row = self._store.row("SELECT summary FROM settled WHERE passage_id = ?", passage_id)
        if row is None:
            known = PassageSummary(passage_id=passage_id, state=PassageState.SUSPECT, reason="")
            return known.model_copy(update=changes)
        found = self._read(PassageSummary, row["summary"], passage_id).model_copy(update=changes)
        self._store.execute(
            "UPDATE settled SET summary = ? WHERE passage_id = ?", found.model_dump_json(exclude_none=True), passage_id
        )
        self._store.execute("UPDATE crossing SET state = ? WHERE passage_id = ?", found.state, passage_id)
        return found

    def _count(self, lane: str, time_ns: int, outcome: str) -> None:
        """Count an outcome of a lane and hour; a closed hour stays as it is."""
        if is_closed(self._store, time_ns // HOUR_NS * HOUR_NS):
            self.rejects["outcome of a closed hour"] += 1
            return
        self._store.execute(
            "INSERT INTO balance VALUES (?, ?, ?, 1) ON CONFLICT (lane, hour_ns, outcome) DO UPDATE SET n = n + 1",
            lane, time_ns // HOUR_NS * HOUR_NS, outcome,
        )  # fmt: skip

    def _recent(self) -> tuple[PassageSummary, ...]:
        rows = self._store.rows(
            "SELECT passage_id, final_ns, summary, (SELECT COUNT(*) FROM receipt JOIN booking USING (transaction_id) "
            "WHERE booking.passage_id = settled.passage_id) AS receipts FROM settled ORDER BY final_ns DESC LIMIT ?",
            RECENT_PASSAGES,
        )
        ended = [
            (row["final_ns"],
             self._read(PassageSummary, row["summary"], row["passage_id"])
             .model_copy(update={"receipt": row["receipts"] > 0}))
            for row in rows
        ]  # fmt: skip
        missed = self._store.rows(
            "SELECT lane, since_ns, number, sampled_ns FROM pulse WHERE done = 2 ORDER BY sampled_ns DESC LIMIT ?",
            RECENT_PASSAGES,
        )
        ended += [(row["sampled_ns"], _missed(row)) for row in missed]
        ended.sort(key=lambda pair: pair[0], reverse=True)
        stored = self._store.rows(
            "SELECT passage_id, statement FROM passage ORDER BY sampled_ns DESC LIMIT ?", RECENT_PASSAGES
        )
        open_ = [self._read(TollPassage, row["statement"], row["passage_id"]) for row in stored]
        open_ += list(self._unregistered.values())[-RECENT_PASSAGES:]
        return (*(_summary(passage) for passage in open_), *(summary for _, summary in ended))


def transaction_id(passage_id: str, kind: TransactionKind) -> str:
    """Derive the ID of a transaction: the same for every attempt and after a restart of the ledger."""
    return hashlib.sha256(f"{kind}:{passage_id}".encode()).hexdigest()


def _encoded(pack: EvidencePack) -> bytes:
    return pack.model_dump_json(exclude_none=True).encode()


def _digest(pack: EvidencePack) -> str:
    return hashlib.sha256(_encoded(pack)).hexdigest()


def _interval(message: TollPassage) -> tuple[int, int]:
    """From the approach line to the exit line, or the newest statement."""
    return message.opened_ns, message.exit_ns or message.crossing_ns or message.sampled_ns


def _names(message: TollPassage, contracts: set[Contract]) -> list[str]:
    """What a vehicle is known by."""
    return [*identities_of(message), *(f"contract {name}" for name, _ in sorted(contracts))]


def _is_same_crossing(message: TollPassage, row: Row) -> bool:
    """Whether a passage crosses the gate line where and when another one does, as far as both know it."""
    if message.lane is not None and row["lane"] is not None and message.lane != row["lane"]:
        return False
    if message.crossing_ns is None or row["crossing_ns"] is None:
        return True
    sd_s = hypot(message.crossing_sd_s or 1.0, row["sd_s"])
    away_s = abs(message.crossing_ns - int(row["crossing_ns"])) * 1e-9
    return away_s <= max(SAME_CROSSING_S, TIGHT_SD * sd_s)


def _state_of(crossing: Row) -> str:
    """What a crossing counts as: a contradictory one of a contract is a review."""
    return REVIEW if crossing["state"] == PassageState.SUSPECT and crossing["in_review"] else str(crossing["state"])


def _decides(code: str) -> Code:
    """What decides a review of a code."""
    return DECIDED_BY.get(Code(code), Code.BY_PICTURE) if code in set(Code) else Code.BY_PICTURE


def _as_text(registrations: Sequence[TollRegistration]) -> str:
    return json.dumps([json.loads(each.model_dump_json(exclude_none=True)) for each in registrations])


def _balance(lane: str, hour_ns: int, counts: Mapping[str, int]) -> LaneBalance:
    """Make the account of a lane and an hour from its counts."""
    explained = sum(counts.get(outcome, 0) for outcome in OUTCOMES) + counts.get("pending", 0)
    agrees = counts.get("detections", 0) == explained and not counts.get("charged_without_detection", 0)
    return LaneBalance(lane=lane, hour_ns=hour_ns, agrees=agrees, **counts)


def _crossing(row: Row) -> Crossing:
    modes = tuple(Mode(*mode) for mode in json.loads(row["modes"]))
    return Crossing(row["number"], row["crossing_ns"], row["sd_s"], row["lane"], json.loads(row["lanes"]), modes)


def _keyed(row: Row) -> Pulse:
    return Pulse(row["rowid"], row["lane"], row["sampled_ns"])


def _modes_of(modes: Sequence[CrossingMode]) -> list[tuple[float, float, dict[str, float]]]:
    return [(mode.offset_s, mode.sd_s, {lane.lane: lane.probability for lane in mode.lanes}) for mode in modes]


def _missed(row: Row) -> PassageSummary:
    """Summarise a pulse that no passage explains; its digest stands for the ID of the passage that is not known."""
    missed = explain(Code.MISSED)
    name = f"missed:{row['lane']}:{row['since_ns']}:{row['number']}"
    return PassageSummary(
        passage_id=hashlib.sha256(name.encode()).hexdigest(), state=PassageState.MISSED, lane=row["lane"],
        crossing_ns=row["sampled_ns"], reason=reason(missed), reason_code=missed,
    )  # fmt: skip


def _why(message: TollPassage) -> CodedText:
    """What `core.toll` says of a passage; the name of its state where it says nothing."""
    return CodedText(message.reason or message.state.value, message.reason_code)


def _quoted(text: str) -> QuotedText:
    return QuotedText(quoted=text[:QUOTED_LENGTH])


def _probability(passage: TollPassage, lane: str | None = None) -> float | None:
    """Probability of a lane by the passage's CAM; of its own lane, or of that of its pulse."""
    of = lane or passage.lane
    return next((each.probability for each in passage.lanes if each.lane == of), None)


def _lanes(probabilities: Mapping[str, float]) -> tuple[LaneProbability, ...]:
    return tuple(LaneProbability(lane=name, probability=p) for name, p in probabilities.items())


def _possible_lanes(crossing: Crossing) -> set[str]:
    """Lanes that a crossing may be in."""
    if crossing.lane is not None:
        return {crossing.lane}
    return {lane for lane, probability in crossing.lanes.items() if probability > MINIMUM_PROBABILITY}


def _lane_of(pulses: Sequence[Row]) -> str:
    return str(pulses[0]["lane"]) if pulses else ""


def _pulse_evidence(pulse: Row) -> PulseEvidence:
    return PulseEvidence(
        lane=pulse["lane"], since_ns=pulse["since_ns"], pulse=pulse["number"], sampled_ns=pulse["sampled_ns"],
        backward=bool(pulse["backward"]),
    )  # fmt: skip


def _summary(passage: TollPassage) -> PassageSummary:
    return PassageSummary(
        passage_id=passage.passage_id, state=passage.state, lane=passage.lane, crossing_ns=passage.crossing_ns,
        probability=_probability(passage), reason=passage.reason, reason_code=passage.reason_code,
    )  # fmt: skip
