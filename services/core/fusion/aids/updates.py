"""Updates that come ten times a second, as functions on a row for plain and for compiled code.

Zero velocity and zero angular rate at standstill, the non-holonomic constraint, and speeds of the wheels: those whose
gate has no other consequence than the use of an observation, and of a speed the inflation while it is rejected. All
other measurements, and these where somebody looks at each step, go through `Aids`.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.compiled import compilable, inlined
from shared.maths.quantiles import chi_square_limit
from shared.maths.rotation import Vector

from ..inertial import error_model as em
from ..inertial.filter import inflated_along
from ..inertial.row import Row
from ..settings import Settings
from .non_holonomic import aid as non_holonomic
from .non_holonomic.aid import ConstraintModel, constraint
from .odometer import aid as odometer
from .odometer.aid import OdometerModel, speed_observation
from .odometer.inflation import INFLATION_M_S_SQRT_S, inflation_after
from .rear_axle import MOUNTING, rear_axle
from .standstill.aid import zero_rate, zero_velocity

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Columns of a record of an update: time since the begin of the call [ns], which, what became of it, test ratio,
# dimension, innovation, its standard deviations, and the estimated errors of attitude and of the horizontal velocity.
AFTER, KIND, VERDICT, RATIO, AXES, INNOVATION, SDS, ERRORS = 0, 1, 2, 3, 4, 5, 8, 11
COLUMNS = ERRORS + em.LEVEL.stop
ZERO_VELOCITY, ZERO_ANGULAR_RATE, NON_HOLONOMIC, ODOMETER = 0, 1, 2, 3  # kinds
COVARIANCE, NOTHING_DUE, NO_UPDATE = 4, 5, 6  # what is no update
USED, BEYOND_GATE, UNFIT, EXCLUDED = 0, 1, 2, 3  # verdicts


DOUBT, EXCLUSION, IGNORED = 3, 4, 5  # columns of the readings of speeds
NO_OBSERVATION = np.zeros(1), np.zeros((1, em.SIZE)), np.zeros((1, 1))


class Model(NamedTuple):
    """What these updates know of vehicle and settings."""

    arm_b: Vector  # [m, body] of the rear axle
    constraint: ConstraintModel
    odometer: OdometerModel
    limits: tuple[float, float, float]  # [-] chi-square limits of one to three dimensions


class Speeds(NamedTuple):
    """Speeds of the wheels in the order of their stamps, up to the next other measurement."""

    times_ns: IntArray
    readings: FloatArray  # [m/s] shape (n, 6): speed, resolution, exact, in doubt, excluded, ignored
    stand_until_ns: IntArray  # the wheels are known to stand up to this time, after each of them
    due_ns: int  # stamp of the other measurement


class Standing(NamedTuple):
    """What speeds have left behind."""

    wheels_until_ns: int  # the wheels are known to stand
    inflation_ns: int  # next inflation while speeds are rejected


def model_of(settings: Settings) -> Model:
    """Model of the settings."""
    false_alarm = settings.gating.false_alarm_probability
    one, two, three = (chi_square_limit(axes, false_alarm) for axes in (1, 2, 3))
    arm = settings.vehicle.rear_axle_body_m or (0.0, 0.0, 0.0)
    return Model(arm, non_holonomic.model_of(settings), odometer.model_of(settings), (one, two, three))


@compilable
def record(  # a row of numbers
    columns: FloatArray,
    after_ns: int,
    kind: int,
    verdict: int,
    ratio: float,
    z: FloatArray,
    S: FloatArray,
    x: FloatArray,
) -> None:
    """Write the record of an observation into a row of the table."""
    axes = len(z)
    columns[AFTER], columns[KIND], columns[VERDICT] = after_ns, kind, verdict
    columns[RATIO], columns[AXES] = ratio, axes
    for k in range(axes):
        columns[INNOVATION + k], columns[SDS + k] = z[k], sqrt(S[k, k])
    columns[ERRORS:] = x[em.LEVEL]


@compilable
def axle_of(row: Row, model: Model) -> tuple[FloatArray, FloatArray]:
    """Velocity of the rear axle, and the matrix of its errors: see `rear_axle`."""
    state, first = row.state, MOUNTING.start - em.DRIVING
    pitch, yaw = float(row.parameters[first]), float(row.parameters[first + 1])
    return rear_axle(state.quaternion, state.velocity, state.rate_b, model.arm_b, pitch, yaw)


@inlined
def observation(
    kind: int, row: Row, readings: FloatArray, place: int, rate: Vector, rate_sd: float, model: Model
) -> tuple[FloatArray, FloatArray, FloatArray, bool]:
    """Innovation z, matrix H and covariance R of an update, and whether a zero in doubt must not be used."""
    state, unsure = row.state, False
    if kind == ZERO_VELOCITY:
        z, H, R = zero_velocity(state.velocity)
    elif kind == ZERO_ANGULAR_RATE:
        z, H, R = zero_rate(rate, rate_sd, state.quaternion, state.position[0])
    elif kind == NON_HOLONOMIC:
        ahead, axle_H = axle_of(row, model)
        z, H, R = constraint(ahead, axle_H, state.rate_b, model.constraint)
    elif kind == ODOMETER:
        reading = float(readings[place, 0]), float(readings[place, 1]), bool(readings[place, 2] > 0.0)
        z, H, R, unsure = speed_observation(axle_of(row, model), row, reading, model.odometer)
    else:
        z, H, R = NO_OBSERVATION
    return np.ascontiguousarray(z), em.fitting(H, row.P), np.ascontiguousarray(R), unsure


@inlined
def inflated(row: Row, inflation_ns: int, H: FloatArray, rejected: bool) -> tuple[Row, int]:
    """Inflate the velocity along the vehicle, once a second, while speeds are rejected for long."""
    inflation_ns, due = inflation_after(row.state.time_ns, inflation_ns, rejected)
    if due:
        P = inflated_along(row.P, em.VELOCITY, INFLATION_M_S_SQRT_S * H[0, em.VELOCITY])
        row = Row(row.state, P, row.imu, row.parameters, row.position_correction)
    return row, inflation_ns
