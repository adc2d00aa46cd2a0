"""The simulated plaza: vehicles, radio channel, detectors, the unit's own receiver; one stream in order of time."""

import heapq
from collections import defaultdict, deque
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import count
from typing import Final

import numpy as np
from pydantic import Field
from pyubx2.ubxmessage import UBXMessage

from shared.messages.base import Message
from shared.messages.gnss import GnssRaw
from shared.messages.operation import Origin, OriginKind
from shared.messages.toll import (
    GateMode,
    LaneTraffic,
    PlazaDetector,
    PlazaTruth,
    TollPayment,
    TollRegistration,
    TrafficPassage,
    TrafficVehicle,
)
from shared.messages.v2x import CamContent
from shared.runtime.config import Section
from shared.toll.plaza import Lane, Plaza

from .detectors import Detector, Detectors
from .errors import ErrorModel, GaussMarkov
from .motion import TURN_SPEED, acceleration, gate_distance, lane_path, turning_path
from .station import Station
from .vehicle import REGISTRATION_NS, SIZES_M, Vehicle, content_of, packet_of

NS = 1_000_000_000
STEP_NS = NS // 10
STEP_S = 0.1
TURN_BEFORE_GATE = 45.0  # [m]
ENTRY_GAP = 30.0  # [m] behind the last vehicle of the lane
EARLIER_PULSES = 20
DETECTOR_PERIOD_NS = 5 * NS
SOURCE = "traffic"
GNSS_LATENCY_NS = 60_000_000
FROM_RECEIVER: Final = 0  # pyubx2's GET


class Channel(Section):
    """What the radio channel does to frames."""

    loss: float = Field(default=0.05, ge=0.0, le=1.0, description="share of frames that do not arrive")
    duplicates: float = Field(default=0.02, ge=0.0, le=1.0, description="share of frames that arrive twice")
    latency_s: float = Field(default=0.03, ge=0.0, le=10.0, description="mean delay of frames")
    reordered: float = Field(default=0.02, ge=0.0, le=1.0, description="share of frames with an additional delay")
    reorder_s: float = Field(default=1.0, ge=0.0, le=10.0, description="largest additional delay of such a frame")


class TrafficMix(Section):
    """Share of vehicles that are not as they should be."""

    unequipped: float = Field(default=0.1, ge=0.0, le=1.0, description="share of vehicles that send no CAM")
    unregistered: float = Field(
        default=0.1, ge=0.0, le=1.0, description="share of equipped vehicles without a contract"
    )
    silent: float = Field(default=0.03, ge=0.0, le=1.0, description="share of vehicles that send no CAM for 2 to 6 s")
    new_station_id: float = Field(
        default=0.1, ge=0.0, le=1.0, description="share of vehicles that change their station ID on the approach"
    )
    corrected: float = Field(
        default=0.1,
        ge=0.0,
        le=1.0,
        description="share of vehicles that use corrections and so have none of the common error",
    )
    turning: float = Field(
        default=0.02, ge=0.0, le=1.0, description="share of vehicles that turn around before the gate"
    )


class Traffic(Section):
    """The simulated traffic."""

    vehicles: int = Field(default=50, ge=1, le=200, description="number of vehicles at a time")
    speed_m_s: tuple[float, float] = Field(
        default=(14.0, 22.0), description="desired speeds, distributed uniformly between the two"
    )
    signed: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="share of equipped vehicles that sign their CAM, with tickets of the simulation's own test root",
    )
    errors: ErrorModel = ErrorModel()
    channel: Channel = Channel()
    mix: TrafficMix = TrafficMix()
    detectors: Detectors = Detectors()


@dataclass(frozen=True)
class Frame:
    """A frame that arrives at the unit's antenna."""

    data: bytes


class World:
    """Simulates without end. Iterating yields (time of arrival [ns], frame or message) in order of time."""

    def __init__(self, plaza: Plaza, traffic: Traffic, seed: int, start_ns: int) -> None:
        self.plaza, self._traffic, self._seed, self._start_ns = plaza, traffic, seed, start_ns
        self._rng = np.random.default_rng(seed)
        self._signing = np.random.default_rng((seed, 2))  # of its own: who signs changes nothing else
        self._detector = Detector(traffic.detectors, np.random.default_rng((seed, 3)))
        model = traffic.errors
        self._common = GaussMarkov(model.common_sd_m, model.common_s, STEP_S, self._rng)
        self._unit = GaussMarkov(model.unit_sd_m, model.unit_s, STEP_S, self._rng)
        self.queues: dict[str, list[Vehicle]] = {lane.name: [] for lane in plaza.lanes}
        self._numbers, self._order = count(), count()
        self._heap: list[tuple[int, int, Frame | Message]] = []
        self._pulses: dict[str, deque[int]] = defaultdict(lambda: deque(maxlen=EARLIER_PULSES + 1))
        self._pulse_numbers: dict[str, int] = defaultdict(int)
        self._passages: list[TrafficPassage] = []
        self.frames = self.turned = 0
        self.entry_open = True  # False: who leaves is not replaced
        self._fill()

    def __iter__(self) -> Iterator[tuple[int, Frame | Message]]:
        """Yield without end."""
        for step in count():
            begin_ns = self._start_ns + step * STEP_NS
            self._publish(step, begin_ns)
            self._advance(begin_ns)
            while self._heap and self._heap[0][0] < begin_ns + STEP_NS:
                due_ns, _, item = heapq.heappop(self._heap)
                yield due_ns, item

    @property
    def vehicles(self) -> list[Vehicle]:
        """Every vehicle that is on the road now."""
        return [vehicle for lane in self.queues.values() for vehicle in lane]

    # Vehicles

    def _fill(self) -> None:
        """Place the first vehicles between the begin of their lanes and the approach line."""
        spacing = 2.0 * ENTRY_GAP
        for place in range(4):
            for lane in self.plaza.lanes:
                if len(self.vehicles) < self._traffic.vehicles:
                    self._enter(lane, 250.0 - spacing * place)

    def _enter(self, lane: Lane, distance: float = 0.0) -> None:
        rng, mix, number = self._rng, self._traffic.mix, next(self._numbers)
        chance = dict(zip(type(mix).model_fields, rng.random(6), strict=True))
        equipped = bool(chance["unequipped"] >= mix.unequipped)
        registered = bool(equipped and chance["unregistered"] >= mix.unregistered)
        turning = bool(chance["turning"] < mix.turning)
        change, silence = rng.uniform(100.0, 480.0), rng.uniform(100.0, 480.0)
        speed = float(rng.uniform(*self._traffic.speed_m_s))
        tariff_class = str(rng.choice(sorted(SIZES_M.keys() & self.plaza.tariff.classes.keys())))
        gate = gate_distance(lane)
        model = self._traffic.errors
        vehicle = Vehicle(
            number=number,
            lane=lane,
            path=turning_path(lane, TURN_BEFORE_GATE) if turning else lane_path(lane),
            gate=gate,
            offset=float(rng.uniform(-0.3, 0.3)),
            wanted_speed=speed,
            tariff_class=tariff_class,
            equipped=equipped,
            registered=registered,
            corrected=bool(chance["corrected"] < mix.corrected),
            multipath=GaussMarkov(model.multipath_sd_m, model.multipath_s, STEP_S, rng),
            station_id=int(rng.integers(1, 1 << 32)),
            phase_ns=int(rng.integers(0, STEP_NS)),
            contract=f"contract-{self._seed}-{number}" if registered else None,
            change_at=change if chance["new_station_id"] < mix.new_station_id else None,
            silent=(silence, silence + rng.uniform(2.0, 6.0) * speed) if chance["silent"] < mix.silent else None,
            dwell_s=float(rng.uniform(2.0, 4.0)) if lane.mode is GateMode.STOP_AND_GO and not turning else 0.0,
            distance=distance,
            speed=speed,
            signs=bool(self._signing.random() < self._traffic.signed and equipped),
        )  # fmt: skip
        self.queues[lane.name].append(vehicle)

    def _advance(self, begin_ns: int) -> None:
        """Move everything by one step and push what arrives because of it."""
        self._common.step()
        self._unit.step()
        for lane in self.plaza.lanes:
            queue = self.queues[lane.name]
            leader: Vehicle | None = None
            for vehicle in queue:
                self._send(vehicle, begin_ns)
                self._drive(vehicle, leader, begin_ns)
                if vehicle.path.turn is None or vehicle.distance < vehicle.path.turn[0]:
                    leader = vehicle
            queue[:] = [vehicle for vehicle in queue if vehicle.distance < vehicle.path.length - 1.0]
        for number, pulse_ns in self._detector.of_nothing(begin_ns, STEP_S, len(self.plaza.lanes)):
            self._detect(self.plaza.lanes[number].name, pulse_ns)
        self._replace()

    def _replace(self) -> None:
        """Add a vehicle for each one that has left, where there is room."""
        if not self.entry_open:
            return
        free = [
            lane for lane in self.plaza.lanes
            if not (queue := self.queues[lane.name]) or queue[-1].distance > ENTRY_GAP + queue[-1].length
        ]  # fmt: skip
        missing = self._traffic.vehicles - len(self.vehicles)
        for k in self._rng.permutation(len(free))[:missing]:
            self._enter(free[k])

    def _drive(self, vehicle: Vehicle, leader: Vehicle | None, begin_ns: int) -> None:
        vehicle.multipath.step()
        obstacles = [(leader.distance - leader.length - vehicle.distance, leader.speed)] if leader else []
        if vehicle.dwell_s > 0.0:  # its front stops 1.5 m before the gate line, with the gap of the model in front
            obstacles.append((vehicle.gate + 1.0 - vehicle.distance, 0.0))
            if vehicle.speed < 0.3 and vehicle.gate - vehicle.distance < 4.0:
                vehicle.dwell_s -= STEP_S
        wanted = vehicle.wanted_speed
        if vehicle.path.turn is not None and vehicle.distance > vehicle.path.turn[0] - 40.0:
            wanted = TURN_SPEED
        wishes = [acceleration(vehicle.speed, wanted, gap, vehicle.speed - other) for gap, other in obstacles]
        vehicle.acceleration = min([acceleration(vehicle.speed, wanted, None, 0.0), *wishes])
        vehicle.acceleration = max(vehicle.acceleration, -vehicle.speed / STEP_S)
        before, moved = vehicle.distance, vehicle.speed * STEP_S + 0.5 * vehicle.acceleration * STEP_S**2
        vehicle.distance += max(moved, 0.0)
        vehicle.speed = max(vehicle.speed + vehicle.acceleration * STEP_S, 0.0)
        if vehicle.path.turn is None and before < vehicle.gate <= vehicle.distance:
            self._cross(vehicle, begin_ns + round((vehicle.gate - before) / max(moved, 1e-9) * STEP_NS))
        if vehicle.path.turn is not None and not vehicle.turned and vehicle.distance >= vehicle.path.turn[1]:
            vehicle.turned = True
            self.turned += 1
        if vehicle.change_at is not None and vehicle.distance >= vehicle.change_at:
            vehicle.change_at, vehicle.registered_ns = None, None
            vehicle.station_id, vehicle.station = int(self._rng.integers(1, 1 << 32)), None

    def _cross(self, vehicle: Vehicle, crossing_ns: int) -> None:
        vehicle.crossed = True
        lane = vehicle.lane.name
        self._passages.append(
            TrafficPassage(vehicle=vehicle.number, lane=lane, crossing_ns=crossing_ns, equipped=vehicle.equipped,
                           registered=vehicle.registered, contract=vehicle.contract)
        )  # fmt: skip
        if vehicle.lane.traffic is LaneTraffic.MIXED and not vehicle.registered:
            self._push(
                crossing_ns + 3 * NS,
                TollPayment(sampled_ns=crossing_ns, plaza=self.plaza.name, lane=lane,
                            payment=f"payment-{self._seed}-{vehicle.number}"),
            )  # fmt: skip
        for pulse_ns in self._detector.of_vehicle(crossing_ns):
            self._detect(lane, pulse_ns)

    def _detect(self, lane: str, pulse_ns: int) -> None:
        """Push the pulses of a lane with a new one."""
        self._pulses[lane].appendleft(pulse_ns)
        self._pulse_numbers[lane] += 1
        self._push(pulse_ns + STEP_NS, self._pulse(lane))

    # Arrivals at the unit

    def _send(self, vehicle: Vehicle, begin_ns: int) -> None:
        if not vehicle.equipped:
            return
        if vehicle.signs and vehicle.station is None:
            vehicle.station = Station.make(self._signing.bytes(16), begin_ns)
        if vehicle.registered and (vehicle.registered_ns or -REGISTRATION_NS) + REGISTRATION_NS <= begin_ns:
            vehicle.registered_ns = begin_ns
            self._push(begin_ns + STEP_NS, self._registration(vehicle, begin_ns))
        if vehicle.silent and vehicle.silent[0] <= vehicle.distance < vehicle.silent[1]:
            return
        sent_ns = begin_ns + vehicle.phase_ns
        content = content_of(vehicle, self.plaza, self._common, self._traffic.errors, sent_ns, vehicle.phase_ns * 1e-9,
                             self._rng)  # fmt: skip
        if content is None:
            return
        self.frames += 1
        sent = self.sent(vehicle, content, sent_ns)
        for arrival_ns in self._arrivals(sent_ns):
            self._push(arrival_ns, sent)

    def sent(self, vehicle: Vehicle, content: CamContent, sent_ns: int) -> Frame:
        """Make the frame that a vehicle sends."""
        packet = packet_of(content, sent_ns)
        return Frame(vehicle.station.sign(packet, sent_ns) if vehicle.station else packet)

    def _registration(self, vehicle: Vehicle, now_ns: int) -> TollRegistration:
        """Statement of the vehicle's application: of its ticket, or of its station ID where it signs nothing."""
        stated = TollRegistration(
            sampled_ns=now_ns, contract=vehicle.contract or "", station_id=vehicle.station_id, plaza=self.plaza.name,
            tariff_class=vehicle.tariff_class, valid_until_ns=now_ns + 120 * NS,
        )  # fmt: skip
        return vehicle.station.register(stated) if vehicle.station else stated

    def _arrivals(self, sent_ns: int) -> list[int]:
        """Times at which a frame arrives: none if it is lost, two if it is repeated."""
        channel = self._traffic.channel
        lost, twice, late, extra = self._rng.random(4)
        if lost < channel.loss:
            return []
        delays = self._rng.exponential(channel.latency_s, 2)
        if late < channel.reordered:
            delays[0] += extra * channel.reorder_s
        return [sent_ns + round(delay * NS) for delay in delays[: 2 if twice < channel.duplicates else 1]]

    def _publish(self, step: int, now_ns: int) -> None:
        """Push what comes with time: fix, origin, truth, and the detectors' repetitions."""
        if step % 10 == 0:
            self._push(now_ns + GNSS_LATENCY_NS, self._fix(now_ns))
        if step % 20 == 0:
            self._push(now_ns, Origin(now_ns=now_ns, kind=OriginKind.SIMULATED, name=self.plaza.name, seed=self._seed))
        if step % 5 == 0:
            self._push(now_ns, self._truth(now_ns))
        if step % (DETECTOR_PERIOD_NS // STEP_NS) == 0:
            for lane in self._pulses:
                self._push(now_ns, self._pulse(lane))

    def _pulse(self, lane: str) -> PlazaDetector:
        newest, *earlier = self._pulses[lane]
        return PlazaDetector(
            sampled_ns=newest, plaza=self.plaza.name, lane=lane, since_ns=self._start_ns,
            pulse=self._pulse_numbers[lane] - 1, earlier_ns=tuple(earlier),
        )  # fmt: skip

    def _truth(self, now_ns: int) -> PlazaTruth:
        passages, self._passages = tuple(self._passages), []
        return PlazaTruth(
            sampled_ns=now_ns, vehicles=tuple(self._true_vehicle(v) for v in self.vehicles), passages=passages,
            frames=self.frames, turned=self.turned,
        )  # fmt: skip

    def _true_vehicle(self, vehicle: Vehicle) -> TrafficVehicle:
        pose = vehicle.pose()
        place = self.plaza.position(pose.north, pose.east)
        return TrafficVehicle(
            vehicle=vehicle.number, latitude_deg=place.latitude_deg, longitude_deg=place.longitude_deg,
            heading_rad=pose.heading, speed_m_s=vehicle.speed, lane=vehicle.lane.name, equipped=vehicle.equipped,
            registered=vehicle.registered, station_id=vehicle.station_id if vehicle.equipped else None,
        )  # fmt: skip

    def _fix(self, now_ns: int) -> GnssRaw:
        """NAV-PVT and NAV-EOE of the unit's own receiver, with the common error and its own."""
        error = self._common.value + self._unit.value
        place = self.plaza.position(*error.tolist())
        utc = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=now_ns // 1000)
        itow_ms = (now_ns // 1_000_000 - 315_964_800_000 + 18_000) % 604_800_000
        height_mm = round(self.plaza.antenna.height * 1000.0)
        model = self._traffic.errors
        accuracy_mm = round(1000.0 * float(np.hypot(model.common_sd_m, model.unit_sd_m)) * np.sqrt(2.0))
        pvt = UBXMessage(
            "NAV", "NAV-PVT", FROM_RECEIVER, iTOW=itow_ms, year=utc.year, month=utc.month, day=utc.day, hour=utc.hour,
            min=utc.minute, second=utc.second, validDate=1, validTime=1, fullyResolved=1, tAcc=25,
            nano=utc.microsecond * 1000, fixType=3, gnssFixOk=1, confirmedAvai=1, confirmedDate=1, confirmedTime=1,
            numSV=18, lon=place.longitude_deg, lat=place.latitude_deg, height=height_mm, hMSL=height_mm - 44_000,
            hAcc=accuracy_mm, vAcc=2 * accuracy_mm, sAcc=100, headAcc=180.0, pDOP=1.5,
        )  # fmt: skip
        eoe = UBXMessage("NAV", "NAV-EOE", FROM_RECEIVER, iTOW=itow_ms)
        received_ns = now_ns + GNSS_LATENCY_NS
        return GnssRaw(received_ns=received_ns, source=SOURCE, data=pvt.serialize() + eoe.serialize())

    def _push(self, due_ns: int, item: Frame | Message) -> None:
        heapq.heappush(self._heap, (due_ns, next(self._order), item))
