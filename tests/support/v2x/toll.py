"""Vehicles on the lanes of the example plaza, and the CAM that they send."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import atan2, pi
from pathlib import Path

import numpy as np

from services.core.toll.core import Core
from services.core.toll.settings import Settings
from shared.messages.gnss import FixType, GnssFix
from shared.messages.toll import GateCommand, OpenPassages, TollDelta, TollPassage, TollRegistration
from shared.messages.v2x import Cam, StationType
from shared.toll.plaza import Lane, Plaza, along, parse_plaza

SECOND_NS = 10**9
START_NS = 1_000 * SECOND_NS
FAR_NS = 10**18


def example_plaza() -> Plaza:
    """The plaza of deploy/plazas."""
    path = Path(__file__).parents[3] / "deploy/plazas/example.geojson"
    return parse_plaza(path.read_bytes(), str(path))


def lane_of(plaza: Plaza, name: str) -> Lane:
    return next(lane for lane in plaza.lanes if lane.name == name)


def place(lane: Lane, distance: float, left: float = 0.0) -> tuple[float, float, float]:
    """North, east [m] and heading [rad, clockwise from north] at a distance behind the gate line of a lane."""
    gate = along(lane.centre, lane.gate)
    assert gate is not None
    steps = np.diff(lane.centre, axis=0)
    lengths = np.hypot(*steps.T)
    begins = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    k = max(int(np.searchsorted(begins, gate + distance)) - 1, 0)
    a, unit, remaining = lane.centre[k], steps[k] / lengths[k], gate + distance - begins[k]
    north, east = a + remaining * unit + left * np.array([unit[1], -unit[0]])
    return float(north), float(east), atan2(unit[1], unit[0]) % (2.0 * pi)


@dataclass(frozen=True)
class Vehicle:
    """A vehicle that drives from a place on its lane, and stops when its speed is zero."""

    station_id: int
    lane: str
    speed: float = 20.0
    start: float = -250.0  # [m] behind the gate line at the time `since`
    acceleration: float = 0.0
    since: float = 0.0  # [s]
    backward: bool = False  # drives towards smaller distances
    error: tuple[float, float] = (0.0, 0.0)  # [m] of its receiver, north and east
    stated_sd: float | None = 3.06
    clock_error_s: float = 0.0
    left: float = 0.0
    extra: Mapping[str, object] = field(default_factory=dict)

    def moving_s(self, t: float) -> float:
        """Time [s] that it has been moving; it stops when its speed is zero."""
        stop = -self.speed / self.acceleration if self.acceleration < 0.0 else np.inf
        return float(min(t - self.since, stop))

    def distance(self, t: float) -> float:
        s = self.moving_s(t)
        way = self.speed * s + 0.5 * self.acceleration * s**2
        return self.start + (-way if self.backward else way)

    def cam(self, plaza: Plaza, t: float, *, latency_s: float = 0.02) -> Cam:
        """The CAM that it sends at a time [s]."""
        north, east, heading = place(lane_of(plaza, self.lane), self.distance(t), self.left)
        position = plaza.position(north + self.error[0], east + self.error[1])
        time_ns = START_NS + round(t * 1e9)
        stamp = time_ns + round(self.clock_error_s * 1e9)
        values: dict[str, object] = {
            "station_id": self.station_id,
            "station_type": StationType.PASSENGER_CAR,
            "latitude_deg": round(position.latitude_deg, 7),
            "longitude_deg": round(position.longitude_deg, 7),
            "position_semi_major_m": None if self.stated_sd is None else 2.45 * self.stated_sd,
            "heading_rad": (heading + pi) % (2.0 * pi) if self.backward else heading,
            "speed_m_s": max(self.speed + self.acceleration * self.moving_s(t), 0.0),
            "yaw_rate_rad_s": 0.0,
            "sampled_ns": stamp,
            "received_ns": time_ns + round(latency_s * 1e9),
            "generation_delta_time": stamp // 10**6 % 65536,
            "frame": f"{self.station_id} {stamp}".encode(),
        }
        return Cam.model_validate({**values, **self.extra})

    def named(self, station_id: int) -> "Vehicle":
        return replace(self, station_id=station_id)


def registration(station_id: int) -> TollRegistration:
    return TollRegistration(
        sampled_ns=START_NS, contract="contract", tariff_class="car", station_id=station_id, valid_until_ns=FAR_NS
    )


def nothing_open(now_ns: int = START_NS - SECOND_NS) -> OpenPassages:
    return OpenPassages(sampled_ns=now_ns, passages=(), settled=())


def fix(plaza: Plaza, t: float, north: float, east: float, **values: object) -> GnssFix:
    """A fix of the unit's receiver that errs by so many metres."""
    position = plaza.position(north, east)
    stamp = START_NS + round(t * 1e9)
    fields: dict[str, object] = {
        "sampled_ns": stamp,
        "received_ns": stamp + 10**7,
        "source": "gnss0",
        "fix_type": FixType.THREE_D,
        "latitude_deg": position.latitude_deg,
        "longitude_deg": position.longitude_deg,
    }
    return GnssFix.model_validate(fields | values)


class Plant:
    """A core with traffic: every vehicle sends ten CAM a second from `at` on, the unit's receiver errs by `error`."""

    def __init__(self, error: tuple[float, float] | None = None, settings: Settings | None = None) -> None:
        self.plaza, self.settings = example_plaza(), settings or Settings()
        self.error = error
        self.statements: list[TollPassage | GateCommand] = []
        self.clock_s = -30.0
        self.registered: list[int] = []
        self.fixes: list[GnssFix] = []
        self.deltas: list[TollDelta] = []
        self.core = self.new_core()
        while self.clock_s < 0.0:
            self.second()

    def new_core(self) -> Core:
        """Start the process anew, with the ledger's answer that nothing is open."""
        core = Core(self.plaza, self.settings)
        list(core.continue_passages(nothing_open()))
        for station_id in self.registered:
            core.register(registration(station_id))
        return core

    def restart(self, *, answered: bool = True) -> None:
        """Restart the process; it receives the fixes and deltas again, and `answered` by the ledger."""
        self.core = self.new_core() if answered else Core(self.plaza, self.settings)
        for fix in self.fixes:
            self.core.fix(fix)
        for delta in self.deltas:
            self.core.use_delta(delta)

    def register(self, *station_ids: int) -> None:
        self.registered += station_ids
        for station_id in station_ids:
            self.core.register(registration(station_id))

    def second(self) -> None:
        """A tick with a fix of the unit's receiver."""
        if self.error:
            self.fixes.append(fix(self.plaza, self.clock_s, *self.error))
            self.core.fix(self.fixes[-1])
        now_ns = START_NS + round(self.clock_s * 1e9)
        self.deltas.append(self.core.estimate_delta(now_ns))
        self.core.use_delta(self.deltas[-1])
        self.statements += self.core.tick(now_ns)
        self.clock_s += 1.0

    def drive(self, *vehicles: Vehicle, until: float, since: float = 0.0) -> None:
        """Let vehicles drive from one time [s] to another."""
        for k in range(round(since * 10), round(until * 10)):
            t = k / 10.0
            if t >= self.clock_s:
                self.second()
            self.statements += self.core.use([vehicle.cam(self.plaza, t) for vehicle in vehicles])

    @property
    def passages(self) -> list[TollPassage]:
        """Changes of state."""
        return [
            statement
            for statement in self.statements
            if isinstance(statement, TollPassage) and not statement.checkpoint
        ]

    @property
    def states(self) -> list[str]:
        return [passage.state.value for passage in self.passages]

    @property
    def gates(self) -> list[GateCommand]:
        return [statement for statement in self.statements if isinstance(statement, GateCommand)]
