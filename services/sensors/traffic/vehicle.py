"""One simulated vehicle: where it is, what its receiver errs, and the CAM that it sends."""

from dataclasses import dataclass, field
from math import pi, radians

import numpy as np

from shared.maths.earth import Geodetic, wrap_angle
from shared.messages.v2x import CamContent, DriveDirection, LowFrequencyContainer, StationType
from shared.toll.plaza import Lane, Plaza
from shared.v2x import cam, geonetworking, its_time
from shared.v2x.generation import Dynamics, GenerationRules

from .errors import ELLIPSE_95, ErrorModel, GaussMarkov
from .motion import Path, Pose
from .station import Station

# Noise of the vehicle's own sensors, one sigma: docs/explanation/charging.md.
SPEED_SD, ACCELERATION_SD, YAW_RATE_SD, HEADING_SD = 0.15, 0.15, radians(0.3), radians(1.0)
STATION_TYPES = {
    "car": StationType.PASSENGER_CAR,
    "van": StationType.LIGHT_TRUCK,
    "truck": StationType.HEAVY_TRUCK,
}
SIZES_M = {"car": (4.5, 1.8), "van": (6.0, 2.1), "truck": (12.0, 2.5)}  # length, width
REGISTRATION_NS = 10_000_000_000


@dataclass
class Vehicle:
    """State of a vehicle; distances are arc lengths of its path."""

    number: int
    lane: Lane
    path: Path
    gate: float
    offset: float  # to the right of the lane's centre
    wanted_speed: float
    tariff_class: str
    equipped: bool
    registered: bool
    corrected: bool  # its receiver uses corrections: none of the common error
    multipath: GaussMarkov
    station_id: int
    phase_ns: int  # when in a step it checks the generation rules
    contract: str | None = None
    signs: bool = False
    station: Station | None = None  # of the present station ID, once it has sent; None: it signs nothing
    change_at: float | None = None  # where it takes a new station ID
    silent: tuple[float, float] | None = None  # from where to where it sends nothing
    dwell_s: float = 0.0  # at the gate
    distance: float = 0.0
    speed: float = 0.0
    acceleration: float = 0.0
    crossed: bool = False
    turned: bool = False
    registered_ns: int | None = None  # last registration sent
    rules: GenerationRules = field(default_factory=GenerationRules)

    @property
    def length(self) -> float:
        """Length [m]."""
        return SIZES_M[self.tariff_class][0]

    def pose(self, ahead_s: float = 0.0) -> Pose:
        """Pose of the front point now, or a little later."""
        moved = self.speed * ahead_s + 0.5 * self.acceleration * ahead_s**2
        return self.path.pose(self.distance + max(moved, 0.0), self.offset)


def content_of(
    vehicle: Vehicle, plaza: Plaza, common: GaussMarkov, model: ErrorModel, utc_ns: int, ahead_s: float,
    rng: np.random.Generator,
) -> CamContent | None:  # fmt: skip
    """Say what a vehicle sends at an instant; None if the generation rules ask for nothing.

    What the vehicle states and what the rules compare is what its own sensors measure, not the truth.
    """
    pose = vehicle.pose(ahead_s)
    error = vehicle.multipath.value + (0.0 if vehicle.corrected else common.value)
    noise = rng.standard_normal(6)
    place = plaza.position(*(np.array([pose.north, pose.east]) + error + model.white_sd_m * noise[:2]).tolist())
    speed = max(vehicle.speed + vehicle.acceleration * ahead_s + SPEED_SD * noise[2], 0.0)
    heading = wrap_angle(pose.heading + HEADING_SD * noise[3]) % (2.0 * pi)
    position = Geodetic(radians(place.latitude_deg), radians(place.longitude_deg), plaza.antenna.height)
    generation = vehicle.rules.check(Dynamics(utc_ns, position, heading, speed))
    if generation is None:
        return None
    stated = ELLIPSE_95 * model.stated_sd(corrected=vehicle.corrected)
    return CamContent(
        station_id=vehicle.station_id,
        station_type=STATION_TYPES[vehicle.tariff_class],
        latitude_deg=place.latitude_deg,
        longitude_deg=place.longitude_deg,
        position_semi_major_m=stated,
        position_semi_minor_m=stated,
        position_semi_major_orientation_rad=0.0,
        height_ellipsoid_m=plaza.antenna.height,
        heading_rad=heading,
        heading_confidence_rad=1.96 * HEADING_SD,
        speed_m_s=speed,
        speed_confidence_m_s=1.96 * SPEED_SD,
        drive_direction=DriveDirection.FORWARD,
        vehicle_length_m=vehicle.length,
        vehicle_width_m=SIZES_M[vehicle.tariff_class][1],
        longitudinal_acceleration_m_s2=vehicle.acceleration + ACCELERATION_SD * noise[4],
        longitudinal_acceleration_confidence_m_s2=1.96 * ACCELERATION_SD,
        curvature=pose.curvature,
        yaw_rate_rad_s=vehicle.speed * pose.curvature + YAW_RATE_SD * noise[5],
        yaw_rate_confidence_rad_s=1.96 * YAW_RATE_SD,
        low_frequency=LowFrequencyContainer() if generation.low_frequency else None,
    )


def packet_of(content: CamContent, utc_ns: int) -> bytes:
    """Encode what a vehicle sends at an instant as a GeoNetworking packet."""
    latitude_deg, longitude_deg = content.latitude_deg or 0.0, content.longitude_deg or 0.0
    time_ms = its_time.its_time_ms(utc_ns)
    sender = geonetworking.PositionVector(
        mac_address=geonetworking.pseudonymous_address(content.station_id),
        station_type=cam.STATION_TYPE_CODES[content.station_type],
        its_time_ms=time_ms,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        accurate=True,
        speed_m_s=content.speed_m_s or 0.0,
        heading_rad=content.heading_rad or 0.0,
    )
    return geonetworking.encode_packet(cam.encode(content, time_ms % its_time.CYCLE_MS), sender)
