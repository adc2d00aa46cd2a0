"""The errors of a solution relative to a reference, at the times of the reference."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.maths.earth import FloatArray, Geodetic, ned_track, wrap_angles
from shared.messages.base import Vector3

from ..attitude import rotations
from ..reference_track import Reference
from ..track import Track

Stamps = npt.NDArray[np.int64]
MAXIMUM_STEP_NS = 1_500_000_000  # longest interval between two solutions that is interpolated


@dataclass(frozen=True)
class Errors:
    """Solution minus reference at each time common to both; None for quantities that the reference does not hold."""

    stamps_ns: Stamps
    next_solution_ns: Stamps  # stamp of the later of the two interpolated solutions
    position_n: FloatArray | None  # [m, NED], shape (n, 3)
    position_sd_n: FloatArray  # [m, NED] of the difference, shape (n, 3)
    velocity_n: FloatArray | None  # [m/s, NED], shape (n, 3)
    attitude: FloatArray | None  # [rad] roll, pitch, yaw in (-pi, pi], shape (n, 3)
    angles: FloatArray | None = None  # [rad] roll, pitch, yaw of the solution, shape (n, 3)
    distance_m: FloatArray | None = None  # horizontal distance along the reference from its start, shape (n,)
    protection_m: FloatArray | None = None  # horizontal and vertical protection level, shape (n, 2)
    reference_sd_n: FloatArray | None = None  # [m, NED] standard deviation of the reference positions, shape (n, 3)

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def since(self, stamp_ns: int) -> "Errors":
        """The errors from a time on."""
        first = int(np.searchsorted(self.stamps_ns, stamp_ns, side="left"))

        def rest(values: FloatArray | None) -> FloatArray | None:
            return None if values is None else values[first:]

        return Errors(
            self.stamps_ns[first:],
            self.next_solution_ns[first:],
            rest(self.position_n),
            self.position_sd_n[first:],
            rest(self.velocity_n),
            rest(self.attitude),
            rest(self.angles),
            rest(self.distance_m),
            rest(self.protection_m),
            rest(self.reference_sd_n),
        )


def errors_against(reference: Reference, track: Track, *, lever_arm_b: Vector3) -> Errors:
    """Compare a solution with a reference.

    Parameters
    ----------
    reference : Reference
        Its times between two solutions are those of the result.
    track : Track
        Solutions at the IMU while the filter navigates.
    lever_arm_b : tuple of float
        [m, body] Lever arm from the IMU to the antenna; used if the reference is at the antenna.

    Returns
    -------
    Errors
        Solution minus reference.

    Notes
    -----
    Positions between two solutions are interpolated by the cubic Hermite polynomial of positions and velocities, and
    transformed to the antenna: r + C l, v + C (w x l). The variance of the difference is the sum of those of the
    solution and, if known, of the reference. A fix used by the filter is correlated with the solution; the sum is
    then too large.
    """
    then = reference.stamps_ns - reference.velocity_delay_ns  # times of validity of the velocities
    rows = np.flatnonzero(_covered(track, reference.stamps_ns) & _covered(track, then))
    state, earlier = _Between(track, reference.stamps_ns[rows]), _Between(track, then[rows])
    arm = np.array(lever_arm_b if reference.at_antenna else (0.0, 0.0, 0.0))
    sd = state.linear("position_sd_north_m")
    stated = None if reference.position_sd_n is None else reference.position_sd_n[rows]
    if stated is not None:
        sd = np.hypot(sd, stated)
    position = velocity = attitude = distance = None
    if reference.geodetic is not None and len(rows):
        distance = _distance(reference.geodetic)[rows]
        position = state.position_minus(reference.geodetic[rows]) + state.turned(arm)
    if reference.velocity_n is not None:
        velocity = earlier.linear("velocity_north_m_s") + earlier.arm_velocity(arm) - reference.velocity_n[rows]
    if reference.attitude is not None:
        attitude = wrap_angles(state.angles() - reference.attitude[rows])
    angles = None if attitude is None else state.angles()
    return Errors(
        reference.stamps_ns[rows],
        track.stamps_ns[state.after],
        position,
        sd,
        velocity,
        attitude,
        angles,
        distance,
        state.linear("protection_level_horizontal_m", 2),
        stated,
    )


def angles_at(track: Track, stamps_ns: Stamps) -> FloatArray:
    """Roll, pitch and yaw [rad] of a track at given times, shape (n, 3); outside it those of its first or last row."""
    angles = np.unwrap(track.columns("roll_rad"), axis=0)
    found: FloatArray = np.column_stack([np.interp(stamps_ns, track.stamps_ns, column) for column in angles.T])
    return found


def _distance(geodetic: FloatArray) -> FloatArray:
    """Cumulative horizontal distance along positions [m], shape (n,)."""
    path = ned_track(geodetic, Geodetic(*geodetic[len(geodetic) // 2].tolist()))
    steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
    distance: FloatArray = np.r_[0.0, np.cumsum(steps)]
    return distance


def _covered(track: Track, stamps_ns: Stamps) -> npt.NDArray[np.bool_]:
    """Whether each time lies between two solutions at most `MAXIMUM_STEP_NS` apart, shape (n,)."""
    after = np.searchsorted(track.stamps_ns, stamps_ns, side="left")
    inside = (after > 0) & (after < len(track))
    if len(track) > 1:
        step = np.diff(track.stamps_ns)[np.clip(after - 1, 0, len(track) - 2)]
        inside &= step <= MAXIMUM_STEP_NS
    return inside


class _Between:
    """A track interpolated at given times."""

    def __init__(self, track: Track, stamps_ns: Stamps) -> None:
        self._track = track
        self.after = np.searchsorted(track.stamps_ns, stamps_ns, side="left")
        self._before = self.after - 1
        first, last = track.stamps_ns[self._before], track.stamps_ns[self.after]
        self._step_s = (last - first) * 1e-9
        self._share = ((stamps_ns - first) / (last - first))[:, None]

    def linear(self, name: str, count: int = 3) -> FloatArray:
        """Adjacent columns, interpolated linearly, shape (n, count)."""
        values = self._track.columns(name, count)
        found: FloatArray = values[self._before] * (1.0 - self._share) + values[self.after] * self._share
        return found

    def angles(self) -> FloatArray:
        """Roll, pitch and yaw [rad], interpolated along the smaller angle, shape (n, 3)."""
        values = self._track.columns("roll_rad")
        turn = values[self.after] - values[self._before]
        turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
        found: FloatArray = values[self._before] + turn * self._share
        return found

    def turned(self, vector_b: FloatArray) -> FloatArray:
        """A body vector rotated to NED, shape (n, 3)."""
        turned: FloatArray = rotations(self.angles()).apply(vector_b)
        return turned

    def arm_velocity(self, arm_b: FloatArray) -> FloatArray:
        """Velocity of the antenna relative to the IMU, C (w x l), shape (n, 3)."""
        rates = self.linear("angular_rate_forward_rad_s")
        velocity: FloatArray = rotations(self.angles()).apply(np.cross(rates, arm_b))
        return velocity

    def position_minus(self, geodetic: FloatArray) -> FloatArray:
        """Interpolated position of the track minus given positions [m, NED], shape (n, 3)."""
        origin = Geodetic(*geodetic[len(geodetic) // 2].tolist())
        path = ned_track(self._track.geodetic, origin)
        u, h = self._share, self._step_s[:, None]
        p0, p1 = path[self._before], path[self.after]
        velocity = self._track.columns("velocity_north_m_s")
        v0, v1 = velocity[self._before], velocity[self.after]
        here = (
            p0 * (1.0 + 2.0 * u) * (1.0 - u) ** 2
            + v0 * h * u * (1.0 - u) ** 2
            + p1 * u**2 * (3.0 - 2.0 * u)
            + v1 * h * u**2 * (u - 1.0)
        )
        found: FloatArray = here - ned_track(geodetic, origin)
        return found
