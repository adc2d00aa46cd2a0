"""One navigation epoch of the simulated receiver: the data that its messages encode."""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from math import atan2, degrees, hypot

from shared.maths.gnss_signals import SPEED_OF_LIGHT

from .navigation_words import Words
from .raw_measurements import RawMeasurements
from .reception import Fix
from .sky import Constellation, Sky

LEAP_SECONDS = 18  # GPS - UTC, since 2017
WEEK_MS = 604_800_000
GPS_EPOCH_UNIX_MS = 315_964_800_000  # 1980-01-06
GEOID_M = 47.0  # [m] height of the geoid above the ellipsoid: central Italy


@dataclass(frozen=True)
class Baseline:
    """The measured baseline from the first to the second antenna on the vehicle."""

    length_m: float
    heading: float  # [rad] clockwise from north
    heading_sd: float  # [rad]


@dataclass(frozen=True)
class SentWords:
    """A subframe or page that a satellite has just sent."""

    gnss_id: int
    number: int
    signal: int  # sigId of UBX
    words: Words


@dataclass(frozen=True)
class Signal:
    """What the receiver's detectors and its radio path show; the counts are those of UBX."""

    jamming: int = 1  # 1: none, 2: indicated, 3: no fix because of it
    spoofing: int = 1  # 1: none, 2: indicated, 3: by several indications
    gain: int = 4500  # of the gain control, 0 to 8191; it falls as the received power rises
    noise: int = 90
    narrowband: int = 20  # 0 to 255
    clock_s: float = 0.0  # added to the clock's bias, as a rebroadcast signal does
    drift_s_s: float = 0.0  # added to its drift


INDICATED_DB = 3.0  # rise of the noise from which the receiver indicates jamming
GAIN_PER_DB = 60.0  # counts by which the gain falls


def signal_under(noise_rise_db: float, path_m: float, path_rate_m_s: float, *, valid: bool) -> Signal:
    """What the receiver shows under interference [dB], or of signals that travelled a longer path [m, m/s]."""
    calm = Signal()
    jamming = 1 if noise_rise_db < INDICATED_DB else 2 if valid else 3
    return Signal(
        jamming=jamming,
        gain=max(0, round(calm.gain - GAIN_PER_DB * noise_rise_db)),
        noise=min(65535, round(calm.noise * 10.0 ** (noise_rise_db / 20.0))),
        clock_s=path_m / SPEED_OF_LIGHT,
        drift_s_s=path_rate_m_s / SPEED_OF_LIGHT,
    )


@dataclass(frozen=True)
class Epoch:
    """Time, fix and satellites of one epoch."""

    utc_ms: int  # UTC since 1970-01-01
    fix: Fix
    sky: Sky
    constellations: tuple[Constellation, ...]
    baseline: Baseline | None = None
    raw: RawMeasurements | None = None
    words: tuple[SentWords, ...] = ()
    signal: Signal = Signal()

    @property
    def itow_ms(self) -> int:
        """GPS time of week [ms]."""
        return gps_ms(self.utc_ms) % WEEK_MS

    @property
    def utc(self) -> datetime:
        """UTC as calendar date and time."""
        return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(milliseconds=self.utc_ms)

    @property
    def satellites_used(self) -> int:
        """Number of satellites used in the fix; 0 without a fix."""
        return int(self.sky.used.sum()) if self.fix.valid else 0

    @property
    def ground_speed_m_s(self) -> float:
        """Horizontal speed [m/s]."""
        return hypot(*self.fix.velocity_n[:2])

    @property
    def course_deg(self) -> float:
        """Course over ground [deg], 0 to 360, clockwise from north; noise at standstill."""
        return degrees(atan2(self.fix.velocity_n[1], self.fix.velocity_n[0])) % 360.0

    @property
    def horizontal_sd_m(self) -> float:
        """Horizontal accuracy estimate as u-blox defines it: root sum of squares of the north and east sd [m]."""
        return hypot(*self.fix.position_sd_n[:2])


def gps_ms(utc_ms: int) -> int:
    """GPS time since 1980-01-06 of a UTC time since 1970 [ms]."""
    return utc_ms - GPS_EPOCH_UNIX_MS + 1000 * LEAP_SECONDS
