"""The processes of a road-side unit, from the frames on the radio to the bookings, on simulated time."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from services.core.toll.process import Config as TollConfig
from services.core.toll.process import In
from services.core.toll.process import Process as Toll
from services.monitoring.ledger.ledger import Ledger, Settings
from services.monitoring.ledger.store import Store
from services.parsers.v2x.process import Config as V2xConfig
from services.parsers.v2x.process import Process as V2xParser
from shared.messages.base import Tick
from shared.messages.toll import (
    LedgerState,
    PassageState,
    PlazaDetector,
    TollAlarm,
    TollPassage,
    TollRegistration,
    TollReview,
)
from shared.messages.v2x import Cam, CamContent, CamFrames, CamList, Encapsulation
from shared.toll.plaza import parse_plaza
from shared.v2x import frames, its_time
from tests.support.v2x import cams
from tests.support.v2x.tickets import Ticket
from tests.support.v2x.toll import SECOND_NS, START_NS, Vehicle, example_plaza, fix
from tests.support.v2x.tolling import WITH_DETECTORS, WITHOUT_DETECTORS

COMMON = (2.5, -1.5)  # [m, north and east] error that all receivers have in common
PLAZA = example_plaza()
LATENCY_S = 0.02


def stamp(t: float) -> int:
    return START_NS + round(t * SECOND_NS)


def packet(vehicle: Vehicle, t: float) -> bytes:
    """The frame that a vehicle sends at a time [s]."""
    stated = vehicle.cam(PLAZA, t)
    content = CamContent.model_validate(stated.model_dump(include=set(CamContent.model_fields)))
    return cams.packet(content, its_time.its_time_ms(stated.sampled_ns))


@dataclass
class Role:
    """Vehicles that send ten CAM a second, an attacker's frames, detectors, and who is registered."""

    folder: Path
    vehicles: tuple[Vehicle, ...] = ()
    registered: tuple[int, ...] = (7,)
    pulses_s: tuple[float, ...] = ()  # of lane n2
    detectors: bool = True
    injected: list[tuple[float, bytes]] = field(default_factory=list)  # arrival [s] and frame
    encapsulation: Encapsulation = Encapsulation.GEONETWORKING
    is_lost: Callable[[float, Vehicle], bool] = lambda _t, _vehicle: False
    statements: list[TollPassage] = field(default_factory=list)
    core: Toll | None = None
    now_s: float = -15.0
    fixes_late_s: float = 0.0  # how late those of the unit's receiver arrive
    tickets: Mapping[int, Ticket] = field(default_factory=dict)  # of vehicles by their place in `vehicles`
    contracts: tuple[tuple[Ticket, str, int | None], ...] = ()  # registered tickets, with contract and station ID
    stations: tuple[tuple[int, str], ...] = ()  # further registrations of station IDs
    backward_s: tuple[float, ...] = ()  # pulses of n2 at which a vehicle drove backwards
    plaza_file: str = ""
    alarms: list[TollAlarm] = field(default_factory=list)
    _signed: dict[bytes, Ticket] = field(default_factory=dict)

    def __post_init__(self) -> None:
        text = self.plaza_file or (WITH_DETECTORS if self.detectors else WITHOUT_DETECTORS)
        self.file = self.folder / "plaza.geojson"
        self.file.write_text(text)
        self.plaza = parse_plaza(text.encode())
        self.store = Store(self.folder / "ledger.sqlite")
        self.parser = V2xParser(V2xConfig())
        self.start_ledger()
        self.start_core()

    def start_core(self) -> None:
        self.core = Toll(TollConfig(plaza_file=self.file))

    def start_ledger(self) -> None:
        self.ledger = Ledger(self.store, self.plaza, self.file.read_text(), Settings(), stamp(self.now_s))

    def frame(self, vehicle: Vehicle, t: float) -> bytes:
        """Make the frame that a vehicle sends at a time [s]."""
        return packet(vehicle, t)

    def registration(self, station: int, contract: str, t: float) -> TollRegistration:
        """Make the registration of a station ID at a time [s]."""
        return TollRegistration(
            sampled_ns=stamp(t), contract=contract, tariff_class="car", station_id=station,
            valid_until_ns=stamp(t + 60.0), plaza=PLAZA.name,
        )  # fmt: skip

    def drive(self, until: float) -> None:
        for tenth in range(round(self.now_s * 10), round(until * 10)):
            self.now_s = t = tenth / 10.0
            if tenth % 10 == 0:
                self._second(t)
            sent = []
            for number, vehicle in enumerate(self.vehicles):
                if t >= 0.0 and not self.is_lost(t, vehicle):
                    sent.append(self.frame(vehicle, t))
                    if number in self.tickets:
                        self._signed[sent[-1]] = self.tickets[number]
            sent += [frame for arrival_s, frame in self.injected if t <= arrival_s < t + 0.1]
            if sent:
                received = [(stamp(t + LATENCY_S), frame) for frame in sent]
                self._receive(CamFrames(received_ns=stamp(t + LATENCY_S), source="v2x0", data=frames.pack(received),
                                        encapsulation=self.encapsulation))  # fmt: skip
        self.now_s = until

    def restart_core(self, outage_s: float = 1.5) -> None:
        self.core = None
        self.drive(self.now_s + outage_s)
        self.start_core()

    def state(self) -> LedgerState:
        return self.ledger.state(stamp(self.now_s))

    def outcomes(self) -> dict[str, PassageState]:
        return {row.passage_id: row.state for row in self.state().recent if row.state is not PassageState.MISSED}

    def reviews(self) -> list[TollReview]:
        return self.ledger.reviews()

    def _receive(self, batch: CamFrames) -> None:
        for decoded in self.parser.handle(batch):
            if isinstance(decoded, CamList):
                cams = (cam.model_copy(update=self._extra(cam)) for cam in decoded.cams)
                self._tell(decoded.model_copy(update={"cams": tuple(cams)}))

    def _extra(self, cam: Cam) -> dict[str, object]:
        ticket = self._signed.get(cam.frame)
        return ticket.extra if ticket else {}

    def _second(self, t: float) -> None:
        registered = [(station, f"contract of {station % 10}") for station in self.registered]
        for station, contract in (*registered, *self.stations):
            registration = self.registration(station, contract, t)
            self.ledger.register(registration, stamp(t))
            self._tell(registration)
        for ticket, contract, station_id in self.contracts if round(t) % 10 == 0 else ():
            registration = ticket.registration(contract, stamp(t), station_id=station_id)
            self.ledger.register(registration, stamp(t))
            self._tell(registration)
        self._tell(fix(PLAZA, t - self.fixes_late_s, *COMMON))
        self._tell(Tick(now_ns=stamp(t)))
        for number, pulse_s in enumerate(self.pulses_s):
            if self.detectors and pulse_s <= t:
                backward = (stamp(pulse_s),) if pulse_s in self.backward_s else ()
                pulse = PlazaDetector(sampled_ns=stamp(pulse_s), plaza=PLAZA.name, lane="n2", since_ns=START_NS,
                                      pulse=number, backward_ns=backward)  # fmt: skip
                self.ledger.detect(pulse, stamp(t))
        self.ledger.reconcile(stamp(t))
        self.ledger.expire(stamp(t))
        for row, alarm in self.ledger.alarms.due():
            self.alarms.append(alarm)
            self.ledger.alarms.sent(row)
        for restored in self.ledger.restored():
            self._tell(restored)
        self._tell(self.ledger.open_passages(stamp(t)))

    def _tell(self, message: In) -> None:
        for answer in list(self.core.handle(message)) if self.core else []:
            self.ledger.use(answer, stamp(self.now_s))
            if isinstance(answer, TollPassage) and not answer.checkpoint:
                self.statements.append(answer)
