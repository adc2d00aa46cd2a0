"""All that the status process knows, updated message by message; pure: time is an argument."""

from collections import deque
from collections.abc import Iterable, Sequence
from math import hypot
from statistics import fmean
from typing import TypeVar

from shared.bus.bus import Envelope
from shared.errors import BadPayload
from shared.messages.base import Message
from shared.messages.gnss import GnssFix
from shared.messages.navigation import AidingKind, AidingUpdate, NavigationSolution, NavigationState, TruthState
from shared.messages.operation import DeadlineReport, Freshness, Origin, Outage, ProcessHealth
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds
from shared.processes import BY_NAME as PROCESS_ROWS
from shared.runtime.freshness import percentile
from shared.topics import BY_NAME, TOPICS, topic_of

from .flow import ProcessFlow, TopicFlow
from .history import History
from .outages import OutageBook
from .problems import DOWN, Problem, Status, find_problems, root_cause, status_of
from .views.banner import Evidence, Trust, Verdict, judge
from .views.geometry import ellipse_95, offset_m

M = TypeVar("M", bound=Message)
SAMPLE_NS = 200_000_000
SECOND_NS = 1_000_000_000
BROKER_LOST_AFTER_NS = 2 * SECOND_NS  # shorter breaks heal unseen
WHEELS = ("front_left_m_s", "front_right_m_s", "rear_left_m_s", "rear_right_m_s")


class State:
    """The newest of everything: topics, processes, verdict, history, outages."""

    def __init__(self, vehicle: str, expected: Sequence[str], started_ns: int, history_s: float) -> None:
        self.vehicle, self.expected, self.started_ns = vehicle, frozenset(expected), started_ns
        self.topics = {t.name: TopicFlow(t.name, t) for t in TOPICS if not t.per_process}
        self.processes = {name: ProcessFlow(name) for name in PROCESS_ROWS}
        self.statuses = dict.fromkeys(PROCESS_ROWS, Status.WAITING)
        self.origins: dict[str, tuple[Origin, int]] = {}
        self.aiding: dict[AidingKind, tuple[AidingUpdate, int]] = {}
        self.rejections: dict[AidingKind, int] = {}
        self.history, self.outages = History(history_s), OutageBook()
        self.problems: list[Problem] = []
        self.broker, self.broker_seen_ns = False, started_ns
        self.verdict: Verdict = judge(Evidence(broker=True))
        self.verdict_since_ns = started_ns
        self.timeline: deque[tuple[int, Trust]] = deque([(started_ns, Trust.STALE)], maxlen=200)
        self.bus_delay_p95_s: float | None = None
        self._delays_s: deque[float] = deque(maxlen=256)
        self._next_sample_ns = self._next_second_ns = started_ns

    def receive(self, envelope: Envelope) -> None:
        """Take one message; raises `BadPayload` if it cannot be read."""
        name = envelope.topic
        flow = self.topics.get(name)
        if flow is None:
            topic = topic_of(name)
            if topic is None or not topic.per_process or name.rsplit("/", 1)[1] not in PROCESS_ROWS:
                return
            flow = self.topics[name] = TopicFlow(name, topic)
        message = flow.note(envelope)
        match message:
            case ProcessHealth():
                self._note_health(message, envelope, flow)
            case AidingUpdate():
                self.aiding[message.kind] = (message, envelope.received_ns)
                if not message.used:
                    self.rejections[message.kind] = self.rejections.get(message.kind, 0) + 1
            case Origin():
                self.origins[envelope.producer] = (message, flow.updated_ns or 0)
            case Outage():
                self.outages.report(message)

    def tick(self, now_ns: int, *, broker: bool) -> None:
        """Let time pass: renew rates once a second, verdict and history five times."""
        self.broker = broker
        if broker:
            self.broker_seen_ns = now_ns
        if now_ns >= self._next_second_ns:
            self._next_second_ns = now_ns + SECOND_NS
            for flow in self.topics.values():
                flow.roll()
            self.bus_delay_p95_s = percentile(self._delays_s, 0.95)
        if now_ns >= self._next_sample_ns:
            self._next_sample_ns = now_ns + SAMPLE_NS - SAMPLE_NS // 20  # late calls must not lower the rate
            self._judge(now_ns)
            self.history.add(now_ns, self._sample(now_ns))

    def newest(self, kind: type[M], name: str, now_ns: int, *, live: bool = False) -> M | None:
        """Give the newest message of a topic; with `live`, only while it is not stale."""
        flow = self.topics[name]
        if live and flow.freshness(now_ns) in ("stale", "never"):
            return None
        return flow.message if isinstance(flow.message, kind) else None

    def age_s(self, name: str, now_ns: int) -> float | None:
        """Age of the newest message of a topic."""
        return self.topics[name].age_s(now_ns)

    def restarts(self, name: str, now_ns: int) -> int:
        """Count the restarts of a process, seen here or by `monitoring.health`."""
        report = self.newest(DeadlineReport, "deadline/report", now_ns, live=True)
        reported = [row.restarts for row in report.processes if row.process == name] if report else []
        return max([self.processes[name].restarts, *reported])

    def broker_lost(self, now_ns: int) -> bool:
        """Tell whether the broker has been away for longer than a reconnection takes."""
        return not self.broker and now_ns - self.broker_seen_ns > BROKER_LOST_AFTER_NS

    def odometer(self, now_ns: int) -> tuple[float, str] | None:
        """Speed by the vehicle's own sensors [m/s] and the topic it is from, while it is live."""
        wheels = self.newest(WheelSpeeds, "vehicle/wheel_speed", now_ns, live=True)
        speeds = [v for name in WHEELS if (v := getattr(wheels, name, None)) is not None]
        if speeds:
            return fmean(speeds), "vehicle/wheel_speed"
        speed = self.newest(VehicleSpeed, "vehicle/speed", now_ns, live=True)
        return (speed.speed_m_s, "vehicle/speed") if speed else None

    def cause(self, name: str, now_ns: int) -> str:
        """Say what is behind the silence of a topic: by `monitoring.health`, or by our own search if that is dead."""
        report = self.newest(DeadlineReport, "deadline/report", now_ns, live=True)
        for row in report.topics if report else ():
            if row.topic == name and row.cause:
                return row.cause
        return root_cause(BY_NAME[name], self.statuses, lambda other: self.topics[other].freshness(now_ns))

    def _note_health(self, health: ProcessHealth, envelope: Envelope, flow: TopicFlow) -> None:
        process = self.processes.get(health.process)
        if process is None:
            raise BadPayload(f"{envelope.topic} speaks for {health.process}, which is no process")
        if not envelope.retained and flow.latencies_s and health.sent_ns > health.incarnation:
            self._delays_s.append(flow.latencies_s[-1])
        process.note(health, flow.updated_ns or envelope.received_ns)

    def _judge(self, now_ns: int) -> None:
        uptime_s = (now_ns - self.started_ns) * 1e-9
        for name, flow in self.processes.items():
            self.statuses[name] = status_of(flow, now_ns, expected=name in self.expected, uptime_s=uptime_s)
        if self.broker_lost(now_ns):
            self.problems = [Problem("broker", "the message broker does not answer", self.broker_seen_ns)]
        elif self.broker:
            self.problems = find_problems(self.topics, self.processes, self.statuses, now_ns)
        found = {p.what: (p.since_ns, p.text) for p in self.problems if p.lost and p.since_ns is not None}
        self.outages.observe(now_ns, found, self._lost(now_ns))
        verdict = judge(self.evidence(now_ns))
        if verdict.code != self.verdict.code:
            self.verdict_since_ns = now_ns
        if verdict.state is not self.timeline[-1][1]:
            self.timeline.append((now_ns, verdict.state))
        self.verdict = verdict

    def _lost(self, now_ns: int) -> dict[str, str]:
        """Name everything that is lost now, and why: the broker, processes that are down, topics that are stale."""
        if not self.broker:
            unknown = dict.fromkeys((*self.statuses, *self.topics), "the message broker does not answer")
            return {"broker": "it does not answer", **unknown}
        processes = {name: f"{name} is {status}" for name, status in self.statuses.items() if status in DOWN}
        topics = {
            name: self.cause(name, now_ns)
            for name, flow in self.topics.items()
            if not flow.topic.per_process and flow.freshness(now_ns) is Freshness.STALE
        }
        return processes | topics

    def evidence(self, now_ns: int) -> Evidence:
        """Collect what the verdict rests on."""
        solution = self.newest(NavigationSolution, "navigation/solution", now_ns)
        navigation = self.newest(NavigationState, "navigation/state", now_ns, live=True)
        stale = self.topics["navigation/solution"].freshness(now_ns) in ("stale", "never")
        return Evidence(
            broker=not self.broker_lost(now_ns),
            solution=solution,
            solution_age_s=self.age_s("navigation/solution", now_ns),
            filter_says=navigation.reason if navigation else None,
            phase=navigation.phase if navigation else None,
            fix=self.newest(GnssFix, "gnss/fix", now_ns),
            fix_age_s=self.age_s("gnss/fix", now_ns),
            imu_age_s=self.age_s("imu/sample", now_ns),
            odometer_age_s=_least(self.age_s(name, now_ns) for name in ("vehicle/wheel_speed", "vehicle/speed")),
            aiding={kind: (u, (now_ns - ns) * 1e-9) for kind, (u, ns) in self.aiding.items()},
            down=tuple(name for name, status in self.statuses.items() if status in DOWN),
            cause=self.cause("navigation/solution", now_ns) if stale else None,
        )

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
            row["speed_truth_m_s"] = hypot(*truth.velocity_ned_m_s[:2])
            if solution and (offset := offset_m(solution, truth)):
                row["position_error_m"] = hypot(*offset)
        return row


def _least(ages_s: Iterable[float | None]) -> float | None:
    return min((age_s for age_s in ages_s if age_s is not None), default=None)
