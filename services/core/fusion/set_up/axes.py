"""Axes and mounting of the IMU, by gravity, by accelerations and by turns of GNSS.

Over an interval, with a the acceleration of the speed, v the speed and chi' the rate of the course by GNSS, an IMU
measures, with the columns of M the vehicle's axes forward, right, down in published axes::

    mean f = M (a, v chi', 0) - g m_3 + noise        mean w = m_3 chi' + bias + noise

M should be the identity. Its first two columns follow by least squares, the third from the direction of gravity. With
axes swapped or mirrored M is near another signed permutation, with a skewed mount it is a rotation.
"""

from dataclasses import dataclass, field
from functools import partial
from math import atan2, degrees, hypot, radians

import numpy as np
import numpy.typing as npt

from shared.maths.earth import STANDARD_GRAVITY
from shared.messages.explanation import explain
from shared.runtime.config import Matrix3
from shared.runtime.old_keys import MOUNTING

from ..codes import Code, Direction
from .findings import Check, Verdict, matrix_text
from .motion import Intervals, Motion
from .regression import Fit, least_squares, nearest_permutation

FloatArray = npt.NDArray[np.float64]

AXES = (Direction.FORWARD, Direction.RIGHT, Direction.DOWN)
OPPOSITE = (Direction.BACKWARD, Direction.LEFT, Direction.UP)
MIN_INTERVALS = 20  # intervals
LEVELLED_S = 20.0  # of samples that tell the direction of gravity
COLUMN_SD = 0.2  # of a column of M that is known
RATE_SD = 0.1  # of the response of the gyroscopes to a turn
EXPLAINED = 0.6  # share of the variance of the rate along the axis of turns that the course explains
MARGIN = 0.8  # by which tr(PᵀM) of another permutation must exceed that of the identity
GAIN = (0.5, 1.6)  # length of a column of M that is of this motion: a car pitches and rolls with its accelerations
SIGNIFICANCE_SDS = 5.0
BIAS_SDS = 3.0
FORCE_LIMIT = 0.1  # relative error of the mean specific force against gravity
RATE_LIMIT = 0.25  # relative error of the gyroscopes against the course
TILT_SD = radians(1.5)  # of roll and pitch by gravity, averaged over slopes and bends of a drive
UPRIGHT = 0.7  # cosine of the tilt beyond which `check_upright` has the finding
SKEWED = radians(9.0)  # of a mount beyond the default prior (3 degrees, three standard deviations)


@dataclass(frozen=True)
class AxesFit:
    """M as far as it is known, with standard deviations, and the response of the gyroscopes to turns."""

    gravity: float  # [m/s²] size of the mean specific force
    down: FloatArray  # direction of gravity, shape (3,)
    columns: FloatArray | None = None  # of M, shape (3, 3)
    sd: float = 0.0  # largest of the first two columns
    turn: FloatArray | None = None  # response of the gyroscopes [-], shape (3,)
    turn_sd: float = 0.0
    bias: FloatArray | None = None  # [rad/s, body] of the gyroscopes, shape (3,)
    bias_sd: float = 0.0
    present: FloatArray = field(default_factory=lambda: np.eye(3))  # mounting with which the published axes were made


def fit_axes(motion: Motion, intervals: Intervals | None, present: Matrix3) -> AxesFit | None:
    """Estimate M; None while gravity is not known. `present` is the mounting that the vehicle's file states."""
    span = motion.nodes[-1] - motion.nodes[0] - (motion.gaps[-1] - motion.gaps[0])
    if span < LEVELLED_S:
        return None
    force = (motion.integrals[:3, -1] - motion.integrals[:3, 0]) / (motion.nodes[-1] - motion.nodes[0])
    gravity = float(np.linalg.norm(force))
    if gravity < 1e-3:
        return None
    fit = AxesFit(gravity, -force / gravity, present=np.array(present))
    if intervals is None:
        return fit
    turning = np.isfinite(intervals.course_rate)
    a, lateral, rate = intervals.acceleration[turning], intervals.lateral[turning], intervals.course_rate[turning]
    one = np.ones_like(a)
    forces = (
        least_squares(np.column_stack([a, lateral, one]), intervals.force[turning]) if len(a) >= MIN_INTERVALS else None
    )
    rates = least_squares(np.column_stack([rate, one]), intervals.rate[turning]) if len(a) >= MIN_INTERVALS else None
    if rates is not None and np.corrcoef(intervals.rate[turning] @ rates.coefficients[0], rate)[0, 1] ** 2 < EXPLAINED:
        rates = None
    return _with_fits(fit, forces, rates)


def _with_fits(fit: AxesFit, forces: Fit | None, rates: Fit | None) -> AxesFit:
    columns, sd, turn, turn_sd, bias, bias_sd = None, 0.0, None, 0.0, None, 0.0
    if forces is not None and float(forces.sd[:2].max()) < COLUMN_SD:
        down = -forces.coefficients[2] / np.linalg.norm(forces.coefficients[2])
        columns, sd = (
            np.column_stack([forces.coefficients[0], forces.coefficients[1], down]),
            float(forces.sd[:2].max()),
        )
    if rates is not None and float(rates.sd[0].max()) < RATE_SD * max(
        1.0, float(np.linalg.norm(rates.coefficients[0]))
    ):
        turn, turn_sd = rates.coefficients[0], float(rates.sd[0].max())
        bias, bias_sd = rates.coefficients[1], float(rates.sd[1].max())
    return AxesFit(fit.gravity, fit.down, columns, sd, turn, turn_sd, bias, bias_sd, fit.present)


def check_accelerometer_scale(fit: AxesFit | None) -> Check:
    """Compare the mean specific force with gravity."""
    name = "accelerometer_scale"
    if fit is None:
        return Check(name)
    ratio = fit.gravity / STANDARD_GRAVITY
    agrees = abs(ratio - 1.0) <= FORCE_LIMIT
    code = Code.FORCE_IS_GRAVITY if agrees else Code.FORCE_IS_NOT_GRAVITY
    why = explain(code, force_m_s2=fit.gravity, ratio=ratio)
    return Check(name, Verdict.AGREES if agrees else Verdict.CONTRADICTS, why, ratio, None, 1.0, FORCE_LIMIT)


def check_upright(fit: AxesFit | None) -> Check:
    """Compare the direction of gravity with the axis down."""
    name = "imu_upright"
    if fit is None:
        return Check(name)
    tilt = degrees(float(np.arccos(np.clip(fit.down[2], -1.0, 1.0))))
    if tilt <= 45.0:
        return Check(name, Verdict.AGREES, explain(Code.UPRIGHT, tilt_deg=tilt), tilt, None, 0.0, 45.0, "deg")
    why = explain(Code.UPSIDE_DOWN if tilt > 135.0 else Code.ON_ITS_SIDE, axis=axis_name(fit.down), tilt_deg=tilt)
    return Check(name, Verdict.CONTRADICTS, why, tilt, None, 0.0, 45.0, "deg", _axes_setting(fit))


def check_axes(fit: AxesFit | None) -> Check:
    """Find the signed permutation of the axes that agrees with gravity and the accelerations of GNSS."""
    name = "imu_axes"
    if fit is None or fit.columns is None or not _is_motion(fit.columns):
        return Check(name)
    best, gap = nearest_permutation(fit.columns)
    if np.array_equal(best, np.eye(3)):
        return Check(name, Verdict.AGREES, explain(Code.AXES_AGREE, sd_ratio=fit.sd), gap, fit.sd, 0.0, MARGIN)
    if gap < max(MARGIN, SIGNIFICANCE_SDS * fit.sd):
        return Check(name)
    code = Code.AXES_SWAPPED if np.linalg.det(best) > 0.0 else Code.AXES_MIRRORED
    forward, right, down = (axis_name(best[:, place]) for place in range(3))
    why = explain(code, forward=forward, right=right, down=down)
    turned = best[2, 2] == 1.0 and np.linalg.det(best) > 0.0
    turn = _turn(fit) if turned else None
    return Check(name, Verdict.CONTRADICTS, why, gap, fit.sd, 0.0, MARGIN, "-", _axes_setting(fit), turn)


def check_mounting(fit: AxesFit | None, limit_rad: float) -> Check:
    """Find a mount that is askew beyond what the filter assumes: in roll and pitch by gravity alone, if need be."""
    name = "imu_mounting"
    if fit is None or fit.down[2] < UPRIGHT:
        return Check(name)
    known = fit.columns is not None and _is_motion(fit.columns)
    if known and not np.array_equal(nearest_permutation(_columns(fit))[0], np.eye(3)):
        return Check(name)
    limit = max(SKEWED, limit_rad)
    R = mounting_of(_columns(fit)) if known else tilt_of(fit.down)
    yaw, pitch = atan2(R[1, 0], R[0, 0]), -atan2(R[2, 0], hypot(R[0, 0], R[1, 0]))
    roll = atan2(R[2, 1], R[2, 2])
    tilt = max(abs(roll), abs(pitch))
    seen = [(tilt, TILT_SD)]
    askew = partial(explain, roll_deg=degrees(-roll), pitch_deg=degrees(-pitch))
    why = askew(Code.TILTED)
    if known:
        seen.append((abs(yaw), fit.sd))
        why = askew(Code.MOUNTED_ASKEW, yaw_deg=degrees(-yaw), sd_deg=degrees(fit.sd))
    size, sd = max(seen)
    values = degrees(size), degrees(sd), 0.0, degrees(limit), "deg"
    if any(value >= limit + 3.0 * its_sd for value, its_sd in seen):
        correction = matrix_text(R.T @ fit.present)
        turn = _turn(fit) if known and abs(yaw) >= limit + 3.0 * fit.sd else None
        return Check(name, Verdict.CONTRADICTS, why, *values, f"{MOUNTING} = {correction}", turn)
    return Check(name, Verdict.AGREES if known and size < limit else Verdict.UNKNOWN, why, *values)


def check_gyroscope(fit: AxesFit | None) -> Check:
    """Compare the response of the gyroscopes to turns with the direction of gravity, in size and sense."""
    name = "gyroscope_axes"
    if fit is None or fit.turn is None:
        return Check(name)
    size = float(np.linalg.norm(fit.turn))
    gain, sd = float(fit.down @ fit.turn), fit.turn_sd
    values = gain, sd, 1.0, RATE_LIMIT
    if gain < 0.5 * size:
        why = explain(Code.TURNS_ABOUT_ANOTHER_AXIS, ratio=gain, axis=axis_name(fit.turn / size))
        why = explain(Code.TURNS_REVERSED, ratio=gain) if gain < -0.7 * size else why
        return Check(name, Verdict.CONTRADICTS, why, *values)
    if abs(size - 1.0) > RATE_LIMIT + SIGNIFICANCE_SDS * sd:
        code = Code.TURNS_IN_DEGREES if 40.0 < size < 80.0 else Code.TURNS_OF_ANOTHER_SIZE
        return Check(name, Verdict.CONTRADICTS, explain(code, ratio=size), *values)
    return Check(name, Verdict.AGREES, explain(Code.TURNS_AGREE, ratio=gain, sd_ratio=sd), *values)


def check_gyroscope_bias(fit: AxesFit | None, assumed_sd: float) -> Check:
    """Compare the gyroscope bias, by the course, with its prior."""
    name = "gyroscope_bias"
    if fit is None or fit.bias is None or fit.bias_sd > radians(0.5):
        return Check(name)
    size = float(np.abs(fit.bias).max())
    x, y, z = np.degrees(fit.bias).tolist()
    why = explain(Code.GYROSCOPE_BIASES, x_deg_s=x, y_deg_s=y, z_deg_s=z)
    values = degrees(size), degrees(fit.bias_sd), 0.0, degrees(BIAS_SDS * assumed_sd), "deg/s"
    if size < BIAS_SDS * assumed_sd + 3.0 * fit.bias_sd:
        return Check(name, Verdict.AGREES, why, *values)
    setting = f"core.fusion.imu.gyroscope_bias_sd_rad_s = {size:.2g}"
    return Check(name, Verdict.CONTRADICTS, why, *values, setting)


def forward_of(fit: AxesFit | None) -> FloatArray | None:
    """Direction forward in published axes, shape (3,), of length one; None while it is not known."""
    if fit is None or fit.columns is None or not _is_motion(fit.columns):
        return None
    ahead: FloatArray = fit.columns[:, 0] / np.linalg.norm(fit.columns[:, 0])
    return ahead


def mounting_of(columns: FloatArray) -> FloatArray:
    """Rotation from vehicle to published axes next to M: its third column, and the first across it; shape (3, 3)."""
    down = columns[:, 2] / np.linalg.norm(columns[:, 2])
    ahead = columns[:, 0] - (columns[:, 0] @ down) * down
    across = columns[:, 1] - (columns[:, 1] @ down) * down
    handed = 1.0 if np.linalg.det(columns) > 0.0 else -1.0
    ahead = ahead + handed * np.cross(across, down)
    ahead /= np.linalg.norm(ahead)
    return np.column_stack([ahead, handed * np.cross(down, ahead), down])


def tilt_of(down: FloatArray) -> FloatArray:
    """Rotation from vehicle to published axes by the direction of gravity, with forward in its plane; shape (3, 3)."""
    ahead = np.array([1.0, 0.0, 0.0]) - down[0] * down
    ahead /= np.linalg.norm(ahead)
    return np.column_stack([ahead, np.cross(down, ahead), down])


def axis_name(direction: FloatArray) -> Direction:
    """Nearest axis to a direction."""
    place = int(np.argmax(np.abs(direction)))
    return AXES[place] if direction[place] > 0.0 else OPPOSITE[place]


def _turn(fit: AxesFit) -> tuple[float, float]:
    """Turn of the vehicle's axes about the published axis down, and its standard deviation [rad]."""
    R = mounting_of(_columns(fit))
    return atan2(R[1, 0], R[0, 0]), fit.sd


def _columns(fit: AxesFit) -> FloatArray:
    assert fit.columns is not None
    return fit.columns


def _is_motion(columns: FloatArray) -> bool:
    return all(GAIN[0] < float(np.linalg.norm(columns[:, place])) < GAIN[1] for place in (0, 1))


def _axes_setting(fit: AxesFit) -> str | None:
    """Setting that turns published axes into those of the vehicle: exact where axes are only swapped."""
    if fit.columns is None or not _is_motion(fit.columns):
        return None
    best, _ = nearest_permutation(fit.columns)
    swapped = not np.array_equal(best, np.eye(3))
    correction = best.T if swapped else mounting_of(fit.columns).T
    return f"{MOUNTING} = {matrix_text(correction @ fit.present)}"
