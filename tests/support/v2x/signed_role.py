"""A road-side unit whose vehicles sign, from the radio to bookings: a PKI of the test, and an operator's key."""

from dataclasses import dataclass, field
from typing import Any

from services.parsers.v2x.process import Config as V2xConfig
from services.parsers.v2x.process import Process as V2xParser
from services.sensors.traffic.station import Station
from shared.messages.gnss import FixType, GnssFix
from shared.messages.toll import TollRegistration
from shared.messages.v2x import CamContent
from shared.toll.plaza import parse_plaza
from shared.v2x import its_time
from tests.support.v2x import cams
from tests.support.v2x.role import PLAZA, Role, stamp
from tests.support.v2x.signing import Pki
from tests.support.v2x.toll import START_NS, Vehicle

UTC_NS = 1_795_000_000 * 10**9  # at the start: the time line of these tests begins before ITS time does
OFFSET_NS = UTC_NS - START_NS
PKI = Pki.make(its_time.its_time_ms(UTC_NS) // 1000)


def utc_ns(t: float) -> int:
    """UTC at a time [s] of the test."""
    return stamp(t) + OFFSET_NS


def plain_packet(vehicle: Vehicle, t: float, later_s: float = 0.0) -> bytes:
    """The unsigned packet of a vehicle at a time [s]; `later_s`: as if it had been there so much later."""
    stated = vehicle.cam(PLAZA, t)
    content = CamContent.model_validate(stated.model_dump(include=set(CamContent.model_fields)))
    return cams.packet(content, its_time.its_time_ms(stated.sampled_ns + OFFSET_NS + round(later_s * 1e9)))


@dataclass
class SignedRole(Role):
    """Vehicles that sign by their place in `vehicles`, and tickets that are registered by station ID."""

    signers: tuple[Station | None, ...] = ()  # of each vehicle; None: it signs nothing
    registrants: dict[int, Station] = field(default_factory=dict)  # of each registered station ID
    require_authenticated: bool = True

    def __post_init__(self) -> None:
        self.folder.mkdir(exist_ok=True)
        super().__post_init__()
        self._rewrite_plaza()
        folder = PKI.write(self.folder / "trust")
        self.parser = V2xParser(V2xConfig.model_validate({"security": {"trust_folder": folder}}))
        fix = GnssFix(
            sampled_ns=START_NS, received_ns=START_NS, source="gnss0", utc_ns=UTC_NS, fix_type=FixType.THREE_D
        )
        list(self.parser.handle(fix))

    def _rewrite_plaza(self) -> None:
        text = self.file.read_text()
        if self.require_authenticated:
            text = text.replace('"require_authenticated": false', '"require_authenticated": true')
        self.file.write_text(text)
        self.plaza = parse_plaza(text.encode())
        self.start_ledger()
        self.start_core()

    def frame(self, vehicle: Vehicle, t: float) -> bytes:
        station = dict(zip(map(id, self.vehicles), self.signers, strict=True))[id(vehicle)]
        packet = plain_packet(vehicle, t)
        return station.sign(packet, utc_ns(t)) if station else packet

    def registration(self, station: int, contract: str, t: float) -> TollRegistration:
        unsigned = super().registration(station, contract, t)
        return self.registrants[station].register(unsigned) if station in self.registrants else unsigned


def station(name: str, **members: Any) -> Station:
    """A station with a ticket of the test's PKI."""
    return Station(PKI.ticket(name, **members))
