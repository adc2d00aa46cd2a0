"""The errors of the receiver's own positions, and those of the solution at the same times."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.maths.earth import FloatArray, Geodetic, ned_track
from shared.messages.base import Vector3
from shared.messages.gnss import GnssFix
from shared.messages.navigation import NavigationPhase

from ..reference_track import Reference
from ..track import NAMES, Track
from .errors import angles_at, errors_against

WORSE_RATIO = 1.02  # ratio of root mean squares above which the solution is called worse: less is chance


@dataclass(frozen=True)
class GnssAlone:
    """Errors at the antenna [m, NED], shape (n, 3), at the times of validity of the fixes."""

    stamps_ns: npt.NDArray[np.int64]
    gnss_n: FloatArray  # the down component is NaN for a fix without height
    solution_n: FloatArray

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def since(self, stamp_ns: int) -> "GnssAlone":
        """The errors from a time on."""
        rows = self.stamps_ns >= stamp_ns
        return GnssAlone(self.stamps_ns[rows], self.gnss_n[rows], self.solution_n[rows])


def gnss_alone(
    fixes: Sequence[GnssFix], reference: Reference, track: Track, *, lever_arm_b: Vector3, delay_s: float
) -> GnssAlone | None:
    """Compare fixes and solution with the truth, both at the antenna and at the times of validity of the fixes.

    Parameters
    ----------
    fixes : sequence of GnssFix
        The positions given to the filter.
    reference : Reference
        The truth; not the fixes themselves.
    track : Track
        Solutions at the IMU while the filter navigates.
    lever_arm_b : tuple of float
        [m, body] Lever arm from the IMU to the antenna.
    delay_s : float
        [s] Delay of the stamps of the fixes, as configured; what the filter estimates beyond it is not removed.

    Returns
    -------
    GnssAlone or None
        None without a true position. Fixes outside the truth, or in a gap of it, are omitted.

    Notes
    -----
    The truth is interpolated to the fixes by the cubic Hermite polynomial of its positions and velocities (without
    velocities: central differences of the positions), and transformed to the antenna by its own attitude; a truth
    without attitude by that of the solution, whose error of a few degrees moves an arm of 1 m by centimetres. ::

        gnss     = fix - (r_true + C_true l)
        solution = (r + C l) - (r_true + C_true l)
    """
    found = [fix for fix in fixes if fix.latitude_deg is not None and fix.longitude_deg is not None]
    if reference.geodetic is None or len(reference.stamps_ns) < 2 or not found:
        return None
    stamps = np.array([fix.sampled_ns for fix in found], dtype=np.int64) - round(delay_s * 1e9)
    heights = np.array([np.nan if fix.height_ellipsoid_m is None else fix.height_ellipsoid_m for fix in found])
    usual = reference.geodetic[len(reference.geodetic) // 2, 2]  # a height of a fix without one; its error is omitted
    horizontal = np.radians(np.array([[fix.latitude_deg, fix.longitude_deg] for fix in found], dtype=float))
    positions = np.column_stack([horizontal, np.where(np.isnan(heights), usual, heights)])
    at_antenna = Reference("fixes", stamps, at_antenna=True, geodetic=positions)
    truth = _as_track(reference, track)
    true = errors_against(at_antenna, truth, lever_arm_b=(0.0, 0.0, 0.0) if reference.at_antenna else lever_arm_b)
    fused = errors_against(at_antenna, track, lever_arm_b=lever_arm_b)
    common, of_true, of_fused = np.intersect1d(true.stamps_ns, fused.stamps_ns, return_indices=True)
    if not len(common) or true.position_n is None or fused.position_n is None:
        return None
    gnss = -true.position_n[of_true]
    solution = fused.position_n[of_fused] + gnss
    without_height = np.isin(common, stamps[np.isnan(heights)])
    gnss[without_height, 2] = np.nan
    return GnssAlone(common, gnss, solution)


def _as_track(reference: Reference, track: Track) -> Track:
    """The truth as a track, with its unknown velocity and attitude filled as described in `gnss_alone`."""
    stamps, rows = np.unique(reference.stamps_ns, return_index=True)
    geodetic = np.asarray(reference.geodetic)[rows]
    values = np.full((len(stamps), len(NAMES)), np.nan)
    values[:, _slice("latitude_deg")] = np.column_stack([np.degrees(geodetic[:, :2]), geodetic[:, 2]])
    values[:, _slice("velocity_north_m_s")] = (
        _velocities(stamps, geodetic) if reference.velocity_n is None else reference.velocity_n[rows]
    )
    values[:, _slice("roll_rad")] = angles_at(track, stamps) if reference.attitude is None else reference.attitude[rows]
    return Track(stamps, [NavigationPhase.NAVIGATING] * len(stamps), values)


def _slice(name: str) -> slice:
    return slice(NAMES.index(name), NAMES.index(name) + 3)


def _velocities(stamps_ns: npt.NDArray[np.int64], geodetic: FloatArray) -> FloatArray:
    """Velocities [m/s, NED] by differences of the positions, shape (n, 3)."""
    path = ned_track(geodetic, Geodetic(*geodetic[len(geodetic) // 2].tolist()))
    velocities: FloatArray = np.gradient(path, (stamps_ns - stamps_ns[0]) * 1e-9, axis=0)
    return velocities
