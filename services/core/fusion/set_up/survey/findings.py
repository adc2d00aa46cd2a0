"""From what a drive has shown of an installation to changes of settings: nothing where it is not known well enough."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from math import degrees, hypot

import numpy as np

from shared.runtime.old_keys import MOUNTING as MOUNTING_KEY

from ...settings import Settings
from ..findings import Verdict
from ..regression import FloatArray
from .adjust import Adjusted
from .rows import ARM, DELAY, RATIO, TURN, VELOCITY_LAG
from .survey import Survey

ARM_KEY, DELAY_KEY = "vehicle.gnss.lever_arm_body_m", "core.fusion.gnss.delay_s"
VELOCITY_DELAY_KEY, SCALE_KEY = "core.fusion.gnss.velocity_delay_s", "core.fusion.odometer.scale"
SIGNIFICANT_SDS = 3.0  # of a difference that is one: the size of two or three axes is held against the sd of the worst
LARGEST_DELAY_S = 2.0  # and velocity delay 1 s: what the settings hold
FITS = {"velocity": 1.0, "lateral": 0.6, "off the road": 0.6}  # [m/s] residuals of a drive that the model describes


class Quantity(StrEnum):
    """What a drive shows of an installation."""

    MOUNTING = "mounting"  # [deg] of the IMU
    LEVER_ARM = "lever_arm"  # [m] from the IMU to the antenna, on ground
    DELAY = "delay"  # [s] of positions
    VELOCITY_DELAY = "velocity_delay"  # [s] of velocities beyond that of positions
    ODOMETER_SCALE = "odometer_scale"  # [-]


@dataclass(frozen=True)
class Limits:
    """Largest standard deviation with which a quantity is known, and the least difference that is worth a change."""

    sd: float
    least: float
    unit: str


LIMITS = {
    Quantity.MOUNTING: Limits(0.5, 0.3, "deg"),
    Quantity.LEVER_ARM: Limits(0.05, 0.03, "m"),
    Quantity.DELAY: Limits(0.01, 0.005, "s"),
    Quantity.VELOCITY_DELAY: Limits(0.01, 0.01, "s"),
    Quantity.ODOMETER_SCALE: Limits(0.0025, 0.002, "-"),
}


@dataclass(frozen=True)
class Finding:
    """One quantity against its setting: unknown, agrees, or contradicts with the changes that correct it.

    Attributes
    ----------
    difference, sd : float or None
        [unit] Found minus set, and its standard deviation; None where nothing tells it.
    value : float or tuple of float or None
        What was found, in the unit of the setting.
    """

    quantity: Quantity
    verdict: Verdict = Verdict.UNKNOWN
    difference: float | None = None
    sd: float | None = None
    value: object = None
    changes: Mapping[str, object] = field(default_factory=dict)

    @property
    def known(self) -> float:
        """How far it is known, up to 1: the largest standard deviation that suffices over that of now."""
        return 0.0 if not self.sd else min(1.0, LIMITS[self.quantity].sd / self.sd)


def findings_of(survey: Survey, settings: Settings) -> list[Finding]:
    """Compare what a drive has shown with the settings.

    Parameters
    ----------
    survey : Survey
        Of the drive.
    settings : Settings
        With which it was recorded.

    Returns
    -------
    list of Finding
        One of each quantity.
    """
    adjusted = survey.adjusted
    if adjusted is None or not describes(adjusted):
        return [Finding(quantity) for quantity in Quantity]
    return [
        _mounting(survey, adjusted, settings), _lever_arm(adjusted, settings), *_delays(adjusted, settings),
        _scale(adjusted, settings),
    ]  # fmt: skip


def describes(adjusted: Adjusted) -> bool:
    """Whether the model of a car that rolls along its axes describes a drive, and the search has ended."""
    return adjusted.settled and all(adjusted.residuals.get(kind, (0.0, 0))[0] < most for kind, most in FITS.items())


def changes_of(findings: list[Finding]) -> dict[str, object]:
    """All settings that findings change, with their new values."""
    return {name: value for finding in findings for name, value in finding.changes.items()}


def _mounting(survey: Survey, adjusted: Adjusted, settings: Settings) -> Finding:
    M = survey.matrix
    assert M is not None
    present = np.array(settings.vehicle.imu.body_from_sensor)
    new = M.T @ present
    size = degrees(float(np.linalg.norm(_turn(M)))) if np.linalg.det(M) > 0.0 else 180.0
    sd = degrees(float(adjusted.sd[TURN].max()))
    return _finding(Quantity.MOUNTING, size, sd, _rows(new), {MOUNTING_KEY: _rows(new)})


def _lever_arm(adjusted: Adjusted, settings: Settings) -> Finding:
    """Both axes on ground, or neither; the height of the antenna only where pitch and roll have shown it."""
    present = np.array(settings.vehicle.gnss.lever_arm_body_m)
    found, sd = adjusted.of.arm, adjusted.sd[ARM]
    new = [round(float(value), 3) for value in (*found[:2], present[2])]
    if sd[2] <= LIMITS[Quantity.LEVER_ARM].sd:
        new[2] = round(float(found[2]), 3)
    size = float(hypot(*(found[:2] - present[:2])))
    return _finding(Quantity.LEVER_ARM, size, float(sd[:2].max()), new, {ARM_KEY: new})


def _delays(adjusted: Adjusted, settings: Settings) -> Iterator[Finding]:
    gnss, of, sd = settings.gnss, adjusted.of, adjusted.sd
    new = round(gnss.delay_s + of.delay_s, 4)
    possible = abs(new) <= LARGEST_DELAY_S
    yield _finding(Quantity.DELAY, of.delay_s, float(sd[DELAY]), new, {DELAY_KEY: new} if possible else {})
    # That of velocities counts from that of positions.
    if "velocity" not in adjusted.residuals or sd[DELAY] > LIMITS[Quantity.DELAY].sd:
        yield Finding(Quantity.VELOCITY_DELAY)
        return
    new = round(gnss.velocity_delay_s + of.velocity_lag_s, 4)
    changes = {VELOCITY_DELAY_KEY: new} if abs(new) <= 1.0 else {}
    yield _finding(Quantity.VELOCITY_DELAY, of.velocity_lag_s, float(sd[VELOCITY_LAG]), new, changes)


def _scale(adjusted: Adjusted, settings: Settings) -> Finding:
    if "speed" not in adjusted.residuals or not 0.1 < adjusted.of.ratio < 10.0:
        return Finding(Quantity.ODOMETER_SCALE)
    ratio = adjusted.of.ratio
    new = round(settings.odometer.scale / ratio, 5)
    changes = {SCALE_KEY: new} if 0.0 < new <= 10.0 else {}
    return _finding(Quantity.ODOMETER_SCALE, 1.0 / ratio - 1.0, float(adjusted.sd[RATIO]) / ratio, new, changes)


def _finding(quantity: Quantity, difference: float, sd: float, value: object, changes: Mapping[str, object]) -> Finding:
    limits = LIMITS[quantity]
    if sd > limits.sd:
        return Finding(quantity, Verdict.UNKNOWN, difference, sd)
    if abs(difference) <= max(limits.least, SIGNIFICANT_SDS * sd):
        return Finding(quantity, Verdict.AGREES, difference, sd, value)
    return Finding(quantity, Verdict.CONTRADICTS, difference, sd, value, changes)


def _rows(matrix: FloatArray) -> list[list[float]]:
    """Matrix as rows of numbers that are orthogonal to six digits."""
    u, _, v = np.linalg.svd(matrix)
    return [[float(value) + 0.0 for value in row] for row in np.round(u @ v, 6).tolist()]


def _turn(matrix: FloatArray) -> FloatArray:
    """Rotation vector [rad] of a rotation matrix, shape (3,)."""
    cosine = float(np.clip(0.5 * (np.trace(matrix) - 1.0), -1.0, 1.0))
    angle = float(np.arccos(cosine))
    axis = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    size = float(np.linalg.norm(axis))
    turn: FloatArray = axis * (angle / size) if size > 1e-9 else np.array([angle, 0.0, 0.0])
    return turn
