"""Decodes received CAM, and encodes those of this unit."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import hypot, radians
from pathlib import Path
from urllib.parse import urlsplit

from pydantic import Field, ValidationError, ValidationInfo, model_validator

from shared.errors import RejectedFrame
from shared.faults import Faults
from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.messages.base import Message, Tick
from shared.messages.fitting import parts
from shared.messages.gnss import GnssFix
from shared.messages.neighbours import NeighbourStates
from shared.messages.v2x import (
    Authentication,
    Cam,
    CamFrames,
    CamList,
    Encapsulation,
    OwnCam,
    StationType,
    V2xSend,
)
from shared.runtime.config import Section, vehicle_in
from shared.topics import BY_NAME
from shared.v2x import cam, frames, geonetworking, its_time
from shared.v2x.security.envelope import SignedPacket, without_envelope
from shared.v2x.security.trusted import Trusted
from shared.v2x.security.verifier import Stated, Verdict

from .neighbours import ReceivedNeighbours

MAX_FRAMES = 1024  # of one batch
LIST_BYTES = BY_NAME["v2x/cam"].most_bytes - 1_000  # of CAM in one message
CERTAIN_CAMS = LIST_BYTES // 10_000  # so many fit, also with the longest frames and paths
PAI_INTERVAL_M = 80.0  # itsGnPaiInterval: EN 302 636-4-1, annex H
NS_PER_MS = 1_000_000
SIMULATED_TRUST = Path("deploy/trust")  # with the root of the simulated traffic, which is a test root
TRAFFIC, RADIO = "sensors.traffic", "sensors.v2x"
LOOPBACK = ("", "127.0.0.1", "::1", "localhost")  # hosts of frames that no radio has received; none: the default
S_PER_H = 3600.0
NEIGHBOURS_PERIOD_NS = 1_000_000_000
RADIO_NAME = "v2x0"  # source of neighbours before any batch has named one
UNSIGNED = Verdict(Authentication.UNSIGNED)


class SecuritySettings(Section):
    """Verification of signed CAM."""

    trust_folder: Path | None = Field(
        default=None,
        description="folder with the certificates and lists that are trusted; test roots lie in its sub-folder `test`. "
        "If not given, no sender is authenticated; beside sensors.traffic it is deploy/trust, of the simulation's root",
    )
    countries: tuple[int, ...] = Field(
        default=(),
        max_length=20,
        description="numbers (ISO 3166-1) of the country, and of unions of countries, in which this unit is: "
        "certificates that are valid in named countries are judged by them",
    )
    list_grace_h: float = Field(
        default=24.0,
        ge=0.0,
        le=2160.0,
        description="time after which trust lists whose next one is overdue count no more: no sender is "
        "authenticated then by what they hold",
    )
    max_age_s: float = Field(
        default=2.0,
        gt=0.0,
        le=5.0,
        description="largest difference between the time of a signature and its reception; others are rejected",
    )


class Config(Section):
    """Settings of the V2X parser."""

    max_age_s: float = Field(default=5.0, ge=0.0, le=32.0, description="largest age of a CAM; older ones are rejected")
    max_future_s: float = Field(
        default=2.0,
        ge=0.0,
        le=32.0,
        description="CAM whose generation time is further ahead of this unit's are rejected",
    )
    max_header_difference_s: float = Field(
        default=1.0,
        ge=0.0,
        le=32.0,
        description="frames whose GeoNetworking time, or whose time of signature, differs by more from the generation "
        "time of their CAM are rejected: a CAM repeated after 65.536 s has the generation time of a new one, and not "
        "its header",
    )
    max_distance_m: float = Field(
        default=10_000.0, gt=0.0, description="CAM of stations further from this unit's GNSS position are rejected"
    )
    security: SecuritySettings = SecuritySettings()
    neighbours: bool = Field(
        default=False,
        description="publish the stations as neighbours for core.cooperative, once a second, with the carrier "
        "frequency offset where the radio gives one; not beside sensors.simulator, which publishes its own",
    )
    simulated: bool = Field(
        default=False,
        description="the unit runs beside sensors.traffic, and its radio is simulated: test roots are trusted; follows "
        "from the vehicle's file, and cannot be set to true without that section, or with a radio of another computer",
    )

    @model_validator(mode="before")
    @classmethod
    def _beside_traffic(cls, given: object, info: ValidationInfo) -> object:
        """Test roots are trusted beside simulated traffic, and nowhere else."""
        vehicle = vehicle_in(info.context)
        if not isinstance(given, dict) or vehicle is None:
            return given
        is_simulated = TRAFFIC in vehicle.processes and _is_here(vehicle.tables.get(RADIO, {}).get("device", ""))
        if given.get("simulated") and not is_simulated:
            raise ValueError(
                f"simulated = true needs [{TRAFFIC}] and a radio of this computer: test roots are refused on the road"
            )
        security = given.get("security", {})
        if is_simulated and isinstance(security, dict):
            security = {"trust_folder": SIMULATED_TRUST, **security}
        return {"simulated": is_simulated, **given, "security": security}


@dataclass(frozen=True)
class Decoded:
    """A frame of which everything but the signature is checked."""

    frame: bytes
    received_ns: int
    generated_ns: int
    generation_delta_time: int
    content: cam.Record
    permissions: int
    signed: SignedPacket | None


class Process:
    """Decodes each frame of a batch by itself; of earlier ones, tickets and frames that wait for theirs are kept."""

    def __init__(self, config: Config) -> None:
        self.rejects: Counter[str] = Counter()
        self._faults = Faults(self.rejects)
        self._config = config
        self._trusted = Trusted[Decoded](
            config.security.trust_folder, self.rejects, countries=config.security.countries,
            grace_s=config.security.list_grace_h * S_PER_H, is_simulated=config.simulated,
        )  # fmt: skip
        self._utc_offset_ns = 0  # UTC - OBU time line; the line begins at the host's UTC
        self._position: Geodetic | None = None
        self._own_station: int | None = None
        self._neighbours = ReceivedNeighbours(self.rejects) if config.neighbours else None
        self._published_ns = 0  # of the neighbours
        self._source = ""  # of the newest batch

    def handle(self, message: Message) -> Iterator[CamList | V2xSend | NeighbourStates]:
        """Process a batch of frames, a CAM to be sent, or a fix."""
        match message:
            case CamFrames():
                self._source = message.source
                yield from self._listed(list(self._decode_batch(message)), message.received_ns)
            case OwnCam():
                yield from self._encode(message)
            case GnssFix(utc_ns=int(utc_ns)):
                self._utc_offset_ns = utc_ns - message.sampled_ns
                if message.latitude_deg is not None and message.longitude_deg is not None:
                    self._position = _geodetic(message.latitude_deg, message.longitude_deg)
            case Tick():
                waited = [*self._trusted.expire(message.now_ns), *self._trusted.reload(message.now_ns)]
                yield from self._listed([cam for item in waited if (cam := self._judged(*item))], message.now_ns)
                yield from self._neighbours_at(message.now_ns)

    def _neighbours_at(self, now_ns: int) -> Iterator[NeighbourStates]:
        if self._neighbours is None or now_ns - self._published_ns < NEIGHBOURS_PERIOD_NS:
            return
        self._published_ns = now_ns
        if (states := self._neighbours.states(now_ns, self._source or RADIO_NAME)) is not None:
            yield states

    def _listed(self, cams: Sequence[Cam], received_ns: int) -> Iterator[CamList]:
        for part in [cams] if 0 < len(cams) <= CERTAIN_CAMS else parts(cams, LIST_BYTES):
            yield CamList(received_ns=received_ns, source=self._source, cams=tuple(part))

    def _decode_batch(self, batch: CamFrames) -> Iterator[Cam]:
        for item in self._trusted.expire(batch.received_ns):
            if waited := self._judged(*item):
                yield waited
        for number, (received_ns, frame) in enumerate(self._unpacked(batch.data)):
            if self._neighbours is not None and number < len(batch.cfo_hz):
                self._neighbours.note_offset(received_ns, frame, batch.cfo_hz[number])
            with self._faults.decoding(batch.received_ns):
                try:
                    decoded = self._decode(frame, received_ns, batch.encapsulation)
                    for item in self._verified(decoded):
                        if cam_of_frame := self._judged(*item):
                            yield cam_of_frame
                except RejectedFrame as error:
                    self.rejects[error.reason] += 1

    def _unpacked(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Split a batch; what follows a record of an impossible length is lost, and counted once."""
        try:
            for number, record in enumerate(frames.unpack(data)):
                if number == MAX_FRAMES:
                    raise ValueError("too many frames")
                yield record
        except ValueError:
            self.rejects["batch"] += 1

    def _decode(self, frame: bytes, received_ns: int, encapsulation: Encapsulation) -> Decoded:
        """Decode a frame and make the checks that cost little."""
        has_header = encapsulation is Encapsulation.GEONETWORKING
        packet, signed = without_envelope(frame, self._trusted.take) if has_header else (frame, None)
        received_ms = its_time.its_time_ms(received_ns + self._utc_offset_ns)
        payload = geonetworking.decode_payload(packet) if has_header else packet
        content, generation_delta_time, permissions = cam.decode_with_permissions(payload)
        if content["station_id"] == self._own_station:
            raise RejectedFrame("own_station")
        age_ms = its_time.generation_age_ms(generation_delta_time, received_ms)
        if age_ms > self._config.max_age_s * 1000:
            raise RejectedFrame("too_old", age_ms)
        if age_ms < -self._config.max_future_s * 1000:
            raise RejectedFrame("from_the_future", -age_ms)
        if has_header:
            self._check_header(packet, received_ms - age_ms)
        if signed is not None:
            self._check_signed_time(signed.generation_time_ms, received_ms - age_ms)
            self._check_age_of_signature(signed.generation_time_ms, received_ms)
        self._check_distance(content["latitude_deg"], content["longitude_deg"])
        if has_header:  # what a sender has put behind the frame is not kept
            frame = frame[: signed.data.end if signed else geonetworking.stated_length(packet)]
        generated_ns = its_time.utc_ns_from_its_time(received_ms - age_ms) - self._utc_offset_ns
        return Decoded(frame, received_ns, generated_ns, generation_delta_time, content, permissions, signed)

    def _verified(self, decoded: Decoded) -> Iterator[tuple[Decoded, Verdict]]:
        """Verify a signed frame; it may have to wait, and may release others."""
        if decoded.signed is None:
            yield decoded, UNSIGNED
            return
        content = decoded.content
        stated = Stated(content["latitude_deg"], content["longitude_deg"], decoded.permissions)
        yield from self._trusted.submit(decoded, decoded.signed, stated, decoded.received_ns)

    def _judged(self, decoded: Decoded, verdict: Verdict) -> Cam | None:
        """Make the CAM of a frame; one that is refused is counted by its reason."""
        if verdict.refused is not None:
            self.rejects[verdict.refused] += 1
            return None
        try:
            made = Cam(
                **decoded.content,
                sampled_ns=decoded.generated_ns,
                received_ns=decoded.received_ns,
                generation_delta_time=decoded.generation_delta_time,
                frame=decoded.frame,
                authentication=verdict.authentication,
                signer=decoded.signed.signer.hex() if decoded.signed else None,
                unverified=verdict.unverified,
            )
            if self._neighbours is not None:
                self._neighbours.note(made, decoded.frame)
            return made
        except ValidationError:
            self.rejects["range"] += 1
            return None

    def _check_age_of_signature(self, signed_ms: int, received_ms: int) -> None:
        if abs(received_ms - signed_ms) > self._config.security.max_age_s * 1000:
            raise RejectedFrame("too_old" if received_ms > signed_ms else "from_the_future", received_ms - signed_ms)

    def _check_header(self, packet: bytes, generated_ms: int) -> None:
        """Compare the time in the header, known modulo 49 days, with the generation time by CAM and reception."""
        cycle_ms = geonetworking.TIME_CYCLE_MS
        difference_ms = its_time.difference_ms(generated_ms, geonetworking.source_time_ms(packet), cycle_ms)
        if abs(difference_ms) > self._config.max_header_difference_s * 1000:
            raise RejectedFrame("header_time", difference_ms)

    def _check_signed_time(self, signed_ms: int, generated_ms: int) -> None:
        """Compare the time of the signature, which is known without a cycle, with that of the CAM by its reception."""
        if abs(signed_ms - generated_ms) > self._config.max_header_difference_s * 1000:
            raise RejectedFrame("generation_time", signed_ms - generated_ms)

    def _check_distance(self, latitude_deg: float | None, longitude_deg: float | None) -> None:
        if self._position is None or latitude_deg is None or longitude_deg is None:
            return
        distance_m = hypot(*ned_from_geodetic_difference(_geodetic(latitude_deg, longitude_deg), self._position)[:2])
        if distance_m > self._config.max_distance_m:
            raise RejectedFrame("too_far", round(distance_m))

    def _encode(self, own: OwnCam) -> Iterator[V2xSend]:
        self._own_station = own.station_id
        if own.latitude_deg is None or own.longitude_deg is None:  # the header has no code for an unknown position
            self.rejects["own_position"] += 1
            return
        payload = cam.encode(own, own.its_time_ms % its_time.CYCLE_MS)
        sender = geonetworking.PositionVector(
            mac_address=geonetworking.pseudonymous_address(own.station_id),
            station_type=cam.STATION_TYPE_CODES.get(own.station_type, 0),
            its_time_ms=own.its_time_ms,
            latitude_deg=own.latitude_deg,
            longitude_deg=own.longitude_deg,
            accurate=_is_accurate(own),
            speed_m_s=own.speed_m_s or 0.0,
            heading_rad=own.heading_rad or 0.0,
        )
        mobile = own.station_type is not StationType.ROAD_SIDE_UNIT
        packet = geonetworking.encode_packet(payload, sender, mobile=mobile)
        yield V2xSend(received_ns=own.sampled_ns, source=str(own.station_id), data=packet)


def _is_here(device: object) -> bool:
    """Whether frames from a device come from this computer, by UDP."""
    parts = urlsplit(str(device))
    return parts.scheme in ("", "udp", "udp+json") and (parts.hostname or "") in LOOPBACK


def _is_accurate(own: OwnCam) -> bool:
    """Position accuracy indicator: the semi-major axis is known, and shorter than half of the interval."""
    major_m = own.position_semi_major_m
    return not own.position_out_of_range and major_m is not None and major_m < 0.5 * PAI_INTERVAL_M


def _geodetic(latitude_deg: float, longitude_deg: float) -> Geodetic:
    return Geodetic(radians(latitude_deg), radians(longitude_deg), 0.0)
