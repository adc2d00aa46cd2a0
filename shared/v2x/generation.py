"""Generation rules of the CAM: when a vehicle sends, 1 to 10 times a second (EN 302 637-2 V1.4.1 clause 6.1.3)."""

from dataclasses import dataclass
from math import degrees, hypot

from ..maths.earth import Geodetic, ned_from_geodetic_difference, wrap_angle

NS_PER_MS = 1_000_000
MIN_PERIOD_NS = 100 * NS_PER_MS  # T_GenCamMin, and T_GenCam_Dcc without congestion control
MAX_PERIOD_NS = 1000 * NS_PER_MS  # T_GenCamMax
LOW_FREQUENCY_PERIOD_NS = 500 * NS_PER_MS
PERIODIC_CAMS = 3  # N_GenCam: consecutive CAM by time alone after which the period is the longest again
HEADING_CHANGE_DEG = 4.0
POSITION_CHANGE_M = 4.0
SPEED_CHANGE_M_S = 0.5
CHECK_JITTER_NS = 10 * NS_PER_MS  # of the instants at which the rules are checked: 10 checks a second give 10 CAM


@dataclass(frozen=True)
class Dynamics:
    """What the rules compare with the last CAM; a heading that is not known is None."""

    time_ns: int
    position: Geodetic
    heading_rad: float | None
    speed_m_s: float


@dataclass(frozen=True)
class Generation:
    """Decision to send a CAM now."""

    low_frequency: bool  # with the low-frequency container


class GenerationRules:
    """State of the rules of one vehicle.

    A CAM is due when at least 100 ms have passed since the last one and heading, position or speed have changed by
    more than 4 degrees, 4 m or 0.5 m/s (the time since the last CAM then becomes the period T_GenCam), or when the
    period has passed. After three CAM by the period alone it returns to 1 s.
    """

    def __init__(self) -> None:
        self._last: Dynamics | None = None
        self._period_ns = MAX_PERIOD_NS
        self._periodic = 0
        self._low_frequency_ns: int | None = None

    def check(self, now: Dynamics) -> Generation | None:
        """Decide whether a CAM is due; to be called about every 100 ms or more often."""
        if self._last is not None and now.time_ns < self._last.time_ns - MAX_PERIOD_NS:
            self._last = self._low_frequency_ns = None  # the time line began anew
        if self._last is not None:
            elapsed_ns = now.time_ns - self._last.time_ns + CHECK_JITTER_NS
            if elapsed_ns < MIN_PERIOD_NS:
                return None
            if _has_changed(now, self._last):
                self._period_ns = min(max(elapsed_ns - CHECK_JITTER_NS, MIN_PERIOD_NS), MAX_PERIOD_NS)
                self._periodic = 0
            elif elapsed_ns < self._period_ns:
                return None
            else:
                self._periodic += 1
                if self._periodic >= PERIODIC_CAMS:
                    self._period_ns = MAX_PERIOD_NS
        self._last = now
        last_ns = self._low_frequency_ns
        # No tolerance here: the container comes at the earliest 500 ms after the last one, also if a check is late.
        low_frequency = last_ns is None or now.time_ns - last_ns >= LOW_FREQUENCY_PERIOD_NS
        if low_frequency:
            self._low_frequency_ns = now.time_ns
        return Generation(low_frequency)


def _has_changed(now: Dynamics, last: Dynamics) -> bool:
    north, east, _ = ned_from_geodetic_difference(now.position, last.position)
    turned = (
        now.heading_rad is not None
        and last.heading_rad is not None
        and abs(degrees(wrap_angle(now.heading_rad - last.heading_rad))) > HEADING_CHANGE_DEG
    )
    return turned or hypot(north, east) > POSITION_CHANGE_M or abs(now.speed_m_s - last.speed_m_s) > SPEED_CHANGE_M_S
