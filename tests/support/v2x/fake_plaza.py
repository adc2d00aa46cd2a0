"""A simulated road-side unit for the dashboard: the messages of its processes at their rates."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import radians

from shared.messages.base import Message
from shared.messages.explanation import explain
from shared.messages.operation import Origin, OriginKind
from shared.messages.toll import (
    GateCommand,
    GateMode,
    LaneBalance,
    LaneProbability,
    LedgerState,
    PassageState,
    PassageSummary,
    PictureSummary,
    PlazaDetector,
    ReviewSummary,
    TollDelta,
    TollTrack,
    TollTracks,
)
from shared.messages.v2x import Authentication, Unverified
from shared.runtime.config import parse_vehicle
from shared.words.words import reason
from tests.support.dashboard.fake_unit import FakeBus, heartbeat
from tests.support.v2x.tolling import PLAZA, Vehicle
from tests.support.watchdog import Watchdog

# What is known of the senders of the tracks.
SENDERS: tuple[tuple[Authentication, Unverified | None], ...] = (
    (Authentication.AUTHENTICATED, None),
    (Authentication.SIGNED_NOT_VERIFIED, Unverified.UNKNOWN_ISSUER),
    (Authentication.SIGNED_NOT_VERIFIED, None),
    (Authentication.UNSIGNED, None),
)
VEHICLE_TOML = '[vehicle]\nname = "plaza-1"\nrole = "rsu"\n[sensors.traffic]\n[sensors.v2x]\n[parsers.v2x]\n'
PROCESSES = parse_vehicle(VEHICLE_TOML).processes
NS = 1_000_000_000
SECOND_NS = NS


@dataclass
class FakePlaza:
    """Publishes the messages of a plaza with four vehicles; attributes inject faults."""

    empty: bool = False  # nothing but heartbeats
    silent_after_s: float | None = None  # core.toll and the ledger publish nothing from then on
    problem: str | None = None  # of the ledger
    agrees: bool = True
    _due: dict[str, int] = field(default_factory=dict)

    def join(self, bus: FakeBus) -> None:
        """Become the unit of a bus."""
        self.bus, self.started_ns = bus, bus.now_ns()
        self.watchdog = Watchdog(PROCESSES, self.started_ns)
        bus.vehicle, bus.vehicle_toml, bus.unit = "plaza-1", VEHICLE_TOML, self

    def step(self) -> None:
        """Publish everything that is due now."""
        now_ns = self.bus.now_ns()
        for name, period_ns, make in (
            ("beat", NS // 2, self._heartbeats),
            ("tracks", NS // 2, self._tracks),
            ("states", NS, self._states),
        ):
            if now_ns >= self._due.setdefault(name, now_ns):
                self._due[name] = now_ns + period_ns
                for producer, message in make(now_ns):
                    self.bus.feed(message, producer)
        for message in self.watchdog.step(now_ns, connected=self.bus.connected):
            self.bus.feed(message, "monitoring.health")

    def _heartbeats(self, now_ns: int) -> Iterator[tuple[str, Message]]:
        for process in PROCESSES:
            yield process, heartbeat(process, now_ns)
        yield "sensors.traffic", Origin(now_ns=now_ns, kind=OriginKind.SIMULATED, name="example", seed=1)

    def _is_silent(self, now_ns: int) -> bool:
        silent_s = self.silent_after_s
        return self.empty or (silent_s is not None and now_ns > self.started_ns + round(silent_s * NS))

    def _tracks(self, now_ns: int) -> Iterator[tuple[str, Message]]:
        if self._is_silent(now_ns):
            return
        age_s = (now_ns - self.started_ns) * 1e-9
        tracks = []
        for n, (lane, registered) in enumerate(((0, True), (1, True), (2, False), (4, True))):
            begin, end = PLAZA.lanes[lane].centre[0], PLAZA.lanes[lane].centre[1]
            share = 0.5 + 0.1 * n + 0.02 * (age_s % 10.0)
            place = PLAZA.position(*(begin + share * (end - begin)).tolist())
            name, undecided = PLAZA.lanes[lane].name, n == 1
            posterior = {name: 0.62, "n3": 0.38} if undecided else {name: 0.995}
            tracks.append(
                TollTrack(
                    track=n, station_id=1000 + n, updated_ns=now_ns, latitude_deg=place.latitude_deg,
                    longitude_deg=place.longitude_deg, speed_m_s=14.0, heading_rad=radians(32.0 if lane < 3 else 212.0),
                    ellipse_major_m=1.9, ellipse_minor_m=1.1, ellipse_orientation_rad=0.4,
                    lanes=tuple(LaneProbability(lane=k, probability=p) for k, p in posterior.items()),
                    lane=None if undecided else name, delta_applied=True, registered=registered,
                    authentication=SENDERS[n][0], unverified=SENDERS[n][1],
                )
            )  # fmt: skip
        yield "core.toll", TollTracks(sampled_ns=now_ns, tracks=tuple(tracks), cams=round(20 * age_s), trust="surveyed")

    def _states(self, now_ns: int) -> Iterator[tuple[str, Message]]:
        if self._is_silent(now_ns):
            return
        yield "core.toll", PLAZA.description(now_ns)
        yield (
            "core.toll",
            TollDelta(sampled_ns=now_ns, plaza=PLAZA.name, valid=True, reason="30 fixes agree", north_m=-2.1,
                      east_m=0.8, sd_m=0.4, fixes=30, window_s=30.0),
        )  # fmt: skip
        yield (
            "core.toll",
            GateCommand(sampled_ns=now_ns, plaza=PLAZA.name, lane="n3", passage_id=Vehicle().passage_id, open=True,
                        mode=GateMode.STOP_AND_GO, valid_until_ns=now_ns + 5 * NS),
        )  # fmt: skip
        pulse = PlazaDetector(sampled_ns=now_ns, plaza=PLAZA.name, lane="n1", since_ns=self.started_ns, pulse=7)
        yield "sensors.traffic", pulse
        yield "monitoring.ledger", self._ledger(now_ns)

    def _ledger(self, now_ns: int) -> LedgerState:
        if self.problem:
            return LedgerState(now_ns=now_ns, plaza=PLAZA.name, problem=self.problem)
        others = (PassageState.CROSSED, PassageState.VOID)
        states = [state for state in PassageState if state not in others]
        recent = []
        for n, state in enumerate(states):
            charged, missed = state is PassageState.CHARGED, state is PassageState.MISSED
            recent.append(
                PassageSummary(
                    passage_id=Vehicle(f"v{n}").passage_id, state=state, lane="n1" if n < 2 or missed else None,
                    crossing_ns=self.started_ns - n * 20 * NS if n else None,
                    probability=0.995 if charged else None if missed else 0.7,
                    tariff_class="car" if charged else None, amount_cents=240 if charged else None,
                    currency="EUR" if charged else None, receipt=charged,
                    evidence_digest="ab" * 32 if charged else None, confirmed=False if charged else None,
                    reason="not confirmed by a detector" if charged else "",
                )
            )  # fmt: skip
        hour_ns = now_ns // (3600 * NS) * 3600 * NS
        balance = LaneBalance(lane="n1", hour_ns=hour_ns, detections=9, charged=5, undecided=2, unregistered=1,
                              missed=1 if self.agrees else 0, provisional=4, agrees=self.agrees)  # fmt: skip
        why, decides = explain("ledger.not_counted"), explain("ledger.by_picture")
        review = ReviewSummary(
            passage_id=Vehicle("v5").passage_id, since_ns=now_ns, lane="n1", crossing_ns=self.started_ns, contracts=1,
            reason=reason(why), reason_code=why, decided_by=reason(decides), decided_by_code=decides,
        )  # fmt: skip
        owes = explain("ledger.picture_owes")
        picture = PictureSummary(lane="n2", pulse_ns=self.started_ns, until_ns=now_ns + 86_400 * NS,
                                 reason=reason(owes), reason_code=owes)  # fmt: skip
        return LedgerState(now_ns=now_ns, plaza=PLAZA.name, transactions=5, amount_cents=1200, outbox=1,
                           held=2, in_review=3, unconfirmed=4, require_authenticated=False, not_authenticated=5,
                           reviews=(review,), pictures=(picture,), pictures_kept=1, pictures_waiting=2,
                           last_receipt_ns=now_ns - 3 * NS, lanes=(balance,), recent=tuple(recent))  # fmt: skip
