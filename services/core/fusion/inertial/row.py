"""A row: everything of one filter that samples and updates change, as functions for plain and for compiled code.

Nothing of a row is changed in place, so that rows may share what they have in common: a snapshot is the row itself.
"""

from collections.abc import Sequence
from enum import IntEnum
from math import isfinite, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.errors import FilterDiverged
from shared.inertial.strapdown import InertialState, LocalEarth, corrected, local_earth
from shared.maths.compiled import compilable, inlined
from shared.maths.earth import Geodetic
from shared.maths.rotation import Vector

from . import error_model as em
from .propagation import HIGHEST_LATITUDE, MAX_SPEED_M_S, ZERO, ImuErrors, State
from .standstill import StandstillState, norm

FloatArray = npt.NDArray[np.float64]


class Fault(IntEnum):
    """Why the numbers of a row mean nothing any more."""

    NOTHING = 0
    COVARIANCE = 1
    NOT_FINITE = 2
    VELOCITY = 3
    LATITUDE = 4
    INNOVATION_COVARIANCE = 5
    INNOVATION = 6


# Text of each fault, and its cause as a word of `names.divergence` of core.fusion.
TEXTS = {
    Fault.COVARIANCE: ("the covariance is not positive", "covariance"),
    Fault.NOT_FINITE: ("the state is not finite", "not_finite"),
    Fault.VELOCITY: ("the velocity is implausible", "velocity"),
    Fault.LATITUDE: ("the position is too near a pole", "latitude"),
    Fault.INNOVATION_COVARIANCE: ("the covariance of an innovation is not positive definite", "covariance"),
    Fault.INNOVATION: ("an innovation is not finite", "covariance"),
}


class Row(NamedTuple):
    """State of one filter, and the covariance of its errors."""

    state: State
    P: FloatArray  # shape (n, n), in the order of `error_model`
    imu: ImuErrors
    parameters: FloatArray  # shape (n - 21,), of the aiding sensors, in the order of `error_model.PARAMETERS`
    position_correction: Vector  # [m, NED] sum of all corrections


def diverged(fault: int) -> FilterDiverged:
    """Exception of a fault."""
    text, cause = TEXTS[Fault(fault)]
    return FilterDiverged(text, cause)


@compilable
def vector_of(x: FloatArray, place: slice) -> Vector:
    """Three elements of an array, in plain floats."""
    k = place.start
    return float(x[k]), float(x[k + 1]), float(x[k + 2])


@compilable
def minus(old: Vector, errors: Vector) -> Vector:
    """Difference of a vector and its errors."""
    return old[0] - errors[0], old[1] - errors[1], old[2] - errors[2]


@inlined
def step_of(row: Row, noise: em.ProcessNoise) -> tuple[Row, FloatArray, FloatArray]:
    """Propagate the covariance to the instant of the state, P = Phi P Phi^T + Q, as the smoother needs it.

    Returns
    -------
    tuple
        The row, the block F t, shape (9, 21), and the decays of the errors, shape (n,).
    """
    state = row.state
    P, Ft, decay = em.propagated(
        row.P,
        state.quaternion,
        state.velocity,
        state.position,
        state.earth,
        state.velocity_gain_n,
        state.rotation_b,
        state.span_s,
        noise,
        noise.vibration_factor * state.rate_vibration_psd,
        noise.vibration_factor * state.force_vibration_psd,
    )
    parameters = decay[em.PARAMETERS] * row.parameters
    return Row(_without_span(state), P, row.imu, parameters, row.position_correction), Ft, decay


@inlined
def step(row: Row, noise: em.ProcessNoise) -> Row:
    """Propagate the covariance to the instant of the state."""
    return step_of(row, noise)[0]


@compilable
def mean_rate(state: State) -> tuple[Vector, float]:
    """Mean angular rate of a standstill since the last update, and its standard deviation by vibration."""
    (x, y, z), span_s = state.standstill_rotation_b, state.standstill_s
    return (x / span_s, y / span_s, z / span_s), sqrt(state.rate_vibration_psd / span_s)


@compilable
def subtracted(row: Row, x: FloatArray, P: FloatArray) -> Row:
    """Row after the errors x, shape (n,), were subtracted, true = estimated - x, with the covariance P after it."""
    state, imu = row.state, row.imu
    bias = vector_of(x, em.GYROSCOPE_BIAS)
    (a, b, c), (u, v, w) = vector_of(x, em.ATTITUDE), vector_of(x, em.VELOCITY)
    north, east, down = vector_of(x, em.POSITION)
    latitude, longitude, height = state.position
    inertial = InertialState(state.time_ns, state.quaternion, state.velocity, Geodetic(latitude, longitude, height))
    _, quaternion, velocity, position = corrected(inertial, (a, b, c, u, v, w, north, east, down))
    latitude, longitude, height = position
    rx, ry, rz = state.rate_b
    after = State(
        state.time_ns,
        quaternion,
        velocity,
        (latitude, longitude, height),
        local_earth(latitude),
        state.force,
        state.rate,
        (rx + bias[0], ry + bias[1], rz + bias[2]),
        state.acceleration_n,
        state.force_vibration_psd,
        state.rate_vibration_psd,
        state.span_s,
        state.velocity_gain_n,
        state.rotation_b,
        state.quiet,
        state.standstill_s,
        state.standstill_rotation_b,
        state.since_non_holonomic_s,
    )
    errors = ImuErrors(
        minus(imu.accelerometer_bias, vector_of(x, em.ACCELEROMETER_BIAS)),
        minus(imu.gyroscope_bias, bias),
        minus(imu.accelerometer_scale, vector_of(x, em.ACCELEROMETER_SCALE)),
        minus(imu.gyroscope_scale, vector_of(x, em.GYROSCOPE_SCALE)),
    )
    return Row(after, P, errors, row.parameters - x[em.PARAMETERS], minus(row.position_correction, (north, east, down)))


@compilable
def fault_of(row: Row) -> int:
    """Fault of a row: P is not finite with positive variances, or the state is implausible; 0 without one."""
    variances = np.ascontiguousarray(row.P.reshape(-1)[:: len(row.P) + 1])  # the diagonal
    if not (isfinite(variances @ variances) and variances[: em.ACCELEROMETER_SCALE.start].min() > 0.0):
        return Fault.COVARIANCE.value
    return implausible(row.state)


@compilable
def implausible(state: State) -> int:
    """Fault of a state that violates the plausibility limits, or 0."""
    (qw, qx, qy, qz), (north, east, down), (latitude, longitude, height) = (
        state.quaternion,
        state.velocity,
        state.position,
    )
    if not isfinite(qw + qx + qy + qz + north + east + down + latitude + longitude + height):
        return Fault.NOT_FINITE.value
    if norm(state.velocity) >= MAX_SPEED_M_S:
        return Fault.VELOCITY.value
    return Fault.LATITUDE.value if abs(latitude) >= HIGHEST_LATITUDE else Fault.NOTHING.value


@compilable
def begun(state: State, standstill: bool) -> State:
    """State with which a new interval between two updates begins: of zero velocity, or of the constraint."""
    return State(
        state.time_ns,
        state.quaternion,
        state.velocity,
        state.position,
        state.earth,
        state.force,
        state.rate,
        state.rate_b,
        state.acceleration_n,
        state.force_vibration_psd,
        state.rate_vibration_psd,
        state.span_s,
        state.velocity_gain_n,
        state.rotation_b,
        state.quiet,
        0.0 if standstill else state.standstill_s,
        ZERO if standstill else state.standstill_rotation_b,
        state.since_non_holonomic_s if standstill else 0.0,
    )


@compilable
def _without_span(state: State) -> State:
    """State with which a new interval between two covariance steps begins."""
    return State(
        state.time_ns,
        state.quaternion,
        state.velocity,
        state.position,
        state.earth,
        state.force,
        state.rate,
        state.rate_b,
        state.acceleration_n,
        state.force_vibration_psd,
        state.rate_vibration_psd,
        0.0,
        ZERO,
        ZERO,
        state.quiet,
        state.standstill_s,
        state.standstill_rotation_b,
        state.since_non_holonomic_s,
    )


PARAMETERS = 67  # place of the parameters in the values of `Numbers`


class Numbers(NamedTuple):
    """A row as arrays: compiled code is slow at reading and making tuples of Python."""

    time_ns: int
    values: FloatArray  # all but time and P, in the order of the members
    P: FloatArray


@compilable
def three(v: Sequence[float] | FloatArray, k: int) -> Vector:
    """Three elements of an array from a place on, in plain floats."""
    return float(v[k]), float(v[k + 1]), float(v[k + 2])


@compilable
def row_of(time_ns: int, v: Sequence[float] | FloatArray, P: FloatArray, parameters: FloatArray) -> Row:
    """Row of its time, the values before its parameters, P and the parameters: the inverse of `packed`."""
    earth = LocalEarth(float(v[10]), float(v[11]), float(v[12]), float(v[13]), float(v[14]), float(v[15]))
    quiet = StandstillState(three(v, 37), three(v, 40), float(v[43]), three(v, 44))
    state = State(
        time_ns,
        (float(v[0]), float(v[1]), float(v[2]), float(v[3])),
        three(v, 4),
        three(v, 7),
        earth,
        three(v, 16),
        three(v, 19),
        three(v, 22),
        three(v, 25),
        float(v[28]),
        float(v[29]),
        float(v[30]),
        three(v, 31),
        three(v, 34),
        quiet,
        float(v[47]),
        three(v, 48),
        float(v[51]),
    )
    imu = ImuErrors(three(v, 52), three(v, 55), three(v, 58), three(v, 61))
    return Row(state, P, imu, parameters, three(v, 64))


@compilable
def packed(row: Row) -> Numbers:
    """Arrays of a row."""
    state, imu, earth, quiet = row.state, row.imu, row.state.earth, row.state.quiet
    values = (
        *state.quaternion, *state.velocity, *state.position,
        earth.sin_latitude, earth.cos_latitude, earth.meridian_radius, earth.transverse_radius, earth.gravity,
        earth.gravity_slope, *state.force, *state.rate, *state.rate_b, *state.acceleration_n,
        state.force_vibration_psd, state.rate_vibration_psd, state.span_s, *state.velocity_gain_n, *state.rotation_b,
        *quiet.rate, *quiet.acceleration, quiet.quiet_s, *quiet.reference,
        state.standstill_s, *state.standstill_rotation_b, state.since_non_holonomic_s,
        *imu.accelerometer_bias, *imu.gyroscope_bias, *imu.accelerometer_scale, *imu.gyroscope_scale,
        *row.position_correction,
    )  # fmt: skip
    return Numbers(state.time_ns, np.concatenate((np.array(values), row.parameters)), row.P)
