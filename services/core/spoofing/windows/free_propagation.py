"""Velocity by inertial sensors, odometer and non-holonomic constraint from an anchor on, without GNSS.

Error state, 21 elements: velocity and attitude (NED), accelerometer and gyroscope bias (body), scale of the odometer,
yaw and pitch of the forward axis in the body frame, scale of the gyroscopes, whose error is a share of the total turn
and no random walk, and the way since the anchor (NED). An estimate is corrected at once: x_true = x + error, and for
the attitude C_true = (I + sk(psi)) C.

All propagations take the same increments, so that they advance as one stack.
"""

from collections.abc import Sequence
from math import inf

import numpy as np
import numpy.typing as npt

from shared.inertial.increments import Increment
from shared.maths.earth import STANDARD_GRAVITY
from shared.maths.kalman import consider, correct, predict
from shared.maths.quantiles import chi_square_limit
from shared.maths.rotation import quaternion_from_rotation_vector, quaternion_product, skew

from ..inertial import propagation
from ..inertial.anchors import FilterAnchor
from ..inertial.propagation import carried, matrices, table_of
from ..inertial.tracks import OdometerSpeed
from ..settings import Settings

FloatArray = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]

VELOCITY, ATTITUDE, ACCELEROMETER, GYROSCOPE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
MOUNTING = slice(12, 15)
SCALE, YAW, PITCH = 12, 13, 14
GYROSCOPE_SCALE = slice(15, 18)
MOVED = slice(18, 21)
ANCHORED = slice(0, 15)  # states that fusion's filter has as well
SIZE = 21
UNIT, UNIT_STATES = np.eye(3), np.eye(SIZE)
STANDSTILL_SD = 0.02  # [m/s]
# [m/s] of the forward speed, above which the non-holonomic constraint is not used: the products of the errors of speed
# and direction, which its linear form leaves out, are then as large as its own noise.
MAX_SPEED_SD = 2.0
FASTEST_REVERSE_M_S = 2.0  # forward speed below its negative is that of a run which has lost its direction
MIN_ODOMETER = 10  # speeds that aid a propagation, before it speaks for the odometer
ODOMETER_REJECTIONS = 3  # in a row, after which this propagation no longer uses it
# Of a vehicle that is driven: how fast force and rate change, of which the trapezoidal rule over a gap knows the ends.
JERK_M_S3, ANGULAR_ACCELERATION_RAD_S2 = 2.0, 0.2
NODES = 30  # increments, 3 s, in which the fixes lie that are compared
RUN = np.dtype(
    [
        ("anchor_ns", np.int64),
        ("state", np.float64, propagation.STATE),
        ("mounting", np.float64, 3),  # see FilterAnchor
        ("moved_n", np.float64, 3),  # [m, NED] way of the antenna since the anchor
        ("P", np.float64, (SIZE, SIZE)),
        ("acceleration_n", np.float64, 3),  # [m/s²] mean of the last second
        ("odometer_rejections", np.int64),
        ("odometer_updates", np.int64),
        ("nodes", np.float64, (NODES, 6)),  # [m/s, m; NED] velocity of the antenna and its way; NaN before the anchor
        # Integrals since the last step of the covariance:
        ("attitude", np.float64, (3, 3)),  # [s]
        ("force_n", np.float64, 3),  # [m/s]
        ("angle_b", np.float64, 3),  # [rad]
        ("elapsed_s", np.float64),
    ]
)
INTEGRALS = ("attitude", "force_n", "angle_b", "elapsed_s")


class FreePropagations:
    """Propagations from several anchors: nominal by increments, covariance and aiding once a second."""

    def __init__(self, settings: Settings) -> None:
        s = self._settings = settings.long
        self._axle_m = settings.rear_axle_distance_m
        self._lever_arm = skew(settings.vehicle.gnss.lever_arm_body_m)
        self.runs = np.zeros(0, RUN)  # oldest anchor first
        self.end_ns = 0  # of the newest increment
        self._nodes_ns = np.zeros(NODES, np.int64)
        self._gate = chi_square_limit(1, s.odometer_gate)
        self._constraint_gate = chi_square_limit(2, s.odometer_gate)
        sds = [s.velocity_sd_m_s, s.attitude_sd_rad, s.accelerometer_bias_sd_m_s2, s.gyroscope_bias_sd_rad_s]
        self._added = np.diag(np.r_[np.repeat(sds, 3), s.odometer_scale_sd, s.mounting_sd_rad, s.mounting_sd_rad] ** 2)

    def start(self, anchor: FilterAnchor) -> None:
        """Start a propagation; its anchor is later than all others."""
        run = np.zeros(1, RUN)
        run["anchor_ns"], run["state"], run["mounting"] = anchor.time_ns, anchor.state, anchor.mounting
        run["P"][:, ANCHORED, ANCHORED] = anchor.covariance + self._added
        run["P"][:, GYROSCOPE_SCALE, GYROSCOPE_SCALE] = UNIT * self._settings.gyroscope_scale_sd**2
        run["nodes"] = np.nan
        self.runs = np.concatenate([self.runs, run])

    def odometer_agrees(self, run: int) -> bool:
        """Whether the odometer has aided a propagation, and does not contradict it."""
        return bool(self.runs["odometer_updates"][run] >= MIN_ODOMETER and not self.runs["odometer_rejections"][run])

    def advance(self, increments: Sequence[Increment]) -> None:
        """Propagate attitudes, velocities and ways by some increments, at most `NODES`."""
        runs, count = self.runs, len(increments)
        self.end_ns = increments[-1].end_ns
        ends_ns = [increment.end_ns for increment in increments]
        self._nodes_ns = np.concatenate([self._nodes_ns[count:], ends_ns])
        table = table_of(increments)
        duration = table[:, propagation.DURATION]
        steps = carried(runs["state"], table)
        starts = np.concatenate([runs["state"][:, None, propagation.MOTION], steps[..., propagation.MOTION]], axis=1)
        C = matrices(starts[..., propagation.QUATERNION])
        rates = table[:, propagation.RATE]
        runs["attitude"] += (duration @ C[:, :-1].reshape(len(runs), count, 9)).reshape(-1, 3, 3)
        runs["force_n"] += duration @ steps[..., propagation.FORCE]
        runs["angle_b"] += duration @ rates
        runs["elapsed_s"] += duration.sum()
        lever_velocity = rates @ self._lever_arm  # w x l
        velocity = steps[..., propagation.VELOCITY] + np.matvec(C[:, 1:], lever_velocity)
        newest = runs["nodes"][:, -1:, :3]
        before = np.concatenate([np.where(np.isnan(newest), velocity[:, :1], newest), velocity[:, :-1]], axis=1)
        moved = runs["moved_n"][:, None] + np.cumsum(0.5 * duration[:, None] * (before + velocity), axis=1)
        nodes = np.concatenate([velocity, moved], axis=-1)
        runs["nodes"] = np.concatenate([runs["nodes"][:, count:], nodes], axis=1)
        runs["moved_n"] = moved[:, -1]
        for gap_s in (increment.row[propagation.DURATION] for increment in increments if increment.bridges):
            self._bridge(gap_s)
        runs["state"][:, propagation.MOTION] = steps[:, -1, propagation.MOTION]

    def _bridge(self, gap_s: float) -> None:
        """Add what is not known of the motion over a gap [s] in the inertial samples."""
        velocity_sd, attitude_sd = (0.5 * change * gap_s**2 for change in (JERK_M_S3, ANGULAR_ACCELERATION_RAD_S2))
        self.runs["P"][:, VELOCITY, VELOCITY] += UNIT * velocity_sd**2
        self.runs["P"][:, ATTITUDE, ATTITUDE] += UNIT * attitude_sd**2
        self.runs["P"][:, MOVED, MOVED] += UNIT * (velocity_sd * gap_s) ** 2

    def nodes_at(self, time_ns: int, passed_ns: int) -> FloatArray:
        """Velocity of the antenna [m/s, NED] and way [m, NED] at a time, shape (n, 6).

        NaN where it is not known by two increments or more, of those until the one that ends at `passed_ns`.
        """
        nodes, times = self.runs["nodes"], self._nodes_ns
        after = int(np.searchsorted(times, time_ns))
        if time_ns > passed_ns or after == NODES or (after == 0 and times[0] != time_ns):
            return np.full((len(nodes), 6), np.nan)
        found: FloatArray = nodes[:, after]
        if times[after] != time_ns:
            share = (time_ns - times[after - 1]) / (times[after] - times[after - 1])
            found = nodes[:, after - 1] + share * (found - nodes[:, after - 1])
        second_last = nodes[:, int(np.searchsorted(times, passed_ns)) - 1]
        return np.where(np.isnan(second_last), np.nan, found)

    def predict(self) -> None:
        """Propagate the covariances over the increments since the last call: P+ = Phi P Phi' + Q.

        Notes
        -----
        With dv the integral of the specific force (NED), C the mean attitude, T the time, a the turn (body)::

            dv_err' = -sk(dv) psi - C T db_a,    psi' = -C T db_g - C diag(a) dk_g,
            r_err' = T v_err,    Phi = I + F + F²/2
        """
        s, runs = self._settings, self.runs
        attitude, force, T = runs["attitude"], runs["force_n"], runs["elapsed_s"]
        F = np.zeros((len(runs), SIZE, SIZE))
        F[:, VELOCITY, ATTITUDE] = -_skews(force)
        F[:, VELOCITY, ACCELEROMETER] = F[:, ATTITUDE, GYROSCOPE] = -attitude
        F[:, MOVED, VELOCITY] = UNIT * T[:, None, None]
        F[:, ATTITUDE, GYROSCOPE_SCALE] = -attitude * (runs["angle_b"] / T[:, None])[:, None, :]
        level = force + np.array([0.0, 0.0, STANDARD_GRAVITY]) * T[:, None]
        force_variance = s.velocity_random_walk_m_s_sqrt_s**2 * T + s.scale_sd**2 * (level**2).sum(axis=1)
        Q = np.zeros((len(runs), SIZE, SIZE))
        Q[:, VELOCITY, VELOCITY] = UNIT * force_variance[:, None, None]
        Q[:, ATTITUDE, ATTITUDE] = UNIT * (s.angle_random_walk_rad_sqrt_s**2 * T)[:, None, None]
        runs["P"] = predict(runs["P"], UNIT_STATES + F + 0.5 * F @ F, Q)
        runs["acceleration_n"] = level / T[:, None]
        for name in INTEGRALS:
            runs[name] = 0.0

    def aid(self, odometer: OdometerSpeed | None, yaw_rate: float) -> None:
        """Use the odometer's speed and the non-holonomic constraint.

        Parameters
        ----------
        odometer : OdometerSpeed or None
            At the time of the last increment, None without one.
        yaw_rate : float
            [rad/s] By which the lateral velocity of the IMU differs from that of the rear axle.

        Notes
        -----
        With v_b = C' v, residuals r = H error and the variances R::

            s u - v_bx = 0,    v_by - yaw v_bx = 0,    v_bz + pitch v_bx = 0
            H of v_b: [C', C' sk(v)]

        Their errors are correlated over `correlation_s`; R is multiplied by it, for one update a second. The constraint
        is used while the standard deviation of v_bx is at most `MAX_SPEED_SD` and its innovation is within the
        gate. Its linear form leaves out the product of the errors of speed and direction, whose variance is part of R::

            var(v_bx) (var(direction of the mounting) + var(attitude))

        Without an odometer the mounting is considered and not estimated (Schmidt): only a speed tells it from tilt.
        """
        s = self._settings
        if odometer is not None:
            self._use_speed(odometer)
        if not s.non_holonomic:
            return
        velocity, H, _ = self.body_velocities()
        forward = H[:, 0]
        variance = np.vecdot(np.vecmat(forward, self.runs["P"]), forward)
        rows = np.flatnonzero(variance <= MAX_SPEED_SD**2)
        (ahead, *across), H = velocity[rows].T, H[rows, 1:]
        yaw, pitch = self.runs["mounting"][rows, 1:].T
        H[:, 0, YAW], H[:, 1, PITCH] = -ahead, ahead
        z = np.stack([yaw * ahead, -pitch * ahead], axis=-1) - np.stack(across, axis=-1)
        R = np.zeros((len(rows), 2, 2))
        spread = np.diagonal(self.runs["P"][rows], axis1=1, axis2=2)
        attitude = spread[:, ATTITUDE].mean(axis=1)
        fixed = s.lateral_sd_m_s**2 + (self._axle_m * yaw_rate) ** 2, s.vertical_sd_m_s**2
        for k, place in enumerate((YAW, PITCH)):
            R[:, k, k] = (fixed[k] + variance[rows] * (spread[:, place] + attitude)) * s.correlation_s
        self._correct(rows, z, H, R, self._constraint_gate, considered=None if odometer is not None else MOUNTING)

    def _use_speed(self, odometer: OdometerSpeed) -> None:
        s, runs = self._settings, self.runs
        rows = np.flatnonzero(runs["odometer_rejections"] < ODOMETER_REJECTIONS)
        velocity, H, C = (values[rows] for values in self.body_velocities())
        change = np.vecdot(C[..., 0], runs["acceleration_n"][rows])
        fixed = s.odometer_sd_m_s**2 + odometer.resolution**2 / 12.0
        if odometer.speed == 0.0 and odometer.resolution > 0.0:
            fixed += s.odometer_dead_zone_m_s**2
        H[:, 0, SCALE] = -odometer.speed
        z = runs["mounting"][rows, :1] * odometer.speed - velocity[:, :1]
        variance = (fixed + (s.odometer_time_sd_s * change) ** 2) * s.correlation_s
        used = self._correct(rows, z, H[:, :1], variance[:, None, None], self._gate)
        runs["odometer_rejections"][rows] += 1
        runs["odometer_rejections"][used] = 0
        runs["odometer_updates"][used] += 1

    def stand(self) -> None:
        """Use zero velocity at a standstill that the inertial samples show."""
        velocity = self.runs["state"][:, propagation.VELOCITY]
        self._correct(np.arange(len(velocity)), -velocity, np.eye(3, SIZE), UNIT * STANDSTILL_SD**2)

    def lost(self) -> list[int]:
        """Rows of propagations that drive backwards faster than a vehicle does: they have lost their direction."""
        state = self.runs["state"]
        ahead_n = matrices(state[:, propagation.QUATERNION])[..., 0]
        return np.flatnonzero(np.vecdot(ahead_n, state[:, propagation.VELOCITY]) < -FASTEST_REVERSE_M_S).tolist()

    def body_velocities(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Velocities [m/s, body], shape (n, 3), their derivatives by the error states, (n, 3, 21), and attitudes C."""
        C, v = matrices(self.runs["state"][:, propagation.QUATERNION]), self.runs["state"][:, propagation.VELOCITY]
        H = np.zeros((len(v), 3, SIZE))
        H[..., VELOCITY] = C.mT
        H[..., ATTITUDE] = C.mT @ _skews(v)
        return np.vecmat(v, C), H, C

    def _correct(
        self,
        rows: Rows,
        z: FloatArray,
        H: FloatArray,
        R: FloatArray,
        gate: float = inf,
        considered: slice | None = None,
    ) -> Rows:
        """Add the errors that a measurement shows to the nominal values; give the propagations that have used it.

        States that are `considered` keep their values and their covariance.
        """
        P = self.runs["P"][rows]
        found = correct(P, z, H, R)
        used = np.asarray(found.distance2 <= gate)
        if considered is not None:
            found = consider(P, found, R, considered)
        rows, error = rows[used], found.x[used]
        self.runs["P"][rows] = found.P[used]
        state = self.runs["state"][rows]
        state[:, propagation.VELOCITY] += error[:, VELOCITY]
        turned = [
            quaternion_product(quaternion_from_rotation_vector((north, east, down)), (w, x, y, z))
            for (north, east, down), (w, x, y, z) in zip(
                error[:, ATTITUDE].tolist(), state[:, propagation.QUATERNION].tolist(), strict=True
            )
        ]
        state[:, propagation.QUATERNION] = np.reshape(turned, (-1, 4))
        state[:, propagation.ACCELEROMETER_BIAS] += error[:, ACCELEROMETER]
        state[:, propagation.GYROSCOPE_BIAS] += error[:, GYROSCOPE]
        state[:, propagation.GYROSCOPE_SCALE] += error[:, GYROSCOPE_SCALE]
        self.runs["state"][rows] = state
        self.runs["moved_n"][rows] += error[:, MOVED]
        self.runs["mounting"][rows] += error[:, MOUNTING]
        return rows


def _skews(vectors: FloatArray) -> FloatArray:
    """Matrices sk(a), shape (n, 3, 3), of the vector products with vectors, shape (n, 3)."""
    found = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    found[:, 0, 1], found[:, 0, 2], found[:, 1, 2] = -z, y, -x
    return found - found.mT
