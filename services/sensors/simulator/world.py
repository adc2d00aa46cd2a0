"""The simulated vehicle with all its devices: one stream of messages in the order of arrival."""

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import count, takewhile

import numpy as np

from shared.attacks import ScheduledAttack
from shared.maths.earth import Geodetic
from shared.messages.base import Message
from shared.messages.navigation import TruthState
from shared.messages.operation import HostClock, Origin, OriginKind
from shared.messages.simulation import SimulationAttack, SimulationState

from .attacks.attacks import Attacks
from .can.can_bus import CanBus
from .gnss.simulated_receiver import Receiver
from .imu.simulated_xsens import Tracker
from .motion.trajectory import Motion
from .scenarios import Scenario, scenario_of
from .v2x.radio import Radio
from .vehicle import Readings, Stream, Vehicle, antenna_at

NS = 1_000_000_000
STEP_NS = 10_000_000
BLOCK = 100  # [steps] simulated at once
TRUTH_EVERY = 10  # steps
ORIGIN_NS = 2 * NS
CLOCK_NS = 10 * NS
CLOCK_ERROR_S = 0.02  # of a host that NTP holds over a mobile network
DEFAULT_START_NS = 1_790_000_000 * NS  # 2026-09-21T14:13:20Z


@dataclass(frozen=True)
class Equipment:
    """Equipment of the simulated vehicle."""

    protocols: tuple[str, ...] = ("ubx", "nmea")
    mounting_rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the IMU, in addition to `FLAT`
    second_antenna_m: float = 0.0  # distance ahead of the first; 0: single antenna
    neighbours: int = 4  # vehicles with V2X radios around it


class Schedule(Enum):
    """What is computed when its time has come."""

    EPOCH = "a navigation epoch of the receiver"
    ATTACKS = "the state of the attacks"


class World:
    """Simulates without end, one second at a time, in bounded memory.

    Iterating yields (arrival time, message); `write` and `command` may be called between two messages.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        start_ns: int,
        equipment: Equipment | None = None,
        attacks: Sequence[ScheduledAttack] = (),
    ) -> None:
        equipment = equipment or Equipment()
        clocks = np.random.default_rng((seed, Stream.CLOCKS))
        self._scenario, self._seed, self._start_ns = scenario, seed, start_ns
        self._tracker = Tracker(seed, start_ns, clocks, equipment.mounting_rpy_deg)
        self.step_ns = self._tracker.clock.period_ns(STEP_NS)
        self._vehicle = Vehicle(scenario, seed, self.step_ns * 1e-9)
        self._receiver = Receiver(scenario, seed, start_ns, clocks, equipment.protocols, equipment.second_antenna_m)
        self._attacks = Attacks(scenario, seed, start_ns, attacks)
        self._can = CanBus(seed, start_ns, clocks, self._attacks.odometer)
        self.radio = Radio(scenario, seed, equipment.neighbours)
        self._heap: list[tuple[int, int, Message | Schedule]] = []
        self._order = count()
        self._motion: Motion | None = None
        self._driven_ns = self._origin_ns = self._clock_ns = start_ns

    def __iter__(self) -> Iterator[tuple[int, Message]]:
        """Yield (arrival time, message) without end."""
        for change_ns in self._attacks.changes_ns():
            self._push(change_ns, Schedule.ATTACKS)
        self._push(self._receiver.next_epoch_ns, Schedule.EPOCH)
        while True:
            while not self._heap or self._heap[0][0] > self._driven_ns:
                self._drive()
            due_ns, _, message = heapq.heappop(self._heap)
            if message is Schedule.ATTACKS:
                yield due_ns, self._attacks.state(due_ns)
                continue
            if isinstance(message, Message):
                yield due_ns, message
                continue
            motion = self._motion
            if motion is not None:
                antenna = antenna_at(motion, (due_ns - self._start_ns) / self.step_ns)
                self._push_all(self._receiver.navigate(self._attacks.signals(antenna, due_ns)))
            self._push(self._receiver.next_epoch_ns, Schedule.EPOCH)

    def write(self, data: bytes, now_ns: int) -> None:
        """Write bytes to the GNSS receiver."""
        self._push_all(self._receiver.write(data, now_ns))

    def command(self, message: SimulationAttack) -> None:
        """Start or stop an attack from the next second that is not yet simulated; the answer comes then."""
        known = set(self._attacks.changes_ns())
        self._attacks.command(message, self._driven_ns)
        for change_ns in {self._driven_ns, *self._attacks.changes_ns()} - known:
            self._push(change_ns, Schedule.ATTACKS)

    def attack_state(self, now_ns: int) -> SimulationState:
        """The attacks of the drive as they are at a time."""
        return self._attacks.state(now_ns)

    def _drive(self) -> None:
        readings = self._vehicle.advance(BLOCK)
        self._motion = readings.motion
        begin_ns, end_ns = (self._start_ns + (readings.motion.first + n) * self.step_ns for n in (0, BLOCK))
        sampled_ns = self._start_ns + (readings.motion.first + np.arange(1, BLOCK + 1)) * self.step_ns
        self._push_all(self._tracker.sample(self._attacks.inertial(readings, sampled_ns), self.step_ns))
        self._push_all(self._can.transmit(readings.motion, begin_ns, end_ns))
        self._push_all(self._truth(readings))
        self.radio.deception = self._attacks.deception(end_ns)
        self._push_all(self._neighbours(readings.motion, end_ns))
        while self._origin_ns < end_ns:
            origin = Origin(
                now_ns=self._origin_ns, kind=OriginKind.SIMULATED, name=self._scenario.name, seed=self._seed
            )
            self._push(self._origin_ns, origin)
            self._origin_ns += ORIGIN_NS
        while self._clock_ns < end_ns:
            clock = HostClock(
                sampled_ns=self._clock_ns, utc_ns=self._clock_ns, synchronised=True, maximum_error_s=CLOCK_ERROR_S
            )
            self._push(self._clock_ns, clock)
            self._clock_ns += CLOCK_NS
        self._driven_ns = end_ns

    def _truth(self, readings: Readings) -> Iterator[tuple[int, Message]]:
        motion = readings.motion
        for i in range(TRUTH_EVERY, BLOCK + 1, TRUTH_EVERY):
            sampled_ns = self._start_ns + (motion.first + i) * self.step_ns
            latitude, longitude, height = motion.position[i].tolist()
            roll, pitch, yaw = motion.attitude[i].tolist()
            yield (
                sampled_ns,
                TruthState(
                    sampled_ns=sampled_ns,
                    latitude_deg=float(np.degrees(latitude)),
                    longitude_deg=float(np.degrees(longitude)),
                    height_ellipsoid_m=height,
                    velocity_ned_m_s=tuple(motion.velocity_n[i].tolist()),
                    roll_rad=roll,
                    pitch_rad=pitch,
                    yaw_rad=yaw,
                    angular_rate_body_rad_s=tuple(motion.rate_b[i - 1].tolist()),
                ),
            )

    def _neighbours(self, motion: Motion, sampled_ns: int) -> Iterator[tuple[int, Message]]:
        node = motion.first + BLOCK
        here = Geodetic(*motion.position[BLOCK].tolist())
        states = self.radio.receive(node * self.step_ns * 1e-9, sampled_ns, here, antenna_at(motion, node))
        yield states.received_ns, states

    def _push_all(self, arrivals: Iterator[tuple[int, Message]]) -> None:
        for due_ns, message in arrivals:
            self._push(due_ns, message)

    def _push(self, due_ns: int, message: Message | Schedule) -> None:
        heapq.heappush(self._heap, (due_ns, next(self._order), message))


def messages(
    scenario: str,
    seed: int = 0,
    duration_s: float | None = None,
    start_ns: int = DEFAULT_START_NS,
    *,
    attacks: Sequence[ScheduledAttack] = (),
) -> Iterator[Message]:
    """Yield the messages of the simulated devices in the order of arrival, as fast as they are consumed.

    Parameters
    ----------
    scenario : str
        Name of a scenario.
    seed : int
        The same seed gives the same bytes.
    duration_s : float, optional
        [s] Duration; by default that of the scenario.
    start_ns : int
        [ns] Time at which the drive starts.
    attacks : sequence of ScheduledAttack
        Attacks on the vehicle; `shared.attacks.schedule` reads them from text.

    Yields
    ------
    Message
        Raw bytes with their arrival times, truth and origin; the state of the attacks when one begins or ends.
    """
    row = scenario_of(scenario, seed)
    end_ns = start_ns + round((duration_s or row.duration_s) * NS)
    for _, message in takewhile(lambda arrival: arrival[0] <= end_ns, World(row, seed, start_ns, None, attacks)):
        yield message
