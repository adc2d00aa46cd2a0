"""A solution as a table: one row per `NavigationSolution`."""

from array import array
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.maths.earth import FloatArray
from shared.messages.navigation import NavigationPhase, NavigationSolution

NED, FRD = ("north", "east", "down"), ("forward", "right", "down")
# The columns of `solution.csv` after stamp, time and phase: name and meaning.
COLUMNS: dict[str, str] = {
    "latitude_deg": "WGS-84 latitude of the IMU",
    "longitude_deg": "WGS-84 longitude of the IMU",
    "height_ellipsoid_m": "height of the IMU above the WGS-84 ellipsoid",
    **{f"velocity_{axis}_m_s": f"velocity of the IMU over ground, {axis}" for axis in NED},
    "roll_rad": "roll, positive right side down",
    "pitch_rad": "pitch, positive nose up",
    "yaw_rad": "heading, clockwise from north",
    **{f"position_sd_{axis}_m": f"standard deviation of the position, {axis}" for axis in NED},
    **{f"velocity_sd_{axis}_m_s": f"standard deviation of the velocity, {axis}" for axis in NED},
    **{f"attitude_sd_{axis}_rad": f"standard deviation of the attitude about {axis}" for axis in NED},
    **{f"angular_rate_{axis}_rad_s": f"angular rate about {axis}, bias removed" for axis in FRD},
    **{f"accelerometer_bias_{axis}_m_s2": f"estimated bias of the accelerometer, {axis}" for axis in FRD},
    **{f"gyroscope_bias_{axis}_rad_s": f"estimated bias of the gyroscope about {axis}" for axis in FRD},
    "protection_level_horizontal_m": "horizontal protection level: exceeded by the position error with the integrity "
    "risk",
    "protection_level_vertical_m": "vertical protection level",
    "stationary": "1 while standstill is detected",
    "gnss_age_s": "time since the last used fix; empty before the first",
}
NAMES = tuple(COLUMNS)
VALID = (NavigationPhase.NAVIGATING, NavigationPhase.COASTING, NavigationPhase.GNSS_ONLY)
DIAGONAL = (0, 3, 5)  # indices in an upper triangle stored row by row


class TrackBuilder:
    """Collects solutions as arrays: one hour at 100 Hz takes 130 MB (as messages 1 GB)."""

    def __init__(self) -> None:
        self._stamps, self._values = array("q"), array("d")
        self._phases: list[NavigationPhase] = []

    def add(self, s: NavigationSolution) -> None:
        """Append one solution."""
        self._stamps.append(s.sampled_ns)
        self._phases.append(s.phase)
        values = self._values
        values.extend((s.latitude_deg, s.longitude_deg, s.height_ellipsoid_m, *s.velocity_ned_m_s))
        values.extend((s.roll_rad, s.pitch_rad, s.yaw_rad))
        for covariance in (s.position_cov_ned_m2, s.velocity_cov_ned_m2_s2, s.attitude_cov_ned_rad2):
            values.extend(max(covariance[k], 0.0) ** 0.5 for k in DIAGONAL)
        values.extend((*s.angular_rate_body_rad_s, *s.accelerometer_bias_m_s2, *s.gyroscope_bias_rad_s))
        levels = (s.protection_level_horizontal_m, s.protection_level_vertical_m)
        values.extend(float("nan") if level is None else level for level in levels)
        values.extend((float(s.stationary), float("nan") if s.gnss_age_s is None else s.gnss_age_s))

    def track(self) -> "Track":
        """The collected solutions, sorted by their stamps."""
        stamps = np.array(self._stamps, dtype=np.int64)
        values = np.array(self._values, dtype=float).reshape(-1, len(NAMES))
        order = np.argsort(stamps, kind="stable")
        order = order[np.r_[np.diff(stamps[order]) > 0, True][: len(order)]]  # of equal stamps the last is kept
        return Track(stamps[order], [self._phases[k] for k in order.tolist()], values[order])


@dataclass(frozen=True)
class Track:
    """Stamps [ns], strictly increasing; phases; and one row of `NAMES` each."""

    stamps_ns: npt.NDArray[np.int64]
    phases: list[NavigationPhase]
    values: FloatArray

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def stamps_of(self, phase: NavigationPhase) -> list[int]:
        """Stamps [ns] of the solutions of a phase."""
        stamps = self.stamps_ns.tolist()
        return [at_ns for at_ns, navigation_phase in zip(stamps, self.phases, strict=True) if navigation_phase is phase]

    def columns(self, first: str, count: int = 3) -> FloatArray:
        """Adjacent columns from a name on, shape (rows, count)."""
        start = NAMES.index(first)
        found: FloatArray = self.values[:, start : start + count]
        return found

    @property
    def geodetic(self) -> FloatArray:
        """Latitude and longitude [rad] and height [m], shape (rows, 3)."""
        position = self.columns("latitude_deg")
        return np.column_stack([np.radians(position[:, :2]), position[:, 2]])

    def valid(self) -> "Track":
        """The part in which the filter navigates or coasts."""
        mask = np.array([phase in VALID for phase in self.phases], dtype=bool)
        return Track(self.stamps_ns[mask], [phase for phase in self.phases if phase in VALID], self.values[mask])
