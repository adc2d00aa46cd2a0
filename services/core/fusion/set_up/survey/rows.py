"""What is measured along arcs, as rows of a least squares: innovation, and derivatives by what is unknown."""

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from ..motion import Motion
from ..regression import FloatArray
from .arcs import START, STEP_S, Path, skews

IntArray = npt.NDArray[np.int64]

# Places of what is the same in all arcs.
FORCE_BIAS, RATE_BIAS, ARM, DELAY, VELOCITY_LAG, TURN, AXLE, RATIO, WHEEL_LAG, SLIP = (
    slice(0, 3), slice(3, 6), slice(6, 9), 9, 10, slice(11, 14), slice(14, 16), 16, 17, 18,
)  # fmt: skip
SHARED = 19
POSITION_S, VELOCITY_S, CONSTRAINT_S = 0.45, 0.18, 0.5  # least time between two rows of a kind
ROLLING_M_S = 2.0  # from here on wheels do not slide sideways
STRAIGHT_M_S2 = 0.5  # of lateral acceleration, up to which a body on springs does not roll
LATERAL_M_S2, ALONG_M_S2 = 1.0, 0.5  # accelerations at which side slip, and the slip of wheels, double the spread
FULL_CIRCLE = 2.0 * np.pi


@dataclass(frozen=True)
class Unknowns:
    """What is the same in all arcs, in the axes of the vehicle as they are believed.

    Attributes
    ----------
    force_bias, rate_bias : ndarray, shape (3,)
        [m/s², rad/s; body]
    arm : ndarray, shape (3,)
        [m, body] From the IMU to the antenna.
    delay_s, velocity_lag_s : float
        [s] By which positions are older than their stamps, and velocities than positions.
    axle : ndarray, shape (2,)
        [m, body] From the IMU to the rear axle, forward and right.
    ratio : float
        Of the speed of the wheels to the true one.
    wheel_lag_s, slip : float
        [s, 1/(m/s²)] By which speeds of the wheels are early, and the change of their ratio with acceleration.
    matrix : ndarray, shape (3, 3)
        Columns are the vehicle's axes in those with which the search began.
    """

    force_bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    rate_bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    arm: FloatArray = field(default_factory=lambda: np.zeros(3))
    delay_s: float = 0.0
    velocity_lag_s: float = 0.0
    axle: FloatArray = field(default_factory=lambda: np.zeros(2))
    ratio: float = 1.0
    wheel_lag_s: float = 0.0
    slip: float = 0.0
    matrix: FloatArray = field(default_factory=lambda: np.eye(3))

    def changed(self, step: FloatArray, turn: FloatArray) -> "Unknowns":
        """After a step, shape (19,), with axes turned by a rotation, whose columns are the new axes in the old ones."""
        return replace(
            self,
            force_bias=turn.T @ (self.force_bias + step[FORCE_BIAS]),
            rate_bias=turn.T @ (self.rate_bias + step[RATE_BIAS]),
            arm=turn.T @ (self.arm + step[ARM]),
            delay_s=self.delay_s + float(step[DELAY]),
            velocity_lag_s=self.velocity_lag_s + float(step[VELOCITY_LAG]),
            axle=self.axle + step[AXLE],
            ratio=self.ratio + float(step[RATIO]),
            wheel_lag_s=self.wheel_lag_s + float(step[WHEEL_LAG]),
            slip=self.slip + float(step[SLIP]),
            matrix=self.matrix @ turn,
        )


@dataclass(frozen=True)
class Rows:
    """Rows of one kind: arc, innovation, derivatives by its start and by what is shared, and relative spread."""

    arc: IntArray  # shape (m,)
    z: FloatArray  # shape (m,)
    start: FloatArray  # shape (m, 15)
    shared: FloatArray  # shape (m, 19)
    spread: FloatArray  # shape (m,)


@dataclass(frozen=True)
class Moments:
    """States of arcs at some of their times, with their sensitivities; n of them."""

    arc: IntArray
    attitude: FloatArray  # shape (n, 3, 3)
    velocity: FloatArray
    position: FloatArray
    rate: FloatArray
    force: FloatArray
    attitude_by: FloatArray  # shape (n, 3, 15)
    velocity_by: FloatArray
    position_by: FloatArray

    @property
    def lateral(self) -> FloatArray:
        """[m/s²] Acceleration to the right, by speed and rate of turn; shape (n,)."""
        turning: FloatArray = np.hypot(self.velocity[:, 0], self.velocity[:, 1]) * self.rate[:, 2]
        return turning

    @property
    def body_velocity(self) -> FloatArray:
        """[m/s, body] shape (n, 3)."""
        found: FloatArray = np.einsum("nji,nj->ni", self.attitude, self.velocity)
        return found

    def body_velocity_by(self) -> FloatArray:
        """Derivatives of the velocity in body axes by start and biases, shape (n, 3, 15)."""
        back = self.attitude.transpose(0, 2, 1)
        found: FloatArray = back @ (self.velocity_by + skews(self.velocity) @ self.attitude_by)
        return found


def moments_of(path: Path, arc: IntArray, after: FloatArray) -> Moments:
    """Interpolate arcs at times after their begin [s], shape (n,)."""
    place = np.clip((after / STEP_S).astype(np.int64), 0, path.velocity.shape[1] - 2)
    share = after / STEP_S - place

    def of(values: FloatArray) -> FloatArray:
        weight = share.reshape(-1, *([1] * (values.ndim - 2)))
        found: FloatArray = (1.0 - weight) * values[arc, place] + weight * values[arc, place + 1]
        return found

    return Moments(
        arc, of(path.attitude), of(path.velocity), of(path.position), of(path.rate), of(path.force),
        of(path.attitude_by), of(path.velocity_by), of(path.position_by),
    )  # fmt: skip


def positions(motion: Motion, begins: FloatArray, path: Path, of: Unknowns) -> list[Rows]:
    """Positions of the antenna: on ground, and of height."""
    chosen, arc, after = _within(begins, path, motion.positions[:, 0] - of.delay_s, POSITION_S)
    at = moments_of(path, arc, after)
    arm = np.einsum("nij,j->ni", at.attitude, of.arm)
    z = motion.positions[chosen, 1:] - at.position - arm
    by = at.position_by - skews(arm) @ at.attitude_by
    shared = _shared(by, RATE_BIAS.stop)
    shared[..., ARM] = at.attitude
    shared[..., DELAY] = -at.velocity
    return [_rows(at, z[:, axes], by[:, axes], shared[:, axes]) for axes in (slice(0, 2), slice(2, 3))]


def velocities(motion: Motion, begins: FloatArray, path: Path, of: Unknowns) -> list[Rows]:
    """Velocities of the antenna: on ground, and vertical."""
    chosen, arc, after = _within(begins, path, motion.velocities[:, 0] - of.delay_s - of.velocity_lag_s, VELOCITY_S)
    at = moments_of(path, arc, after)
    swing = at.attitude @ skews(at.rate)
    moved = swing @ of.arm
    z = motion.velocities[chosen, 1:] - at.velocity - moved
    by = at.velocity_by - skews(moved) @ at.attitude_by
    shared = _shared(by, RATE_BIAS.stop)
    shared[..., ARM] = swing
    shared[..., DELAY] = shared[..., VELOCITY_LAG] = -(at.force + np.array([0.0, 0.0, 9.81]))
    known = np.isfinite(z[:, 2])
    return [
        _rows(at, z[:, :2], by[:, :2], shared[:, :2]),
        _rows(_chosen(at, known), z[known, 2:], by[known, 2:], shared[known, 2:]),
    ]


def constraints(begins: FloatArray, path: Path, of: Unknowns) -> list[Rows]:
    """Wheels roll along the vehicle, and neither sideways nor off the road; a body is level on average."""
    steps = np.arange(CONSTRAINT_S, path.span_s, CONSTRAINT_S)
    arc = np.repeat(np.arange(len(begins)), len(steps))
    at = moments_of(path, arc, np.tile(steps, len(begins)))
    at = _chosen(at, at.body_velocity[:, 0] > ROLLING_M_S)
    v, w = at.body_velocity, at.rate
    by = at.body_velocity_by()
    shared = _shared(by, RATE_BIAS.stop)
    # v - turn x v, of the axle, sideways and down
    shared[:, 1, TURN] = np.column_stack([v[:, 2], np.zeros(len(v)), -v[:, 0]])
    shared[:, 2, TURN] = np.column_stack([-v[:, 1], v[:, 0], np.zeros(len(v))])
    shared[:, 1, AXLE.start] = w[:, 2]
    shared[:, 2, AXLE.start], shared[:, 2, AXLE.start + 1] = -w[:, 1], w[:, 0]
    z = -np.column_stack([
        v[:, 1] + w[:, 2] * of.axle[0], v[:, 2] - w[:, 1] * of.axle[0] + w[:, 0] * of.axle[1],
    ])  # fmt: skip
    spread = 1.0 + np.abs(at.lateral) / LATERAL_M_S2
    rolling = [_rows(at, z[:, [k]], by[:, [k + 1]], shared[:, [k + 1]], spread) for k in (0, 1)]
    return [*rolling, *_level(at, len(begins))]


def speeds(motion: Motion, begins: FloatArray, path: Path, of: Unknowns) -> list[Rows]:
    """Speeds of the wheels."""
    chosen, arc, after = _within(begins, path, motion.speeds[:, 0], CONSTRAINT_S)
    at = moments_of(path, arc, after)
    wheel = np.abs(motion.speeds[chosen, 1])
    rolling = (at.body_velocity[:, 0] > ROLLING_M_S) & (wheel > ROLLING_M_S)
    at, wheel = _chosen(at, rolling), wheel[rolling]
    ahead = at.body_velocity[:, 0] - at.rate[:, 2] * of.axle[1]
    pushed = np.einsum("nji,nj->ni", at.attitude, at.force + np.array([0.0, 0.0, 9.81]))[:, 0]
    seen = ahead + pushed * (of.wheel_lag_s + of.slip * ahead)
    by = of.ratio * at.body_velocity_by()[:, :1]
    shared = _shared(by, RATE_BIAS.stop)
    shared[:, 0, AXLE.start + 1] = -of.ratio * at.rate[:, 2]
    shared[:, 0, TURN.start + 1] = -of.ratio * at.body_velocity[:, 2]
    shared[:, 0, TURN.start + 2] = of.ratio * at.body_velocity[:, 1]
    shared[:, 0, RATIO], shared[:, 0, WHEEL_LAG], shared[:, 0, SLIP] = (
        seen,
        of.ratio * pushed,
        of.ratio * pushed * ahead,
    )
    spread = 1.0 + np.abs(pushed) / ALONG_M_S2 + np.abs(at.lateral) / LATERAL_M_S2
    return [_rows(at, (wheel - of.ratio * seen)[:, np.newaxis], by, shared, spread)]


def _level(at: Moments, arcs: int) -> list[Rows]:
    """Mean roll and pitch of the vehicle in each arc, where it does not lean in a bend."""
    straight = _chosen(at, np.abs(at.lateral) < STRAIGHT_M_S2)
    counts = np.bincount(straight.arc, minlength=arcs)
    arc = np.flatnonzero(counts)
    found = []
    for axis in (1, 0):  # the right axis points down by the roll, the forward axis up by the pitch
        lean = straight.attitude[:, 2, axis]
        by = np.zeros((len(lean), START))
        row = straight.attitude[:, [1, 0], axis] * np.array([1.0, -1.0])  # of [phi x] C, last row
        by += row[:, :1] * straight.attitude_by[:, 0] + row[:, 1:] * straight.attitude_by[:, 1]
        z, mean_by = (_means(values, straight.arc, arcs)[arc] for values in (-lean[:, np.newaxis], by))
        shared = _shared(mean_by[:, np.newaxis], RATE_BIAS.stop)
        shared[:, 0, TURN.start + 1 - axis] = 1.0 if axis == 1 else -1.0
        found.append(Rows(arc, z[:, 0], mean_by[:, :START], shared[:, 0], np.ones(len(arc))))
    return found


def _means(values: FloatArray, group: IntArray, groups: int) -> FloatArray:
    sums = np.zeros((groups, values.shape[1]))
    np.add.at(sums, group, values)
    found: FloatArray = sums / np.maximum(np.bincount(group, minlength=groups), 1)[:, np.newaxis]
    return found


def _within(begins: FloatArray, path: Path, times: FloatArray, least_s: float) -> tuple[IntArray, IntArray, FloatArray]:
    """Measurements inside arcs, at least a time apart: their places, arcs, and times after the begin [s]."""
    arc = np.searchsorted(begins, times, side="right") - 1
    after = times - begins[np.maximum(arc, 0)]
    inside = (arc >= 0) & (after >= 0.0) & (after <= path.span_s - 2.0 * STEP_S)
    slot = np.floor(times / least_s + 1e-6)
    first = np.concatenate([[True], np.diff(slot) > 0]) if len(slot) else np.zeros(0, dtype=bool)
    chosen = np.flatnonzero(inside & first)
    return chosen, arc[chosen], after[chosen]


def _chosen(at: Moments, which: npt.NDArray[np.bool_]) -> Moments:
    return Moments(*(values[which] for values in vars(at).values()))


def _shared(by: FloatArray, biases: int) -> FloatArray:
    """Derivatives by what is shared, of which those by the biases are known; shape (n, rows, 19)."""
    found = np.zeros((*by.shape[:2], SHARED))
    found[..., :biases] = by[..., START - biases :]
    return found


def _rows(at: Moments, z: FloatArray, by: FloatArray, shared: FloatArray, spread: FloatArray | None = None) -> Rows:
    width = z.shape[1]
    spreads = np.ones(len(z)) if spread is None else spread
    return Rows(
        np.repeat(at.arc, width), z.ravel(), by[..., :START].reshape(-1, START), shared.reshape(-1, SHARED),
        np.repeat(spreads, width),
    )  # fmt: skip
