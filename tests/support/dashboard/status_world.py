"""A state and the messages that fill it, at a time line that the test moves."""

from dataclasses import dataclass, field

from services.monitoring.status.state import State
from shared.bus import codec
from shared.messages.base import Message
from shared.messages.explanation import Explanation, explain
from shared.messages.gnss import FixType, GnssFix
from shared.messages.navigation import AidingKind, AidingUpdate, NavigationPhase, NavigationSolution, NavigationState
from shared.messages.operation import ProcessHealth, ProcessState
from shared.messages.trust import Outcome, TrustLevel, TrustMonitor, TrustState
from shared.runtime.config import parse_vehicle
from shared.words.words import reason
from tests.support.bus.envelopes import sent_bytes
from tests.support.watchdog import Watchdog

START_NS = 1_795_000_000 * 10**9
SECOND_NS = 10**9
SIMULATED = "[vehicle]\nname = 'truck-07'\n[sensors.simulator]\n"


@dataclass
class World:
    """Feeds a state; `pass_time` ticks it as the process does."""

    toml: str = SIMULATED
    now_ns: int = START_NS
    broker: bool = True
    state: State = field(init=False)
    sequence: int = 0
    lives: dict[str, int] = field(default_factory=dict)  # incarnations of processes that were restarted
    watchdog: Watchdog | None = field(init=False)  # None: monitoring.health does not run

    def __post_init__(self) -> None:
        expected = parse_vehicle(self.toml).processes
        self.state = State("truck-07", expected, self.now_ns, 900.0)
        self.watchdog = Watchdog(expected, self.now_ns)

    def hear(self, message: Message, producer: str, *, delay_s: float = 0.0, retained: bool = False) -> None:
        name, body = codec.topic_name(message), codec.encode(message)
        self.hear_bytes(name, body, producer, delay_s=delay_s, retained=retained, message=message)

    def hear_bytes(
        self,
        topic: str,
        body: bytes,
        producer: str,
        *,
        delay_s: float = 0.0,
        retained: bool = False,
        message: Message | None = None,
    ) -> None:
        self.sequence += 1
        received_ns = self.now_ns + int(delay_s * 1e9)
        life = self.lives.get(producer, START_NS)
        envelope = sent_bytes(topic, body, received_ns, producer, life, self.sequence, retained=retained)
        if self.watchdog:
            self.watchdog.take(envelope, message)
        self.state.receive(envelope)

    def pass_time(self, seconds: float, step_s: float = 0.1) -> None:
        """Let time pass; meanwhile only the two observers themselves publish, as long as the broker works."""
        for _ in range(round(seconds / step_s)):
            self.now_ns += int(step_s * 1e9)
            if self.broker:
                self.beat("monitoring.status", *(["monitoring.health"] if self.watchdog else []))
            for message in self.watchdog.step(self.now_ns, connected=self.broker) if self.watchdog else []:
                self.hear(message, "monitoring.health")
            self.state.tick(self.now_ns, broker=self.broker)

    def beat(self, *processes: str, **changes: object) -> None:
        for name in processes:
            life = self.lives.get(name, START_NS)
            health = ProcessHealth(process=name, state=ProcessState.READY, incarnation=life, sent_ns=self.now_ns)
            self.hear(health.model_copy(update=changes), name)


ALL = parse_vehicle(SIMULATED).processes


def solution(now_ns: int, **changes: object) -> NavigationSolution:
    base = NavigationSolution(
        sampled_ns=now_ns,
        phase=NavigationPhase.NAVIGATING,
        latitude_deg=48.0,
        longitude_deg=11.0,
        height_ellipsoid_m=500.0,
        velocity_ned_m_s=(3.0, 4.0, 0.0),
        roll_rad=0.0,
        pitch_rad=0.0,
        yaw_rad=0.5,
        position_cov_ned_m2=(1.0, 0.0, 0.0, 1.0, 0.0, 4.0),
        velocity_cov_ned_m2_s2=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01),
        attitude_cov_ned_rad2=(1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4),
        angular_rate_body_rad_s=(0.0, 0.0, 0.0),
        accelerometer_bias_m_s2=(0.0, 0.0, 0.0),
        gyroscope_bias_rad_s=(0.0, 0.0, 0.0),
        stationary=False,
        gnss_age_s=0.2,
    )
    return base.model_copy(update=changes)


def fix(now_ns: int, **changes: object) -> GnssFix:
    base = GnssFix(
        sampled_ns=now_ns,
        received_ns=now_ns,
        source="gnss0",
        utc_ns=now_ns - 250_000_000,
        fix_type=FixType.THREE_D,
        satellites_used=14,
        latitude_deg=48.0,
        longitude_deg=11.0,
        velocity_ned_m_s=(3.0, 4.0, 0.0),
        ground_speed_m_s=5.0,
    )
    return base.model_copy(update=changes)


def navigation(now_ns: int, phase: NavigationPhase, reason: str) -> NavigationState:
    return NavigationState(
        sampled_ns=now_ns,
        phase=phase,
        since_ns=now_ns,
        reason=reason,
        fixes_used=1,
        fixes_rejected=0,
        samples_used=1,
        samples_rejected=0,
        imu_gaps=0,
        resets=0,
    )


def aiding(kind: AidingKind, test_ratio: float, *, used: bool = True) -> AidingUpdate:
    return AidingUpdate(
        sampled_ns=0,
        source="gnss0",
        kind=kind,
        innovation=(1.0,),
        innovation_sd=(1.0,),
        test_ratio=test_ratio,
        used=used,
    )


def monitor(now_ns: int, name: str = "inertial_short", **changes: object) -> TrustMonitor:
    base = TrustMonitor(
        sampled_ns=now_ns, monitor=name, outcome=Outcome.PASS, reason="statistic below the threshold",
        since_ns=now_ns, statistic=4.0, threshold=8.0, false_alarm_rate=1e-5, window_s=5.0,
    )  # fmt: skip
    return base.model_copy(update=changes)


# The code and the row with which core.trust decides for a state, unless a test names others.
DECIDING = {
    TrustLevel.INITIALISING: (1, "trust.no_solution_yet"),
    TrustLevel.NO_FIX: (2, "trust.solution_old"),
    TrustLevel.UNSAFE: (4, "trust.no_solution_without_gnss"),
    TrustLevel.DEAD_RECKONING: (5, "trust.gnss_excluded"),
    TrustLevel.CAUTION: (6, "trust.gnss_disturbed"),
    TrustLevel.SAFE: (9, "trust.safe"),
}


def trust(
    now_ns: int, level: TrustLevel = TrustLevel.SAFE, *why: Explanation, **changes: object
) -> TrustState:  # fmt: skip
    """A verdict with the codes that are given; with `reasons` alone it is a message without codes."""
    row, code = DECIDING[level]
    codes = why or (() if "reasons" in changes else (explain(code),))
    base = TrustState(
        sampled_ns=now_ns, state=level, since_ns=START_NS, row=row, reasons=tuple(reason(code) for code in codes),
        reason_codes=codes, alert_limit_horizontal_m=10.0, alert_limit_vertical_m=20.0, monitors=(monitor(now_ns),),
    )  # fmt: skip
    return base.model_copy(update=changes)
