"""What GNSS receivers say, and what is said to them."""

from enum import StrEnum

from .base import (
    Count,
    Deviation,
    Deviation3,
    Height,
    Latitude,
    Longitude,
    Message,
    Name,
    Nanoseconds,
    Ratio,
    RawBytes,
    Reason,
    Speed,
    Stamped,
    Symmetric3,
    Velocity3,
)


class GnssRaw(RawBytes):
    """Bytes that a GNSS receiver sent: UBX, NMEA or both."""


class GnssWrite(RawBytes):
    """Bytes to be written to a GNSS receiver."""


class FixType(StrEnum):
    """Kinds of position fix, after UBX-NAV-PVT."""

    NONE = "none"
    DEAD_RECKONING = "dead_reckoning"
    TWO_D = "two_d"
    THREE_D = "three_d"
    GNSS_DEAD_RECKONING = "gnss_dead_reckoning"
    TIME_ONLY = "time_only"


class CarrierSolution(StrEnum):
    """State of the carrier-phase ambiguities."""

    NONE = "none"
    FLOAT = "float"
    FIXED = "fixed"


class GnssFix(Stamped):
    """One navigation epoch of a receiver: position and velocity of its antenna."""

    gps_time_ns: Nanoseconds | None = None  # since 1980-01-06, GPS time
    utc_ns: Nanoseconds | None = None  # since 1970-01-01, UTC
    fix_type: FixType
    carrier_solution: CarrierSolution = CarrierSolution.NONE
    differential: bool = False
    satellites_used: Count | None = None
    latitude_deg: Latitude | None = None
    longitude_deg: Longitude | None = None
    height_ellipsoid_m: Height | None = None
    height_msl_m: Height | None = None
    velocity_ned_m_s: Velocity3 | None = None
    ground_speed_m_s: Speed | None = None
    course_rad: float | None = None
    position_sd_ned_m: Deviation3 | None = None
    velocity_sd_ned_m_s: Deviation3 | None = None
    position_cov_ned_m2: Symmetric3 | None = None
    velocity_cov_ned_m2_s2: Symmetric3 | None = None
    pdop: Ratio | None = None
    hdop: Ratio | None = None
    vdop: Ratio | None = None
    correction_age_s: float | None = None
    baseline_heading_rad: float | None = None  # from the first antenna to the second, clockwise from true north
    baseline_heading_sd_rad: Deviation | None = None
    baseline_length_m: float | None = None


class Constellation(StrEnum):
    """Satellite systems."""

    GPS = "gps"
    SBAS = "sbas"
    GALILEO = "galileo"
    BEIDOU = "beidou"
    QZSS = "qzss"
    GLONASS = "glonass"
    NAVIC = "navic"
    UNKNOWN = "unknown"


class Satellite(Message):
    """One satellite as the receiver sees it."""

    constellation: Constellation
    number: Count
    cn0_db_hz: float | None = None
    elevation_rad: float | None = None
    azimuth_rad: float | None = None
    residual_m: float | None = None
    used: bool


class GnssSatellites(Stamped):
    """The satellites of one epoch."""

    satellites: tuple[Satellite, ...]


class GnssConfigure(Message):
    """What the controller wants of a receiver."""

    request_id: Count
    source: Name
    navigation_period_s: float
    messages: tuple[Name, ...]  # UBX names to be sent every epoch, such as NAV-PVT


class GnssConfiguration(Message):
    """What a receiver answered to a `GnssConfigure`, as read back from it."""

    request_id: Count
    source: Name
    accepted: bool
    navigation_period_s: float | None = None
    messages: tuple[Name, ...] = ()
    reason: Reason | None = None
