"""All that the status process knows, updated message by message; pure: time is an argument."""

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import hypot
from statistics import fmean
from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from shared.bus.bus import Envelope
from shared.errors import BadPayload
from shared.messages.base import Message
from shared.messages.explanation import explain, process
from shared.messages.gnss import GnssFix
from shared.messages.navigation import (
    AidingKind,
    AidingUpdate,
    NavigationSolution,
    NavigationState,
    SetUpState,
    TruthState,
)
from shared.messages.operation import (
    DeadlineReport,
    Freshness,
    Origin,
    OriginKind,
    Outage,
    ProcessHealth,
    ProcessLoad,
    ProcessState,
    Work,
)
from shared.messages.toll import GateCommand, PlazaDetector
from shared.messages.trust import TrustEvent, TrustHypotheses, TrustLevel, TrustMonitor, TrustState
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds
from shared.processes import BY_NAME as PROCESS_ROWS
from shared.runtime.freshness import STARTUP_GRACE_S, freshness_of, percentile
from shared.runtime.tally import told
from shared.topics import TOPICS, topic_of
from shared.words.words import CodedText, stated

from .flow import ProcessFlow, TopicFlow, on_demand
from .history.alternatives import Alternatives
from .history.columns import History, TrustHistory
from .history.gnss_history import FixClass, GnssHistory, SkyTrackPoints
from .history.track import Track
from .history.track_row import track_row
from .judgement import (
    BROKER_SILENT_NS,
    REPORT_DEADLINE_NS,
    Judgement,
    OutageList,
    broker_problem,
    from_report,
    unavailable,
    watchdog_problem,
)
from .receiver_geoid import correction_m
from .series.store import Series
from .truth_check import TruthCheck
from .views.banner import KNOWN, Evidence, Trust, Verdict, ratio_of, show
from .views.codes import Code
from .views.geometry import ellipse_95, offset_m
from .views.toll import verdict as plaza_verdict

M = TypeVar("M", bound=Message)
Record = Mapping[str, object]
RESTORED_NS = 3_600_000_000_000  # what is older belongs to another drive
UNSAVED = 1000  # records
SAMPLE_NS = 200_000_000
SECOND_NS = STALL_NS = 1_000_000_000
WITH_POSITION = (TrustLevel.SAFE, TrustLevel.CAUTION, TrustLevel.DEAD_RECKONING)
SAMPLES = 1000  # messages of inertial samples between two questions of the page Set up
POLL_PERIOD_NS = 5_000_000_000  # after a question about a topic, for which its messages are followed
TRUST_EVENTS = 50  # newest, kept
WHEELS = ("front_left_m_s", "front_right_m_s", "rear_left_m_s", "rear_right_m_s")


class VerdictSecond(BaseModel):
    """State of one second, the monitors' statistics over thresholds, and the probabilities of the hypotheses."""

    model_config = ConfigDict(defer_build=True)
    kind: Literal["verdict"]
    ns: int
    state: Trust
    ratios: dict[str, float]
    probabilities: dict[str, float] = {}


class OutageChange(BaseModel):
    """Begin or end of an outage."""

    model_config = ConfigDict(defer_build=True)
    kind: Literal["outage"]
    ns: int
    message: Outage


class VerdictChange(BaseModel):
    """Change of the verdict."""

    model_config = ConfigDict(defer_build=True)
    kind: Literal["event"]
    ns: int
    message: TrustEvent


KeptRecord = VerdictSecond | OutageChange | VerdictChange | FixClass | SkyTrackPoints
Kept = Annotated[KeptRecord, Field(discriminator="kind")]


class State:
    """The newest of everything: topics, processes, verdict, history, outages."""

    def __init__(
        self, vehicle: str, expected: Sequence[str], started_ns: int, history_s: float, *, replay: bool = False
    ) -> None:
        self.vehicle, self.expected, self.started_ns = vehicle, frozenset(expected), started_ns
        self.history_s, self.replay = history_s, replay  # of a replay, silence is part of the recording
        self.topics = {t.name: TopicFlow(t.name, t) for t in TOPICS if not t.per_process}
        self.followed = frozenset(topic.name for topic in TOPICS if topic.fast)  # fast topics whose messages come here
        self.samples: deque[Envelope] = deque(maxlen=SAMPLES)  # inertial ones, while somebody looks at them
        self._looked_ns: dict[str, int] = {}  # time of the last question about a topic that is followed on demand
        self.processes = {name: ProcessFlow(name) for name in PROCESS_ROWS}
        self.judgement: Judgement = unavailable(self.expected, None)
        self.origins: dict[str, tuple[Origin, int]] = {}
        self.aiding: dict[AidingKind, tuple[AidingUpdate, int]] = {}
        self.rejections: dict[AidingKind, int] = {}
        self.monitor_producers: dict[str, str] = {}  # process that publishes the statements of each monitor
        self.history, self.outages = History(history_s), OutageList()
        self.gates: dict[str, GateCommand] = {}  # newest of each lane
        self.pulses: dict[str, int] = {}  # time of the newest detector pulse of each lane
        self.broker = False  # whether it is connected and delivers
        self._ticked_ns = self._received_ns = started_ns  # newest message
        self._broker_back_ns = started_ns  # first message after the last outage of the broker
        self.verdict: Verdict = show(Evidence(broker=True))
        self.trust_history = TrustHistory(history_s)
        self.truth_check = TruthCheck()
        self.series = Series()
        self.gnss = GnssHistory()
        self.track = Track()
        self.alternatives = Alternatives()
        self.geoid_correction_m: float | None = None  # of the receiver to the grid, as last stated
        self.trust_events: deque[TrustEvent] = deque(maxlen=TRUST_EVENTS)
        self.bus_delay_p95_s: float | None = None
        self._delays_s: deque[float] = deque(maxlen=256)
        self._next_sample_ns = self._next_second_ns = started_ns
        self._unsaved: deque[Record] = deque(maxlen=UNSAVED)

    def clear(self, started_ns: int) -> None:
        """Forget everything, as after a start at another time: a replay jumped."""
        track, fillings = self.track, self.series.fillings + 1  # pages ask for the past of the other time
        vars(self).update(
            vars(State(self.vehicle, tuple(self.expected), started_ns, self.history_s, replay=self.replay))
        )
        self.track = track  # of the parts that were played
        self.track.interrupt()
        self.series.fillings = fillings

    def recall(self, changes: Iterable[tuple[int, str]], outages: Iterable[Outage]) -> None:
        """Insert what happened before everything that is known: changes of the verdict, and outages."""
        known = tuple(self.trust_history.changes)
        earliest_ns = min((stamp_ns for stamp_ns, _ in known), default=None)
        before = [change for change in changes if earliest_ns is None or change[0] < earliest_ns]
        self.trust_history.changes.clear()
        self.trust_history.changes.extend([*before, *known])
        for outage in outages:
            self.outages.note(outage)

    def pass_to(self, now_ns: int) -> None:
        """Advance time to the arrival of the next message of a replay; it never goes back."""
        if now_ns > self._ticked_ns:
            self.tick(now_ns, broker=True)

    def receive(self, envelope: Envelope) -> None:
        """Take one message; raises `BadPayload` if it cannot be read."""
        name = envelope.topic
        flow = self.topics.get(name)
        if flow is None:
            topic = topic_of(name)
            if topic is None or not topic.per_process or name.rsplit("/", 1)[1] not in PROCESS_ROWS:
                return
            flow = self.topics[name] = TopicFlow(name, topic)
        if self._broker_lost(envelope.received_ns):
            self._broker_back_ns = envelope.received_ns
        self._received_ns = max(self._received_ns, envelope.received_ns)
        message = flow.note(envelope)
        self._keep_sample(envelope)
        if message is not None and not envelope.retained:
            self.series.take(name, message, envelope.received_ns)
        if message is not None:
            self._unsaved.extend(map(dict, self.gnss.note(message, flow.updated_ns or envelope.received_ns)))
        match message:
            case ProcessHealth():
                self._note_health(message, envelope, flow)
            case AidingUpdate():
                self.aiding[message.kind] = (message, envelope.received_ns)
                if not message.used:
                    self.rejections[message.kind] = self.rejections.get(message.kind, 0) + 1
            case Origin():
                self.origins[envelope.producer] = (message, flow.heard_ns or 0)
            case _:
                self._note_event(message, envelope)

    def _keep_sample(self, envelope: Envelope) -> None:
        topic = "imu/sample"
        if envelope.topic == topic and envelope.received_ns - self._looked_ns.get(topic, 0) < POLL_PERIOD_NS:
            self.samples.append(envelope)

    def _note_event(self, message: Message | None, envelope: Envelope) -> None:
        """Keep what is shown beyond the newest message of its topic."""
        match message:
            case Outage():
                self.outages.note(message)
                self._unsaved.append({"kind": "outage", "ns": message.since_ns, "message": message})
            case TrustEvent():
                self.trust_events.append(message)
                self._unsaved.append({"kind": "event", "ns": message.sampled_ns, "message": message})
            case TrustMonitor():
                self.monitor_producers[message.monitor] = envelope.producer
            case TrustHypotheses():
                self.alternatives.note(message, envelope.producer, envelope.received_ns)
            case GnssFix():
                correction = correction_m(message)
                self.geoid_correction_m = self.geoid_correction_m if correction is None else correction
            case GateCommand():
                self.gates[message.lane] = message
            case PlazaDetector():
                self.pulses[message.lane] = message.sampled_ns
            case _:
                pass

    def unsaved(self) -> list[Record]:
        """Records to be kept for the next incarnation of this process, since the last call."""
        records = list(self._unsaved)
        self._unsaved.clear()
        return records

    def restore(self, lines: Iterable[bytes]) -> int:
        """Add the records of the last hour of earlier incarnations; returns the number of invalid lines."""
        bad, reader = 0, None
        for line in lines:
            reader = reader or TypeAdapter[KeptRecord](Kept)  # 1 MB, only while it is used
            try:
                kept = reader.validate_json(line)
            except ValidationError:
                bad += 1
                continue
            if not 0 <= self.started_ns - kept.ns <= RESTORED_NS:
                continue
            match kept:
                case VerdictSecond():
                    self.trust_history.add(kept.ns, kept.state, kept.ratios, kept.probabilities)
                case OutageChange():
                    self.outages.note(kept.message)
                case VerdictChange():
                    self.trust_events.append(kept.message)
                case FixClass() | SkyTrackPoints():
                    self.gnss.restore(kept)
        return bad

    def tick(self, now_ns: int, *, broker: bool) -> None:
        """Advance time: renew rates once a second, verdict and history five times."""
        if now_ns - self._ticked_ns > STALL_NS:
            self._received_ns = self._broker_back_ns = now_ns  # this process did not run: no silence of the broker
        self._ticked_ns = now_ns
        self.broker = broker and not self._broker_lost(now_ns)
        if now_ns >= self._next_second_ns:
            self._next_second_ns = now_ns + SECOND_NS
            for flow in self.topics.values():
                flow.roll(now_ns)
            self.bus_delay_p95_s = percentile(self._delays_s, 0.95)
        if now_ns >= self._next_sample_ns:
            self._next_sample_ns = now_ns + SAMPLE_NS - SAMPLE_NS // 20  # late calls must not lower the rate
            self._follow(now_ns)
            for flow in self.topics.values():
                flow.pass_to(now_ns)
            self._judge(now_ns, connected=broker)
            self.history.add(now_ns, self._sample(now_ns))
            self.track.add(track_row(self, now_ns))
            self.truth_check.update(
                now_ns,
                self.newest(NavigationSolution, "navigation/solution", now_ns, live=True),
                self.newest(TruthState, "truth/state", now_ns, live=True),
                self.newest(TrustState, "trust/state", now_ns, live=True),
            )

    def look(self, names: Iterable[str], now_ns: int) -> None:
        """Note that somebody asks for the messages of these topics."""
        self._looked_ns |= dict.fromkeys((name for name in names if name in self.topics), now_ns)
        self._follow(now_ns)

    def _follow(self, now_ns: int) -> None:
        """Decide which fast topics are followed: looked at, drawn, or of which no heartbeat tells; in a replay all."""
        looked = self.series.looked_at(now_ns)
        looked |= {name for name, asked_ns in self._looked_ns.items() if now_ns - asked_ns < POLL_PERIOD_NS}
        for name, flow in self.topics.items():
            if on_demand(flow.topic) and not self.replay:
                flow.follow(followed=name in looked or not flow.tally.count)
        self.followed = frozenset(name for name, flow in self.topics.items() if flow.topic.fast and flow.followed)

    def newest(self, kind: type[M], name: str, now_ns: int, *, live: bool = False) -> M | None:
        """Give the newest message of a topic; with `live`, only while it is not stale."""
        flow = self.topics[name]
        if live and (flow.freshness(now_ns) in ("stale", "never") or self.is_earlier(name)):
            return None
        return flow.message if isinstance(flow.message, kind) else None

    @property
    def is_slowed(self) -> bool:
        """Whether this computer is too slow to send pages more than one frame a second."""
        load = self.topics["health/load"].message
        return isinstance(load, ProcessLoad) and Work.PAGES in load.paused and not self.has_ended("core.fusion")

    def is_earlier(self, name: str) -> bool:
        """Whether the newest message of a periodic topic is from before the last start of its producer.

        Or from before the last start of this process or of the broker: then the broker has kept it.
        """
        flow = self.topics[name]
        if flow.limits is None or flow.heard_ns is None:
            return False
        return flow.heard_ns < self._counts_from_ns or flow.incarnation < self._life(flow.producer)

    def is_awaited(self, name: str, now_ns: int) -> bool:
        """Whether a topic is still to come after a start, and nothing is known that keeps it away."""
        flow = self.topics[name]
        if flow.producer and not self.is_earlier(name):
            return False
        started_ns = max(self._counts_from_ns, self._life(flow.producer))
        down = any(self._is_down(producer) for producer in flow.topic.producers)
        silent = any(problem.what == name for problem in self.judgement.problems)
        return (now_ns - started_ns) * 1e-9 < STARTUP_GRACE_S and not down and not silent

    def _is_down(self, process: str) -> bool:
        """Whether a process is reported down, and has not published a heartbeat itself since."""
        health = self.processes[process].health
        back = health is not None and health.state is ProcessState.READY and health.sent_ns >= self._counts_from_ns
        return self.judgement.statuses[process].down and not back

    def has_ended(self, process: str) -> bool:
        """Whether the newest health message of a process is its last one: a replay shows what was before it."""
        health = self.processes[process].health
        return health is not None and health.state.is_over and not self.replay

    @property
    def _counts_from_ns(self) -> int:
        """Time of the last start of this process, or return of the broker."""
        return max(self.started_ns, self._broker_back_ns)

    def _life(self, producer: str) -> int:
        """Incarnation of a process by its newest heartbeat or last will; 0 if none is known."""
        process = self.processes.get(producer)
        return process.health.incarnation if process and process.health else 0

    def age_s(self, name: str, now_ns: int) -> float | None:
        """Age of the newest message of a topic since the last start of its producer."""
        return None if self.is_earlier(name) else self.topics[name].age_s(now_ns)

    def live_origins(self, now_ns: int) -> list[tuple[Origin, int]]:
        """Give each origin of the data that was stated lately, with its stamp."""
        limits = self.topics["origin/state"].limits
        known = self.origins.values()
        return [(o, ns) for o, ns in known if freshness_of((now_ns - ns) * 1e-9, limits) is not Freshness.STALE]

    def simulated(self, now_ns: int) -> bool:
        """Whether the data are simulated, and nothing else."""
        kinds = {origin.kind for origin, _ in self.live_origins(now_ns)}
        return kinds == {OriginKind.SIMULATED}

    def hypotheses(self, now_ns: int) -> list[tuple[str, TrustHypotheses]]:
        """Give what each process states of the hypotheses, while it is live and newer than the process's last start."""
        limits = self.topics["trust/hypotheses"].limits
        return [
            (producer, message)
            for producer, (message, received_ns) in self.alternatives.newest.items()
            if freshness_of((now_ns - received_ns) * 1e-9, limits) is not Freshness.STALE
            and received_ns >= max(self._counts_from_ns, self._life(producer))
        ]

    def odometer(self, now_ns: int) -> tuple[float, str] | None:
        """Speed by the vehicle's own sensors [m/s] and the topic it is from, while it is live."""
        wheels = self.newest(WheelSpeeds, "vehicle/wheel_speed", now_ns, live=True)
        speeds = [v for name in WHEELS if (v := getattr(wheels, name, None)) is not None]
        if speeds:
            return fmean(speeds), "vehicle/wheel_speed"
        speed = self.newest(VehicleSpeed, "vehicle/speed", now_ns, live=True)
        return (speed.speed_m_s, "vehicle/speed") if speed else None

    def _note_health(self, health: ProcessHealth, envelope: Envelope, flow: TopicFlow) -> None:
        process = self.processes.get(health.process)
        if process is None:
            raise BadPayload(f"{envelope.topic} is of {health.process}, which is no process")
        if not envelope.retained and flow.latencies_s and health.sent_ns > health.incarnation:
            self._delays_s.append(flow.latencies_s[-1])
        process.note(health, flow.updated_ns or envelope.received_ns)
        for carried, published in () if envelope.retained else told(health):
            told_of, now_ns = self.topics[carried.topic], envelope.received_ns
            latency_s = told_of.note_told(health, carried, published=published, now_ns=now_ns)
            if latency_s is not None:
                self.series.take_latency(carried.topic, latency_s, now_ns)

    def _broker_lost(self, now_ns: int) -> bool:
        """Whether nothing is delivered any more, not even our own heartbeat."""
        return not self.replay and now_ns - self._received_ns >= BROKER_SILENT_NS

    def _judge(self, now_ns: int, *, connected: bool) -> None:
        self.judgement = self._find_judgement(now_ns, connected=connected)
        if "core.toll" in self.expected:
            shown = plaza_verdict(self, now_ns, broker=not self._broker_lost(now_ns))
            since_ns = self.verdict.since_ns if shown.state is self.verdict.state else now_ns
            self.verdict = replace(shown, since_ns=since_ns)
        else:
            shown = show(self.evidence(now_ns))
            since_ns = shown.since_ns or (self.verdict.since_ns if shown.state is self.verdict.state else now_ns)
            self.verdict = replace(shown, since_ns=since_ns)
        trust = self.newest(TrustState, "trust/state", now_ns, live=True) if self.verdict.state in KNOWN else None
        ratios = {m.monitor: ratio_of(m.outcome, m.statistic, m.threshold) for m in trust.monitors} if trust else {}
        beliefs = (
            {belief.hypothesis.value: float(f"{belief.probability:.3g}") for belief in trust.beliefs} if trust else {}
        )
        if self.trust_history.add(now_ns, self.verdict.state, ratios, beliefs):
            known = {name: round(ratio, 4) for name, ratio in ratios.items() if ratio is not None}
            self._unsaved.append(
                {
                    "kind": "verdict",
                    "ns": now_ns,
                    "state": self.verdict.state,
                    "ratios": known,
                    "probabilities": beliefs,
                }
            )

    def _find_judgement(self, now_ns: int, *, connected: bool) -> Judgement:
        """Take the judgement of `monitoring.health`, unless the broker is lost or the report is overdue.

        The age of the report is that at the newest message of all: while nothing is delivered it says nothing.
        """
        report = self.newest(DeadlineReport, "deadline/report", now_ns)
        reported_ns = self.topics["deadline/report"].heard_ns or 0
        if self.replay and report is None:
            return unavailable(self.expected, None)  # none was recorded
        overdue = self._received_ns - max(reported_ns, self._broker_back_ns) >= REPORT_DEADLINE_NS
        if self._broker_lost(now_ns):
            return unavailable(self.expected, broker_problem(self._received_ns, connected=connected))
        if report is not None and not self.is_earlier("deadline/report") and not overdue:
            return from_report(report)
        if reported_ns < self.started_ns and (now_ns - self.started_ns) * 1e-9 < STARTUP_GRACE_S:
            return unavailable(self.expected, None)
        if not overdue:  # the broker or monitoring.health was restarted, and the first report is to come
            return unavailable(self.expected, None) if self.judgement.complete else self.judgement
        return unavailable(self.expected, watchdog_problem(max(reported_ns, self.started_ns)))

    def evidence(self, now_ns: int) -> Evidence:
        """Collect what the banner shows."""
        solution = self.newest(NavigationSolution, "navigation/solution", now_ns)
        navigation = self.newest(NavigationState, "navigation/state", now_ns, live=True)
        without_trust = self.is_earlier("trust/state") or self.has_ended("core.trust")
        trust = None if without_trust else self.newest(TrustState, "trust/state", now_ns)
        return Evidence(
            broker=not self._broker_lost(now_ns),
            received_ns=self._received_ns,
            awaited=self._awaited(trust, now_ns),
            earlier_monitors=frozenset(m.monitor for m in trust.monitors if self._is_old(m)) if trust else frozenset(),
            trust=trust,
            trust_age_s=None if without_trust else self.age_s("trust/state", now_ns),
            trust_cause=self.judgement.cause("trust/state"),
            solution=solution,
            solution_age_s=self.age_s("navigation/solution", now_ns),
            filter_says=navigation.reason if navigation else None,
            filter_codes=navigation.reason_codes if navigation else (),
            phase=navigation.phase if navigation else None,
            fix=self.newest(GnssFix, "gnss/fix", now_ns),
            fix_age_s=self.age_s("gnss/fix", now_ns),
            imu_age_s=self.age_s("imu/sample", now_ns),
            odometer_age_s=_least(self.age_s(name, now_ns) for name in ("vehicle/wheel_speed", "vehicle/speed")),
            aiding={
                kind: (u, (now_ns - min(u.sampled_ns, ns)) * 1e-9)
                for kind, (u, ns) in self.aiding.items()
                if ns >= max(self._counts_from_ns, self._life("core.fusion"))
            },
            alert_limit_horizontal_m=navigation.alert_limit_horizontal_m if navigation else None,
            alert_limit_vertical_m=navigation.alert_limit_vertical_m if navigation else None,
            set_up=self.newest(SetUpState, "navigation/set_up", now_ns),
            cause=self.judgement.cause("navigation/solution"),
            load=None if self.has_ended("core.fusion") else self.newest(ProcessLoad, "health/load", now_ns),
        )

    def _awaited(self, trust: TrustState | None, now_ns: int) -> CodedText | None:
        """Name what must come before a verdict holds: the verdict itself, and the solution if it says there is one."""
        if trust is None:
            verdict = explain(Code.FIRST_VERDICT, process("core.trust"))
            return stated(verdict) if self.is_awaited("trust/state", now_ns) else None
        if trust.state in WITH_POSITION and self.is_earlier("navigation/solution"):
            return stated(explain(Code.FIRST_SOLUTION, process("core.fusion")))
        return None

    def _is_old(self, statement: TrustMonitor) -> bool:
        """Whether the process of a monitor was restarted since this statement."""
        return statement.sampled_ns < self._life(self.monitor_producers.get(statement.monitor, ""))

    def _sample(self, now_ns: int) -> dict[str, float | None]:
        """Take one row of the history; what is stale is missing."""
        row: dict[str, float | None] = {}
        if solution := self.newest(NavigationSolution, "navigation/solution", now_ns, live=True):
            row |= {
                "latitude_deg": solution.latitude_deg,
                "longitude_deg": solution.longitude_deg,
                "height_ellipsoid_m": solution.height_ellipsoid_m,
                "speed_fused_m_s": hypot(*solution.velocity_ned_m_s[:2]),
                "heading_rad": solution.yaw_rad,
                "position_95_m": ellipse_95(solution.position_cov_ned_m2).semi_major_m,
                "gnss_age_s": solution.gnss_age_s,
            }
        if fix := self.newest(GnssFix, "gnss/fix", now_ns, live=True):
            row |= {"speed_gnss_m_s": fix.ground_speed_m_s, "satellites_used": fix.satellites_used}
        if odometer := self.odometer(now_ns):
            row["speed_odometer_m_s"] = odometer[0]
        if truth := self.newest(TruthState, "truth/state", now_ns, live=True):
            row["speed_truth_m_s"] = hypot(*truth.velocity_ned_m_s[:2]) if truth.velocity_ned_m_s else None
            if solution and (offset := offset_m(solution, truth)):
                row["position_error_m"] = hypot(*offset)
        return row


def _least(ages_s: Iterable[float | None]) -> float | None:
    return min((age_s for age_s in ages_s if age_s is not None), default=None)
