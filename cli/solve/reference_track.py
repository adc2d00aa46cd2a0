"""The reference of a solution: fixes at the antenna, true states, or the table of another system."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from shared.errors import UserError
from shared.maths.earth import FloatArray
from shared.messages.base import Vector3
from shared.messages.gnss import CarrierSolution, GnssFix
from shared.messages.navigation import TruthState

MIN_OFFSET_NS = 500_000_000
POSITION = ("latitude_deg", "longitude_deg", "height_ellipsoid_m")
VELOCITY = ("velocity_north_m_s", "velocity_east_m_s", "velocity_down_m_s")
ATTITUDE = ("roll_rad", "pitch_rad", "yaw_rad")


@dataclass(frozen=True)
class Reference:
    """The truth or its substitute; unknown quantities are None."""

    description: str
    stamps_ns: npt.NDArray[np.int64]
    at_antenna: bool  # otherwise at the IMU
    geodetic: FloatArray | None = None  # [rad, rad, m], shape (n, 3)
    velocity_n: FloatArray | None = None  # [m/s, NED], shape (n, 3)
    attitude: FloatArray | None = None  # [rad] roll, pitch, yaw, shape (n, 3)
    position_sd_n: FloatArray | None = None  # [m, NED], shape (n, 3)
    velocity_delay_ns: int = 0  # delay of the velocities relative to the stamps
    in_utc: bool = False  # stamps are UTC, otherwise of the unit's time line

    def on_time_line(self, utc_offset_ns: int) -> "Reference":
        """Give the stamps on the unit's time line, by UTC less that line.

        Offsets below half a second are those of delays, which are estimated or set, and not of a clock.
        """
        if not self.in_utc or abs(utc_offset_ns) < MIN_OFFSET_NS:
            return self
        return replace(self, stamps_ns=self.stamps_ns - utc_offset_ns, in_utc=False)

    def only(self, quantities: Sequence[str]) -> "Reference":
        """Keep only the given quantities."""
        return replace(
            self,
            geodetic=self.geodetic if "position" in quantities else None,
            velocity_n=self.velocity_n if "velocity" in quantities else None,
            attitude=self.attitude if "attitude" in quantities else None,
        )


def from_fixes(fixes: Sequence[GnssFix], *, delay_s: float = 0.0, velocity_delay_s: float = 0.0) -> Reference:
    """Use the RTK-fixed positions and velocities as truth, those removed by an outage included.

    `delay_s` is the delay of a fix, `velocity_delay_s` the additional delay of its velocity, as in the vehicle file.
    """
    found: Counter[str] = Counter()
    kept = []
    for fix in fixes:
        found[fix.carrier_solution] += 1
        if fix.carrier_solution == CarrierSolution.FIXED and None not in (fix.latitude_deg, fix.height_ellipsoid_m):
            kept.append(fix)
    if not kept:
        words = ", ".join(f"{count} {word}" for word, count in found.items()) or "no fix at all"
        raise UserError(
            f"no fix of the recording has RTK quality and a height above the ellipsoid ({words}); "
            "give the truth as a CSV file with --truth FILE, or solve without: --truth none"
        )
    velocities = [fix.velocity_ned_m_s for fix in kept]
    deviations = [fix.position_sd_ned_m for fix in kept]
    return Reference(
        f"{len(kept)} RTK-fixed GNSS positions of the antenna, of {len(fixes)} fixes; not independent of the solution",
        np.array([fix.sampled_ns for fix in kept], dtype=np.int64) - round(delay_s * 1e9),
        at_antenna=True,
        geodetic=_geodetic([[fix.latitude_deg, fix.longitude_deg, fix.height_ellipsoid_m] for fix in kept]),
        velocity_n=None if None in velocities else np.array(velocities),
        position_sd_n=None if None in deviations else np.array(deviations),
        velocity_delay_ns=round(velocity_delay_s * 1e9),
    )


def from_states(states: Sequence[TruthState], *, at_antenna: bool = False) -> Reference:
    """Use recorded true states as truth; a quantity that a state lacks is unknown."""
    if not states:
        raise UserError("the recording holds no truth/state; try --truth fixes, or a CSV file with --truth FILE")
    return Reference(
        f"{len(states)} true states of the recording",
        np.array([s.sampled_ns for s in states], dtype=np.int64),
        at_antenna=at_antenna,
        geodetic=_geodetic([[s.latitude_deg, s.longitude_deg, s.height_ellipsoid_m] for s in states]),
        velocity_n=_complete([s.velocity_ned_m_s for s in states]),
        attitude=_complete([s.attitude_rad for s in states]),
    )


def from_columns(
    name: str, stamps_ns: npt.NDArray[np.int64], columns: dict[str, FloatArray], *, in_utc: bool = False
) -> Reference:
    """Use the columns of a CSV file, named as those of `solution.csv`, as truth."""

    def together(names: tuple[str, ...]) -> FloatArray | None:
        return np.column_stack([columns[n] for n in names]) if all(n in columns for n in names) else None

    position = together(POSITION)
    return Reference(
        f"{len(stamps_ns)} rows of {name}",
        stamps_ns,
        at_antenna=False,
        geodetic=None if position is None else _geodetic(position),
        velocity_n=together(VELOCITY),
        attitude=together(ATTITUDE),
        in_utc=in_utc,
    )


def _complete(rows: Sequence[Vector3 | None]) -> FloatArray | None:
    known = [row for row in rows if row is not None]
    return np.array(known) if len(known) == len(rows) else None


def _geodetic(rows: FloatArray | list[list[float | None]]) -> FloatArray:
    values = np.array(rows, dtype=float)
    values[:, :2] = np.radians(values[:, :2])
    return values
