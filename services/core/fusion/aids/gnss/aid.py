"""Measurements of one epoch of a receiver, by its message."""

from math import cos, radians, sin

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic
from shared.messages.base import Symmetric3, Vector3
from shared.messages.gnss import CarrierSolution, FaultFreeFix, FixType, GnssFix

from ...settings import Settings
from ..base import Measurement
from .fix import Reading, Stamp, gnss_measurements

FloatArray = npt.NDArray[np.float64]

USABLE = (FixType.TWO_D, FixType.THREE_D, FixType.GNSS_DEAD_RECKONING)
COURSE_SPEED_M_S = 0.5  # lowest speed at which the course of a receiver is used
GROUND_SPEED_SD = 0.3  # [m/s] of speed over ground and course, which receivers smooth
WORST_DOP = 1000.0  # upper limit of a stated dilution of precision
UERE_M = 2.5  # [m] user-equivalent range error of a receiver that states no covariance


def of_fix(fix: GnssFix, settings: Settings) -> list[Measurement]:
    """Measurements of a fix; none if it has no position from GNSS."""
    if fix.fix_type not in USABLE or fix.latitude_deg is None or fix.longitude_deg is None:
        return []
    height = fix.height_ellipsoid_m
    has_height = height is not None and fix.fix_type is not FixType.TWO_D
    position = Geodetic(radians(fix.latitude_deg), radians(fix.longitude_deg), height or 0.0)
    reading = Reading((0.0, 0.0, 0.0), _position_cov(fix), 3 if has_height else 2)
    fixed = fix.carrier_solution is CarrierSolution.FIXED
    stamp = Stamp(fix.sampled_ns, fix.received_ns, fix.source)
    return gnss_measurements(settings, stamp, position, reading, _velocity(fix), fixed=fixed)


def of_fault_free_fix(fix: FaultFreeFix, settings: Settings) -> list[Measurement]:
    """Measurements of a fix without the excluded satellites, which replace the receiver's own."""
    stamp = Stamp(fix.sampled_ns, fix.received_ns, fix.source)
    position = Geodetic(radians(fix.latitude_deg), radians(fix.longitude_deg), fix.height_ellipsoid_m)
    velocity = fix.velocity_ned_m_s
    moving = None if velocity is None else Reading(velocity, _cov(fix.velocity_cov_ned_m2_s2, None))
    reading = Reading((0.0, 0.0, 0.0), _cov(fix.position_cov_ned_m2, None))
    left_out = fix.satellites_left_out
    return gnss_measurements(settings, stamp, position, reading, moving, left_out=left_out)


def _position_cov(fix: GnssFix) -> FloatArray | None:
    cov = _cov(fix.position_cov_ned_m2, fix.position_sd_ned_m)
    if cov is None and fix.hdop is not None:
        horizontal = UERE_M * min(abs(fix.hdop), WORST_DOP)
        vertical = UERE_M * min(abs(fix.vdop or 2.0 * fix.hdop), WORST_DOP)
        return np.diag(np.square([horizontal, horizontal, vertical]))
    return cov


def _velocity(fix: GnssFix) -> Reading | None:
    if fix.velocity_ned_m_s is not None:
        return Reading(fix.velocity_ned_m_s, _cov(fix.velocity_cov_ned_m2_s2, fix.velocity_sd_ned_m_s))
    speed, course = fix.ground_speed_m_s, fix.course_rad
    if speed is None or course is None or speed < COURSE_SPEED_M_S:
        return None
    cov = np.eye(3) * GROUND_SPEED_SD**2
    return Reading((speed * cos(course), speed * sin(course), 0.0), cov, axes=2)


def _cov(cov: Symmetric3 | None, sd: Vector3 | None) -> FloatArray | None:
    if cov is not None:
        nn, ne, nd, ee, ed, dd = cov
        return np.array([[nn, ne, nd], [ne, ee, ed], [nd, ed, dd]])
    return None if sd is None else np.diag(np.square(sd))


KINDS = {GnssFix: (of_fix,), FaultFreeFix: (of_fault_free_fix,)}
