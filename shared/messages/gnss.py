"""What GNSS receivers say, and what is said to them."""

from enum import StrEnum
from typing import Annotated, ClassVar

from pydantic import Field

from .base import (
    Bytes,
    Count,
    Deviation,
    Deviation3,
    Height,
    Integer,
    Latitude,
    Longitude,
    Message,
    Name,
    Nanoseconds,
    Quantity,
    Ratio,
    RawBytes,
    Reason,
    Seconds,
    Speed,
    StampedMessage,
    Statistic,
    Symmetric3,
    Vector3,
    Velocity3,
    unit,
)

MAX_SIGNALS = 255  # of one epoch; UBX-NAV-SIG counts them in a byte
MAX_RAW_MEASUREMENTS = 128  # of one epoch; the longest RXM-RAWX that the parser reads has 127
MAX_NAVIGATION_WORDS = 16  # of one subframe or page
MAX_RADIO_PATHS = 8  # of one receiver: one a band


class GnssRaw(RawBytes):
    """Bytes that a GNSS receiver sent: UBX, NMEA or both."""

    is_stream: ClassVar[bool] = True
    recorded: bool | None = None  # read from a file: dates in them are those of the recording


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


OMITTED_IF_NONE = Field(exclude_if=lambda value: value is None)  # of what few receivers state


class GnssFix(StampedMessage):
    """One navigation epoch of a receiver: position and velocity of its antenna."""

    gps_time_ns: Nanoseconds | None = None  # since 1980-01-06, GPS time
    utc_ns: Nanoseconds | None = None  # since 1970-01-01, UTC
    late_s: Seconds | None = None  # by which it arrived later than the fastest ones, where this is much
    fix_type: FixType
    carrier_solution: CarrierSolution = CarrierSolution.NONE
    differential: bool = False
    satellites_used: Count | None = None
    latitude_deg: Latitude | None = None
    longitude_deg: Longitude | None = None
    height_ellipsoid_m: Height | None = None
    height_msl_m: Height | None = None
    height_sign_assumed: Annotated[bool, Field(exclude_if=lambda value: not value)] = False  # a file of somebody's own
    velocity_ned_m_s: Velocity3 | None = None
    ground_speed_m_s: Speed | None = None
    course_rad: Quantity | None = None
    position_sd_ned_m: Deviation3 | None = None
    velocity_sd_ned_m_s: Deviation3 | None = None
    position_cov_ned_m2: Symmetric3 | None = None
    velocity_cov_ned_m2_s2: Symmetric3 | None = None
    pdop: Ratio | None = None
    hdop: Ratio | None = None
    vdop: Ratio | None = None
    gdop: Annotated[Ratio | None, OMITTED_IF_NONE] = None  # geometric: of position and time
    tdop: Annotated[Ratio | None, OMITTED_IF_NONE] = None  # of time
    time_sd_s: Annotated[Seconds | None, OMITTED_IF_NONE] = None  # accuracy of its UTC, as the receiver states it
    correction_age_s: Seconds | None = None
    correction_source: Name | None = None  # where the corrections come from that this unit gave to the receiver
    baseline_heading_rad: Quantity | None = None  # from the first antenna to the second, clockwise from true north
    baseline_heading_sd_rad: Deviation | None = None
    baseline_length_m: Quantity | None = None
    stated_heading_rad: Quantity | None = None  # of the vehicle, by the receiver's own filter
    stated_horizontal_level_m: Deviation | None = None  # the receiver's own protection levels
    stated_vertical_level_m: Deviation | None = None
    stated_level_ned_m: Annotated[Deviation3 | None, OMITTED_IF_NONE] = None


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


class SignalQuality(StrEnum):
    """How far a receiver tracks a satellite, after UBX-NAV-SAT."""

    NO_SIGNAL = "no_signal"
    SEARCHING = "searching"
    ACQUIRED = "acquired"
    UNUSABLE = "unusable"
    CODE_LOCKED = "code_locked"
    CARRIER_LOCKED = "carrier_locked"


class Satellite(Message):
    """One satellite as the receiver sees it."""

    constellation: Constellation
    number: Count
    cn0_db_hz: Quantity | None = None
    elevation_rad: Quantity | None = None
    azimuth_rad: Quantity | None = None
    residual_m: Quantity | None = None
    used: bool
    # None of receivers that do not state it
    quality: SignalQuality | None = None
    healthy: bool | None = None
    orbit_known: bool | None = None  # from an ephemeris, almanac or assistance data


class GnssSatellites(StampedMessage):
    """The satellites of one epoch."""

    satellites: tuple[Satellite, ...]


class GnssSignal(Message):
    """One signal of a satellite as the receiver tracks and uses it, after UBX-NAV-SIG."""

    constellation: Constellation
    number: Count
    signal: Name | None = None  # as in `RawMeasurement`
    cn0_db_hz: Quantity | None = None
    quality: SignalQuality
    healthy: bool | None = None  # None: not known
    residual_m: Quantity | None = None  # of the pseudorange; None unless it is used
    pseudorange_used: bool
    carrier_phase_used: bool
    doppler_used: bool
    corrected: bool  # whether corrections of the pseudorange are used


class GnssSignals(StampedMessage):
    """The signals of one epoch, from receivers that state them one by one."""

    signals: Annotated[tuple[GnssSignal, ...], Field(max_length=MAX_SIGNALS)]


class RawMeasurement(Message):
    """Code, carrier and Doppler of one signal; what the receiver does not call valid is None."""

    constellation: Constellation
    number: Count
    signal: Name | None = None  # observation code of RINEX 3 without its first letter: 1C is L1 C/A and E1-C
    # channel of a GLONASS satellite: k of 1602 MHz + k 562.5 kHz at L1
    glonass_frequency_number: Annotated[int, Field(ge=-7, le=6), unit("1")] | None = None
    pseudorange_m: Quantity | None = None
    pseudorange_sd_m: Deviation | None = None
    carrier_phase_cycles: Annotated[Statistic, unit("cycles")] | None = None
    carrier_phase_sd_cycles: Annotated[Statistic, unit("cycles")] | None = None
    half_cycle_resolved: bool = False
    doppler_hz: Quantity | None = None  # positive while the satellite approaches
    doppler_sd_hz: Quantity | None = None
    cn0_db_hz: Quantity | None = None
    lock_time_s: Seconds | None = None


class GnssRawEpoch(StampedMessage):
    """The raw measurements of one reception time, as the receiver's clock shows it."""

    gps_time_ns: Nanoseconds  # since 1980-01-06, by the receiver's clock
    leap_seconds: Count | None = None  # GPS - UTC
    clock_reset: bool = False
    measurements: Annotated[tuple[RawMeasurement, ...], Field(max_length=MAX_RAW_MEASUREMENTS)]


class FaultFreeFix(StampedMessage):
    """Least-squares fix of an epoch without the satellites that are excluded, in place of the receiver's own."""

    latitude_deg: Latitude
    longitude_deg: Longitude
    height_ellipsoid_m: Height
    position_cov_ned_m2: Symmetric3
    velocity_ned_m_s: Velocity3 | None = None
    velocity_cov_ned_m2_s2: Symmetric3 | None = None
    satellites_left_out: Annotated[tuple[Name, ...], Field(max_length=MAX_RAW_MEASUREMENTS)]


class CarrierDisplacement(StampedMessage):
    """Displacement of the antenna since an earlier epoch of the same receiver, by the change of its carrier phases."""

    since_ns: Nanoseconds  # stamp of the earlier epoch
    displacement_ned_m: Vector3
    displacement_cov_ned_m2: Symmetric3
    slow_cov_ned_m2: Symmetric3  # the part that successive displacements share: orbits, clocks, ionosphere
    satellites_used: Count
    redundancy: Count
    satellites_slipped: Annotated[tuple[Name, ...], Field(max_length=MAX_RAW_MEASUREMENTS)] = ()
    checked: bool  # one slip of half a cycle would have been found; without it nothing relies on the displacement
    doppler_velocity_ned_m_s: Vector3 | None = None  # mean of both epochs by Doppler, of the same satellites
    doppler_sd_ned_m_s: Vector3 | None = None


class GnssNavigationBits(StampedMessage):
    """One subframe or page of a navigation message, in the words in which the receiver gives it."""

    constellation: Constellation
    number: Count
    signal: Name  # as in `RawMeasurement`
    words: Annotated[
        tuple[Annotated[int, Field(ge=0, lt=2**32), unit("1")], ...], Field(max_length=MAX_NAVIGATION_WORDS)
    ]


class InterferenceState(StrEnum):
    """What a receiver's own detector of jamming or of spoofing says."""

    UNKNOWN = "unknown"  # off, or not able to tell
    NONE = "none"
    INDICATED = "indicated"
    SEVERE = "severe"  # spoofing: by several indications; jamming: no fix


class SignalFlags(Message):
    """Flags of the detectors of one message; None for a detector that the message does not have."""

    jamming: InterferenceState | None = None
    spoofing: InterferenceState | None = None


class ReceiverStatus(SignalFlags):
    """Flags of UBX-NAV-STATUS, and how long the first fix took."""

    time_to_first_fix_s: Seconds | None = None  # None before the first fix


class RadioPath(Message):
    """State of one radio-frequency path of a receiver, which is that of one band."""

    number: Count
    jamming: InterferenceState = InterferenceState.UNKNOWN
    gain_ratio: Ratio | None = None  # of the automatic gain control, 1 at its largest count
    noise_level: Count | None = None  # as the receiver counts it
    narrowband_ratio: Ratio | None = None  # of the indicator of narrowband interference


class ReceiverClock(Message):
    """Clock of a receiver against GPS time; it jumps by milliseconds to stay near it."""

    bias_s: Seconds
    drift_ratio: Ratio  # seconds a second
    bias_sd_s: Deviation
    drift_sd_ratio: Ratio


class GnssSignalQuality(StampedMessage):
    """What a receiver says of its signals and clock in one epoch; None for what it did not send."""

    status: ReceiverStatus | None = None  # of UBX-NAV-STATUS
    security: SignalFlags | None = None  # of UBX-SEC-SIG
    radio_paths: Annotated[tuple[RadioPath, ...], Field(max_length=MAX_RADIO_PATHS)] = ()  # of UBX-MON-RF
    clock: ReceiverClock | None = None  # of UBX-NAV-CLOCK
    time_step_s: Seconds | None = None  # by which the receiver's time jumped ahead against the OBU time line


class GnssOutput(StrEnum):
    """What a receiver is to tell, whatever the messages by which it does."""

    FIX = "fix"
    DILUTION = "dilution"
    COVARIANCE = "covariance"
    SATELLITES = "satellites"
    RAW_MEASUREMENTS = "raw_measurements"
    NAVIGATION_BITS = "navigation_bits"
    INTERFERENCE = "interference"
    CLOCK = "clock"
    SIGNALS = "signals"
    INERTIAL = "inertial"
    WHEEL_TICKS = "wheel_ticks"
    LEVELS = "levels"  # protection levels of its own, of receivers that compute them


class GnssConfigure(Message):
    """What the controller wants of a receiver."""

    request_id: Annotated[Integer, unit("1")]
    source: Name
    navigation_period_s: Seconds
    outputs: tuple[GnssOutput, ...] = ()
    dynamic_model: Name | None = None  # such as automotive; None: as it is


class GnssStart(StrEnum):
    """What a receiver knows when it starts anew."""

    HOT = "hot"  # everything
    WARM = "warm"  # not the ephemerides
    COLD = "cold"  # nothing


class GnssReset(Message):
    """Lets a receiver start anew; it does not answer, but loses its position for a time."""

    request_id: Name
    source: Name
    start: GnssStart


class GnssReceiver(Message):
    """What a receiver sends, by its bytes and whether or not it has a position: every two seconds."""

    received_ns: Nanoseconds
    source: Name
    messages: tuple[Name, ...] = ()  # kinds of the last ten seconds: `UBX NAV-PVT`, `NMEA GGA`, `RTCM 1005`
    gives_position: bool = False  # whether a fix can be made of these
    other_protocols: tuple[Name, ...] = ()  # recognised in the other bytes, which are not read
    received_bytes: Bytes  # since the last statement
    other_bytes: Bytes  # of these, in no message: many at a wrong rate of the port


class GnssConfiguration(Message):
    """What a receiver answered to a `GnssConfigure`, as read back from it."""

    request_id: Annotated[Integer, unit("1")]
    source: Name
    accepted: bool
    navigation_period_s: Seconds | None = None
    messages: tuple[Name, ...] = ()
    reason: Reason | None = None
    # None of what a receiver does not state
    model: Name | None = None
    protocol: Name | None = None  # and its version, such as `UBX 18.00`
    firmware: Name | None = None
    dynamic_model: Name | None = None  # such as automotive
    elevation_mask_rad: Quantity | None = None  # below it the receiver does not use a satellite
