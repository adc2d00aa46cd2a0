"""A simulated on-board unit: a bus without a broker, on which a vehicle drives a circle.

It exists so that the web pages can be tested in states that a real unit takes minutes to reach. Its
messages are made by the contract's own types and codec; what it says of the world is arithmetic.
"""

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

from services.core.trust.process import Config as TrustConfig
from services.core.trust.process import Process as TrustProcess
from shared.attacks import BY_NAME as ATTACK_ROWS
from shared.bus import codec
from shared.bus.bus import Envelope
from shared.messages.base import Message, Tick, Vector3
from shared.messages.explanation import Reference, ReferenceKind, explain
from shared.messages.gnss import (
    CarrierSolution,
    Constellation,
    FixType,
    GnssConfiguration,
    GnssFix,
    GnssRaw,
    GnssRawEpoch,
    GnssReceiver,
    GnssSatellites,
    GnssSignal,
    GnssSignalQuality,
    GnssSignals,
    InterferenceState,
    RadioPath,
    RawMeasurement,
    ReceiverClock,
    ReceiverStatus,
    Satellite,
    SignalFlags,
    SignalQuality,
)
from shared.messages.imu import ImuRaw, ImuSamples
from shared.messages.navigation import (
    AidingKind,
    AidingUpdate,
    NavigationPhase,
    NavigationSolution,
    NavigationState,
    SetUpCheck,
    SetUpState,
    SetUpVerdict,
    TruthState,
)
from shared.messages.operation import (
    DeviceFound,
    DeviceState,
    MessageKind,
    MessageUse,
    Mode,
    ModeState,
    Origin,
    OriginKind,
    ProcessHealth,
    ProcessState,
    RecordingState,
    TopicTraffic,
)
from shared.messages.simulation import AttackCommand, AttackRun, SimulationAttack, SimulationState
from shared.messages.trust import (
    Belief,
    Hypothesis,
    HypothesisSolution,
    MonitorTest,
    Outcome,
    TrustHypotheses,
    TrustMonitor,
    TrustState,
)
from shared.messages.vehicle import CanRaw, WheelSpeeds
from shared.runtime.config import parse_vehicle
from shared.topics import TOPICS, topic_of
from shared.trust.result import SATELLITE_LEFT_OUT
from shared.words.words import reason
from tests.support.bus.envelopes import sent_bytes
from tests.support.watchdog import Watchdog

RADIUS_M, SPEED_M_S = 60.0, 9.0
LATITUDE_DEG, LONGITUDE_DEG, HEIGHT_M = 48.1351, 11.5820, 519.2
METRES_PER_DEG = 111_200.0
LIFE = 1_795_000_000 * 10**9
VEHICLE_TOML = "[vehicle]\nname = 'truck-07'\n[sensors.simulator]\n"
SATELLITE_TESTS = tuple(
    MonitorTest(
        name=name, outcome=outcome, statistic=statistic, threshold=4.2,
        reason_code=explain(
            code, Reference(kind=ReferenceKind.SATELLITE, name=name), residual_m=residual_m
        ),
    )
    for name, outcome, statistic, code, residual_m in (
        ("G05", Outcome.ACCUSES, 9.1, SATELLITE_LEFT_OUT, 31.2),
        ("E02", Outcome.PASS, 0.3, "cooperative.used_without_bias", 0.4),
    )
)  # fmt: skip
EVIDENCE_TESTS = tuple(
    MonitorTest(name=name, outcome=Outcome.PASS, reason="nothing indicated", statistic=0.0, threshold=1.0)
    for name in ("jamming", "spoofing", "cn0_uniformity", "cn0_level", "gain", "clock_step", "clock_drift", "count")
)
STATED_BY = {
    "inertial_short": "core.spoofing", "inertial_long": "core.spoofing", "satellites": "core.cooperative",
    "evidence": "core.evidence",
}  # fmt: skip
APART_M = {Hypothesis.NOTHING: 0.0, Hypothesis.GNSS: 18.0, Hypothesis.IMU: -9.0, Hypothesis.ODOMETER: 2.0}
SIMULATED = parse_vehicle(VEHICLE_TOML).processes


class FakePlaza(Protocol):
    """What else may feed the bus."""

    watchdog: Watchdog

    def step(self) -> None:
        """Feed everything that is due now."""


class FakeBus:
    """Has the interface of `shared.bus.bus.Bus`; published messages are received."""

    def __init__(self, state_dir: Path, vehicle: str = "truck-07") -> None:
        self.state_dir, self.vehicle, self.vehicle_toml = state_dir, vehicle, VEHICLE_TOML
        self.stopping, self.connected = False, True
        self.rejects: Counter[str] = Counter()
        self.last_error: str | None = None
        self.offset_ns = 1_795_000_000 * 10**9 - time.monotonic_ns()
        self.unit: FakeUnit | FakePlaza | None = None
        self.published: list[Message] = []
        self.lives: Counter[str] = Counter()  # restarts of each process
        self.followed = frozenset(topic.name for topic in TOPICS if topic.fast)
        self._carried: dict[tuple[str, str], TopicTraffic] = {}  # of each producer and fast topic
        self._fed: deque[Envelope] = deque()
        self._sequence = 0
        self._next_heartbeat_ns = 0
        self._lock = threading.Lock()

    def now_ns(self) -> int:
        """Read the time line."""
        return time.monotonic_ns() + self.offset_ns

    def feed(self, message: Message, producer: str, *, delay_s: float = 0.0008) -> None:
        """Put a message onto the bus as that process."""
        envelope = self.feed_bytes(codec.topic_name(message), codec.encode(message), producer, delay_s=delay_s)
        if self.unit is not None:
            self.unit.watchdog.take(envelope, message)
        if (topic := topic_of(envelope.topic)) is not None and topic.fast:
            before, now_ns = self._carried.get((producer, topic.name)), self.now_ns()
            self._carried[producer, topic.name] = TopicTraffic(
                topic=topic.name, count=before.count + 1 if before else 1,
                newest_ns=now_ns, stamp_ns=codec.stamp_ns(topic, envelope.payload),
            )  # fmt: skip

    def carried(self, producer: str) -> tuple[TopicTraffic, ...]:
        """What a process has published of fast topics, as its heartbeat tells it."""
        return tuple(carried for (name, _), carried in self._carried.items() if name == producer)

    def feed_bytes(self, topic: str, body: bytes, producer: str, *, delay_s: float = 0) -> Envelope:
        """Put any payload onto the bus, also an invalid one."""
        with self._lock:
            self._sequence += 1
            now_ns = self.now_ns() + int(delay_s * 1e9)
            envelope = sent_bytes(topic, body, now_ns, producer, LIFE + self.lives[producer], self._sequence)
            self._fed.append(envelope)
            return envelope

    def publish(self, message: Message) -> None:
        """Keep what the process itself publishes; the simulator of the unit answers commands."""
        self.published.append(message)
        if isinstance(self.unit, FakeUnit) and isinstance(message, SimulationAttack):
            self.unit.command(message)

    def follow(self, fast: frozenset[str]) -> None:
        """Deliver of the fast topics only these."""
        self.followed = fast

    def receive(self, timeout_s: float) -> list[Envelope]:
        """Return the messages that are due."""
        time.sleep(min(timeout_s, 0.01))
        if self.unit is not None:
            self.unit.step()
        elif self.now_ns() >= self._next_heartbeat_ns:  # the process itself is alone on the bus
            self._next_heartbeat_ns = self.now_ns() + 500_000_000
            self.feed(heartbeat("monitoring.status", self.now_ns()), "monitoring.status")
        with self._lock:
            due = [envelope for envelope in self._fed if self._is_followed(envelope.topic)]
            self._fed.clear()
        return due if self.connected else []

    def _is_followed(self, name: str) -> bool:
        topic = topic_of(name)
        return topic is None or not topic.fast or topic.name in self.followed


def heartbeat(process: str, now_ns: int) -> ProcessHealth:
    """Make the heartbeat of a process that has just started."""
    return ProcessHealth(process=process, state=ProcessState.READY, incarnation=LIFE, sent_ns=now_ns)


KINDS = (
    MessageKind(kind="UBX NAV-PVT", use=MessageUse.USED, count=812, rejected=2, reason="ubx_date"),
    MessageKind(kind="UBX HNR-PVT", use=MessageUse.UNUSED, count=40),
    MessageKind(kind="UBX 77-01", use=MessageUse.UNKNOWN, count=3),
)
PORT = DeviceState(
    sampled_ns=0, source="gnss0", process="sensors.gnss", device="serial:///dev/obu-gnss?baud=115200",
    found=DeviceFound.WORKING, protocols=("UBX", "NMEA"), rate_baud=38400,
    sentence="UBX, NMEA at 38400 baud, not at the 115200 of the vehicle file: write baud=38400 in the device's URL to "
    "find it at once",
)  # fmt: skip


class FakeUnit:
    """Publishes the messages of a whole unit at their rates; attributes inject faults."""

    def __init__(self, bus: FakeBus) -> None:
        self.bus, self.started_ns = bus, bus.now_ns()
        self.silent: set[str] = set()  # processes that have stopped (SIGSTOP)
        self.lost: set[str] = set()  # processes that were killed
        self.rejecting = False
        self.coasting = False
        self.protection_level_m = 3.14  # horizontal, while it does not coast
        self.aligning = False  # core.fusion runs, but has no solution yet
        self.watchdog = Watchdog(SIMULATED, self.started_ns)
        self.beliefs: tuple[Belief, ...] = ()  # stated by core.trust in place of its own
        self.suspected_ns: int | None = None  # since when positions under the hypotheses are published
        self.trust = TrustProcess(TrustConfig())  # the verdict is that of the real process
        self.attacks: list[AttackRun] = []
        self.port = PORT  # what was found at the port of the receiver
        self._due: dict[str, int] = {}
        self._plans: list[tuple[int, float, Callable[[], object]]] = []
        self._rounds = 0  # seconds of which the unit has told: fewer than have passed, on a busy machine
        bus.unit = self

    def step(self) -> None:
        """Publish everything that is due now."""
        now_ns = self.bus.now_ns()
        for plan in [plan for plan in self._plans if plan[0] <= now_ns and plan[1] <= self._rounds]:
            self._plans.remove(plan)
            plan[2]()
        for name, rate_hz, make in (
            ("imu", 100.0, self._imu),
            ("fast", 10.0, self._fast),
            ("slow", 1.0, self._slow),
            ("beat", 2.0, self._heartbeats),
            ("origin", 0.5, self._origin),
            ("trust", 1.0, self._trust),
            ("hypotheses", 1.0, self._hypotheses),
        ):
            due_ns = self._due.setdefault(name, now_ns)
            if now_ns < due_ns:
                continue
            self._due[name] = max(due_ns + int(1e9 / rate_hz), now_ns - 200_000_000)
            self._rounds += name == "trust"
            for producer, message in make(now_ns):
                if producer not in self.silent | self.lost:
                    self.bus.feed(message, producer)
                    self._judge(message)
        if "monitoring.health" not in self.silent | self.lost:
            for message in self.watchdog.step(now_ns, connected=self.bus.connected):
                self.bus.feed(message, "monitoring.health")

    def _judge(self, message: Message) -> None:
        """Let core.trust use a message, and publish what follows from it."""
        if "core.trust" in self.silent | self.lost:
            return
        if isinstance(message, TrustMonitor | NavigationSolution | NavigationState | Tick):
            for trust_state in self.trust.handle(message):
                if isinstance(trust_state, TrustState) and self.beliefs:
                    suspected = explain("trust.unsafe_suspected", suspects=(Hypothesis.GNSS, Hypothesis.IMU))
                    more = {
                        "beliefs": self.beliefs,
                        "reason_codes": (suspected, *trust_state.reason_codes),
                        "reasons": (reason(suspected), *trust_state.reasons),
                    }
                    self.bus.feed(trust_state.model_copy(update=more), "core.trust")
                else:
                    self.bus.feed(trust_state, "core.trust")

    def command(self, message: SimulationAttack) -> None:
        """Note an attack, or the end of those that were active, and answer as the simulator does."""
        now_ns = self.bus.now_ns()
        if message.command is AttackCommand.START and message.attack:
            parameters = ATTACK_ROWS[message.attack].complete(message.parameters)
            self.attacks.append(AttackRun(attack=message.attack, parameters=parameters, started_ns=now_ns))
        else:
            stopped = [run for run in self.attacks if run.ended_ns is None and message.attack in (None, run.attack)]
            self.attacks = [
                run.model_copy(update={"ended_ns": now_ns}) if run in stopped else run for run in self.attacks
            ]
        state = SimulationState(sampled_ns=now_ns, request_id=message.request_id, attacks=tuple(self.attacks))
        self.bus.feed(state, "sensors.simulator")

    def fall_silent_after(self, seconds: float, name: str) -> None:
        """Stop a process, or the IMU alone, after a while."""
        self._plans.append((self.started_ns + int(seconds * 1e9), seconds, lambda: self.silent.add(name)))

    def kill_after(self, seconds: float, process: str) -> None:
        """Kill a process after a while."""
        self._plans.append((self.started_ns + int(seconds * 1e9), seconds, lambda: self._end(process)))

    def kill(self, process: str) -> None:
        """End a process without a regular end, from any thread; none of its messages follows its last will."""
        self._plans.append((0, 0.0, lambda: self._end(process)))

    def _end(self, process: str) -> None:
        self.lost.add(process)
        now_ns = self.bus.now_ns()
        will = ProcessHealth(process=process, state=ProcessState.LOST, incarnation=LIFE, sent_ns=now_ns)
        self.bus.feed(will, process)

    def revive(self, process: str) -> None:
        """Start a process again."""
        self.lost.discard(process)
        self.silent.discard(process)
        self.bus.lives[process] += 1

    def _angle(self, now_ns: int) -> float:
        return (now_ns - self.started_ns) * 1e-9 * SPEED_M_S / RADIUS_M

    def _place(self, now_ns: int, north_m: float = 0.0, east_m: float = 0.0) -> tuple[float, float]:
        angle = self._angle(now_ns)
        north, east = RADIUS_M * math.sin(angle) + north_m, -RADIUS_M * math.cos(angle) + east_m
        scale = METRES_PER_DEG * math.cos(math.radians(LATITUDE_DEG))
        return LATITUDE_DEG + north / METRES_PER_DEG, LONGITUDE_DEG + east / scale

    def _velocity(self, now_ns: int, factor: float = 1.0) -> Vector3:
        angle = self._angle(now_ns)
        speed = SPEED_M_S * factor
        return (speed * math.cos(angle), speed * math.sin(angle), 0.0)

    def _imu(self, now_ns: int) -> Iterator[tuple[str, Message]]:
        if "imu" in self.silent:
            return
        yield "sensors.simulator", ImuRaw(received_ns=now_ns, source="imu0", data=b"\xfa\xff\x36" + bytes(60))
        yield (
            "parsers.imu",
            ImuSamples(
                received_ns=now_ns,
                source="imu0",
                sampled_ns=(now_ns - 500_000,),
                specific_force_body_m_s2=((0.1, 1.35, -9.8),),
                angular_rate_body_rad_s=((0.0, 0.0, 0.15),),
            ),
        )

    def _fast(self, now_ns: int) -> Iterator[tuple[str, Message]]:
        wobble = 0.03 * math.sin(now_ns * 1e-9)
        yield (
            "sensors.simulator",
            CanRaw(received_ns=now_ns, source="can0", data=b"(0.0) can0 123#0011223344556677\n"),
        )
        wheel = SPEED_M_S * (1.01 + wobble / 3)
        yield (
            "parsers.can",
            WheelSpeeds(
                sampled_ns=now_ns,
                received_ns=now_ns,
                source="can0",
                rear_left_m_s=wheel - 0.2,
                rear_right_m_s=wheel + 0.2,
            ),
        )
        latitude, longitude = self._place(now_ns)
        velocity = self._velocity(now_ns)
        yaw = (self._angle(now_ns) + math.pi) % (2 * math.pi) - math.pi
        yield (
            "sensors.simulator",
            TruthState(
                sampled_ns=now_ns,
                latitude_deg=latitude,
                longitude_deg=longitude,
                height_ellipsoid_m=HEIGHT_M,
                velocity_ned_m_s=velocity,
                roll_rad=0.0,
                pitch_rad=0.0,
                yaw_rad=yaw,
                angular_rate_body_rad_s=(0.0, 0.0, 0.15),
            ),
        )
        if self.aligning:
            return
        latitude, longitude = self._place(now_ns, 0.5 + 10 * wobble, -0.4)
        yield (
            "core.fusion",
            NavigationSolution(
                sampled_ns=now_ns - 1_000_000,
                phase=self._phase(),
                latitude_deg=latitude,
                longitude_deg=longitude,
                height_ellipsoid_m=HEIGHT_M + 0.3,
                velocity_ned_m_s=velocity,
                roll_rad=0.01,
                pitch_rad=-0.005,
                yaw_rad=yaw + 0.01,
                position_cov_ned_m2=(0.6, 0.25, 0.0, 0.35, 0.0, 1.2),
                velocity_cov_ned_m2_s2=(0.01, 0.0, 0.0, 0.01, 0.0, 0.02),
                attitude_cov_ned_rad2=(1e-5, 0.0, 0.0, 1e-5, 0.0, 6e-5),
                angular_rate_body_rad_s=(0.0, 0.0, 0.15),
                accelerometer_bias_m_s2=(0.02, -0.01, 0.03),
                gyroscope_bias_rad_s=(1e-4, 2e-4, -1e-4),
                stationary=False,
                gnss_age_s=12.4 if self.coasting else (now_ns % 10**9) * 1e-9,
                protection_level_horizontal_m=14.2 if self.coasting else self.protection_level_m,
                protection_level_vertical_m=9.8 if self.coasting else 4.27,
                integrity_risk=1e-3,
            ),
        )

    def _phase(self) -> NavigationPhase:
        if self.aligning:
            return NavigationPhase.WAITING_FOR_GNSS
        return NavigationPhase.COASTING if self.coasting else NavigationPhase.NAVIGATING

    def _slow(self, now_ns: int) -> Iterator[tuple[str, Message]]:
        yield "sensors.simulator", GnssRaw(received_ns=now_ns, source="gnss0", data=b"\xb5\x62\x01\x07" + bytes(96))
        latitude, longitude = self._place(now_ns - 80_000_000, 1.4, 0.9)
        velocity = self._velocity(now_ns, 1.4 if self.rejecting else 1.0)
        yield (
            "parsers.gnss",
            GnssFix(
                sampled_ns=now_ns - 80_000_000,
                received_ns=now_ns,
                source="gnss0",
                utc_ns=now_ns - 80_000_000,
                fix_type=FixType.THREE_D,
                carrier_solution=CarrierSolution.FLOAT,
                differential=True,
                satellites_used=17,
                latitude_deg=latitude,
                longitude_deg=longitude,
                height_ellipsoid_m=HEIGHT_M + 1.0,
                velocity_ned_m_s=velocity,
                ground_speed_m_s=math.hypot(*velocity[:2]) + 0.05,
                position_sd_ned_m=(0.9, 0.9, 1.8),
                hdop=0.8,
                pdop=1.4,
                correction_age_s=1.2,
            ),
        )
        yield "parsers.gnss", self._satellites(now_ns)
        yield from self._receiver(now_ns)
        for kind, ratio in ((AidingKind.GNSS_POSITION, 0.31), (AidingKind.GNSS_VELOCITY, 0.18)):
            used = not (self.rejecting and kind is AidingKind.GNSS_VELOCITY)
            yield (
                "core.fusion",
                AidingUpdate(
                    sampled_ns=now_ns,
                    source="gnss0",
                    kind=kind,
                    innovation=(0.4, -0.2, 0.1),
                    innovation_sd=(1.1, 1.0, 2.0),
                    test_ratio=ratio if used else 4.7,
                    used=used,
                    reason=None if used else "beyond the gate",
                ),
            )
        yield (
            "core.fusion",
            NavigationState(
                sampled_ns=now_ns,
                phase=self._phase(),
                since_ns=self.started_ns,
                reason="position and heading are known",
                fixes_used=412,
                fixes_rejected=3,
                samples_used=41_200,
                samples_rejected=0,
                imu_gaps=0,
                resets=0,
                alert_limit_horizontal_m=10.0,
                alert_limit_vertical_m=20.0,
            ),
        )
        yield (
            "core.fusion",
            SetUpState(
                sampled_ns=now_ns,
                checks=(
                    SetUpCheck(
                        name="imu_axes",
                        verdict=SetUpVerdict.CONTRADICTS,
                        since_ns=self.started_ns,
                        sentence="axes are swapped: forward appears right, right appears backward",
                        setting="vehicle.imu.body_from_sensor = [[0, 1, 0], [1, 0, 0], [0, 0, -1]]",
                    ),
                    SetUpCheck(
                        name="imu_upright",
                        verdict=SetUpVerdict.AGREES,
                        since_ns=self.started_ns,
                        sentence="gravity is 0.6° from the axis down",
                    ),
                    SetUpCheck(name="lever_arm", verdict=SetUpVerdict.UNKNOWN, since_ns=self.started_ns),
                ),
            ),
        )
        mode = Mode.DEGRADED if self.rejecting or self.coasting else Mode.MEASURING
        yield (
            "controller.mode",
            ModeState(
                sampled_ns=now_ns,
                mode=mode,
                since_ns=self.started_ns,
                reason="all sources deliver",
                gnss_source="gnss0",
                imu_source="imu0",
                speed_source="can0",
            ),
        )
        yield (
            "monitoring.recorder",
            RecordingState(
                now_ns=now_ns,
                recording=True,
                file="2026-11-21T02.mcap",
                bytes_written=(now_ns - self.started_ns) // 10_000,
                messages=1000,
                dropped=0,
                free_bytes=41_000_000_000,
            ),
        )

    def suspect(self) -> None:
        """Let GNSS or the inertial sensors be wrong: positions under each hypothesis drift apart from now on."""
        since_ns = self.suspected_ns = self.bus.now_ns()

        def belief(hypothesis: Hypothesis, prior: float, probability: float, reason: str) -> Belief:
            survives = probability > 1e-3
            spoken_for = survives and hypothesis is not Hypothesis.NOTHING
            return Belief(
                hypothesis=hypothesis, prior=prior, probability=probability, survives=survives, reason=reason,
                since_ns=since_ns if spoken_for else None,
            )  # fmt: skip

        self.beliefs = (
            belief(Hypothesis.GNSS, 1e-4, 0.62, "the free run is 18 m from GNSS, its own spread is 4 m"),
            belief(Hypothesis.IMU, 1e-3, 0.375, "the gyroscope turns 3 deg/s faster than the wheels"),
            belief(Hypothesis.NOTHING, 0.998, 4e-5, "a separation of 18 m is beyond its spread"),
            belief(Hypothesis.ODOMETER, 1e-3, 3e-5, "inertial speed changes agree with the odometer"),
            belief(Hypothesis.SATELLITES, 1e-4, 2e-6, "all satellites agree"),
        )

    def _hypotheses(self, now_ns: int) -> Iterator[tuple[str, Message]]:
        """Positions under each hypothesis, once one is suspected."""
        if self.suspected_ns is None:
            return
        grown = min(1.0, (now_ns - self.suspected_ns) * 1e-9 / 5.0)
        fusion = tuple(
            self._without(now_ns, hypothesis, (hypothesis.value,), grown * apart_m)
            for hypothesis, apart_m in APART_M.items()
        )
        missing = ((Hypothesis.RECEIVER_TIME, "the delay is not estimated while the vehicle stands still"),)
        yield "core.fusion", TrustHypotheses(sampled_ns=now_ns, source="core.fusion", solutions=fusion, missing=missing)
        satellites = tuple(
            self._without(now_ns, Hypothesis.SATELLITES, (f"G{number:02d}",), 0.3 * number, separation=0.9 * number)
            for number in range(1, 18)
        )
        yield (
            "core.cooperative",
            TrustHypotheses(sampled_ns=now_ns, source="core.cooperative", solutions=satellites),
        )

    def _without(
        self, now_ns: int, hypothesis: Hypothesis, left_out: tuple[str, ...], apart_m: float, separation: float = 31.0
    ) -> HypothesisSolution:
        latitude, longitude = self._place(now_ns, 0.5 + apart_m, -0.4)
        return HypothesisSolution(
            hypothesis=hypothesis, left_out=left_out, since_ns=self.started_ns, latitude_deg=latitude,
            longitude_deg=longitude, height_ellipsoid_m=HEIGHT_M, velocity_ned_m_s=self._velocity(now_ns),
            position_cov_ned_m2=(1.0, 0.0, 0.0, 1.0, 0.0, 2.0), protection_level_horizontal_m=5.2,
            protection_level_vertical_m=7.7, apart_ned_m=(-apart_m, 0.0, 0.2), separation=separation,
            separation_limit=16.3, innovations=1.04,
        )  # fmt: skip

    def _satellites(self, now_ns: int) -> GnssSatellites:
        """24 in view, 17 of them used: the others are low, unhealthy, weak or excluded by their own receiver."""
        systems = (Constellation.GPS, Constellation.GALILEO, Constellation.GLONASS, Constellation.BEIDOU)
        satellites = tuple(
            Satellite(
                constellation=systems[n % 4],
                number=n + 1,
                cn0_db_hz=None if n == 23 else 30.0 + n % 15,
                elevation_rad=math.radians(4.0 if n == 17 else 12.0 + (n * 31 + 5 * (n // 4)) % 73),
                azimuth_rad=math.radians((n * 137) % 360),
                residual_m=0.1 * (n % 7) if n < 17 else None,
                used=n < 17,
                quality=SignalQuality.SEARCHING if n == 23 else SignalQuality.CARRIER_LOCKED,
                healthy=n != 18,
                orbit_known=n != 19,
            )
            for n in range(24)
        )
        return GnssSatellites(sampled_ns=now_ns - 80_000_000, received_ns=now_ns, source="gnss0", satellites=satellites)

    def _receiver(self, now_ns: int) -> Iterator[tuple[str, Message]]:
        """Measurements of two signals of GPS and Galileo, interference state and configuration of the receiver."""
        measurements = tuple(
            RawMeasurement(constellation=s.constellation, number=s.number, signal=signal, cn0_db_hz=s.cn0_db_hz - less)
            for s in self._satellites(now_ns).satellites
            for signal, less in (("1C", 0.0), ("5Q", 3.0))
            if s.cn0_db_hz is not None and s.constellation in (Constellation.GPS, Constellation.GALILEO)
        )
        yield (
            "parsers.gnss",
            GnssRawEpoch(
                sampled_ns=now_ns, received_ns=now_ns, source="gnss0", gps_time_ns=now_ns, measurements=measurements
            ),
        )
        signals = tuple(
            GnssSignal(
                constellation=measurement.constellation, number=measurement.number, signal=measurement.signal,
                cn0_db_hz=measurement.cn0_db_hz,
                quality=SignalQuality.CARRIER_LOCKED if used else SignalQuality.CODE_LOCKED, healthy=True,
                pseudorange_used=used, carrier_phase_used=used, doppler_used=used, corrected=False,
            )
            for measurement in measurements
            for used in (measurement.number <= 17 and measurement.signal == "1C",)
        )  # fmt: skip
        yield (
            "parsers.gnss",
            GnssSignals(sampled_ns=now_ns, received_ns=now_ns, source="gnss0", signals=signals),
        )
        quiet = InterferenceState.NONE
        yield (
            "parsers.gnss",
            GnssSignalQuality(
                status=ReceiverStatus(spoofing=quiet, time_to_first_fix_s=26.0),
                security=SignalFlags(jamming=quiet, spoofing=quiet),
                radio_paths=(RadioPath(number=0, jamming=quiet, gain_ratio=0.6, noise_level=90, narrowband_ratio=0.1),),
                clock=ReceiverClock(bias_s=4e-4, drift_ratio=3e-7, bias_sd_s=1e-8, drift_sd_ratio=2e-10),
                sampled_ns=now_ns,
                received_ns=now_ns,
                source="gnss0",
            ),
        )
        yield (
            "parsers.gnss",
            GnssConfiguration(
                request_id=1, source="gnss0", accepted=True, navigation_period_s=1.0,
                messages=("UBX NAV-PVT", "UBX NAV-SAT"),
                model="ZED-F9P", firmware="HPG 1.32", dynamic_model="automotive", elevation_mask_rad=math.radians(10),
            ),
        )  # fmt: skip
        yield "sensors.gnss", self.port.model_copy(update={"sampled_ns": now_ns})
        yield (
            "parsers.gnss",
            GnssReceiver(
                received_ns=now_ns, source="gnss0", messages=("NMEA GGA", "UBX NAV-PVT", "UBX NAV-SAT"),
                gives_position=True, received_bytes=900, other_bytes=0,
            ),
        )  # fmt: skip

    def _heartbeats(self, now_ns: int) -> Iterator[tuple[str, Message]]:
        elapsed_s = (now_ns - self.started_ns) * 1e-9
        for index, name in enumerate(SIMULATED):
            yield (
                name,
                ProcessHealth(
                    process=name,
                    state=ProcessState.READY,
                    incarnation=LIFE + self.bus.lives[name],
                    sent_ns=now_ns,
                    messages_in=int(elapsed_s * (110 + 20 * index)),
                    messages_out=int(elapsed_s * (20 + 11 * index)),
                    cpu_s=elapsed_s * (0.02 + 0.013 * index),
                    rss_bytes=(31 + 3 * index) * 1_000_000,
                    rejects={"checksum": 3} if name == "parsers.gnss" else {},
                    kinds=KINDS if name == "parsers.gnss" else (),
                    published=self.bus.carried(name),
                ),
            )

    def _trust(self, now_ns: int) -> Iterator[tuple[str, Message]]:
        """Publish statements of every monitor; while the filter rejects GNSS velocity, the inertial monitor accuses."""
        if not self.silent & {"core.motion_conflict", "core.trust"}:
            for statement in self._statements(now_ns):
                yield STATED_BY.get(statement.monitor, "core.motion_conflict"), statement
        self._judge(Tick(now_ns=now_ns))

    def _statements(self, now_ns: int) -> Iterator[TrustMonitor]:
        passes, unknown = Outcome.PASS, Outcome.NOT_EVALUATED
        warming = "warming up: 12 of 30 samples with both speeds"
        tests = (
            MonitorTest(name="trimmed_mean", outcome=unknown, reason=warming, threshold=10.0, unit="km/h",
                        window_s=300.0),
            MonitorTest(name="held_speed", outcome=passes, reason="the speed varies", statistic=0.0, threshold=4.0,
                        unit="s", since_ns=self.started_ns),
        )  # fmt: skip
        yield TrustMonitor(
            sampled_ns=now_ns, monitor="motion", outcome=unknown, reason=warming, since_ns=self.started_ns, tests=tests
        )
        spoofed = self.rejecting
        for name, statistic, threshold, window_s in (
            ("motion_fast", 3.1, 16.3, 5.0), ("inertial_short", 4.4 if not spoofed else 23.9, 11.3, 5.0),
            ("inertial_long", 5.2, 16.3, 30.0), ("satellites", 7.9, 24.3, 1.0), ("evidence", 0.0, 1.0, 1.0),
        ):  # fmt: skip
            accuses = statistic > threshold
            reason = (
                "GNSS acceleration differs from the inertial unit's" if accuses else "statistic below the threshold"
            )
            shown = {"satellites": SATELLITE_TESTS, "evidence": EVIDENCE_TESTS}.get(name, ())
            yield TrustMonitor(
                sampled_ns=now_ns, monitor=name, outcome=Outcome.ACCUSES if accuses else passes,
                reason=reason, accused=("gnss",) if accuses else (),
                suspect_since_ns=self.started_ns - 6 * 10**9 if accuses else None,
                since_ns=self.started_ns, statistic=statistic + 0.3 * math.sin(now_ns * 1e-9), threshold=threshold,
                false_alarm_rate=1e-5, window_s=window_s, tests=shown,
            )  # fmt: skip

    def _origin(self, now_ns: int) -> Iterator[tuple[str, Message]]:
        yield "sensors.simulator", Origin(now_ns=now_ns, kind=OriginKind.SIMULATED, name="city-loop", seed=7)
