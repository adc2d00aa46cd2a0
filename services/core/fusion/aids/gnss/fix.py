"""GNSS position and velocity of the antenna as measurements of the filter."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import hypot, isfinite, sqrt
from types import MappingProxyType
from typing import ClassVar, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from shared.chosen import receiver_of
from shared.inertial.strapdown import rotate
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference
from shared.maths.kalman import root_of
from shared.maths.rotation import Vector
from shared.messages.navigation import AidingKind

from ...inertial import error_model as em
from ...inertial.filter import ErrorStateFilter
from ...inertial.propagation import HIGHEST_LATITUDE, MAX_SPEED_M_S
from ...inertial.standstill import is_standstill
from ...settings import Settings
from ..base import Kind, Measurement, MotionSink, NonInertial, Observation, Sensor, Start
from .antenna import antenna_position_matrix, antenna_velocity, antenna_velocity_matrix
from .correlated import (
    GNSS_ERROR,
    GNSS_VELOCITY_ERROR,
    position_errors_of,
    use_position_errors,
    use_velocity_errors,
    velocity_errors_of,
)
from .position_errors import KnownGnssErrors

FloatArray = npt.NDArray[np.float64]

MAX_SD = 1e4  # [m, m/s] upper limit of stated standard deviations
MIN_SD = 1e-6  # [m, m/s] below it a stated standard deviation is invalid
CORRELATED_ABOVE_M = 0.1  # of the larger horizontal axis; errors below it are of a carrier phase
LOWEST_M, HIGHEST_M = -10_000.0, 50_000.0  # plausible heights
MIN_EIGENVALUE = 1e-3  # [-] of a valid correlation matrix


class Stamp(NamedTuple):
    """When a measurement was true, when it arrived, and from which device."""

    sampled_ns: int
    received_ns: int
    source: str


class Reading(NamedTuple):
    """A vector in NED with its covariance if the receiver states one, and how many of N, E, D were measured."""

    vector: Vector
    cov: FloatArray | None = None
    axes: int = 3


@dataclass(frozen=True)
class GnssPosition(Kind):
    """Position of the antenna with its covariance [m², NED]; of its height only the value if `axes` is 2."""

    sensor, is_fix, epoch = Sensor.GNSS, True, True
    inflation: ClassVar[Mapping[str, float]] = MappingProxyType({"position_sd": 0.1, "velocity_sd": 0.1})  # [m, m/s]

    time_ns: int
    received_ns: int
    source: str
    position: Geodetic
    cov: FloatArray
    axes: int
    lever_arm: Vector
    time_sd_s: float
    time_correlated: bool = False  # its error, in part
    removed_s: float = 0.0  # of its age, in `time_ns`
    left_out: tuple[str, ...] = ()  # satellites; not empty of a fault-free fix

    def implausible(self) -> str | None:
        """Limits of latitude and height."""
        if not isfinite(sum(self.position)):
            return "position not finite"
        if not abs(self.position.latitude) < HIGHEST_LATITUDE:
            return "position too near a pole"
        return None if LOWEST_M <= self.position.height <= HIGHEST_M else "implausible height"

    def corrected(self, position_s: float, velocity_s: float) -> Self:
        """At its time of validity."""
        shift_ns = round((position_s - self.removed_s) * 1e9)
        return replace(self, time_ns=self.time_ns - shift_ns, removed_s=position_s)

    def without_height(self) -> Self:
        """Latitude and longitude alone."""
        return replace(self, axes=2)

    def align(self, start: Start) -> ErrorStateFilter | None:
        """Place of the start."""
        return start.start_at(self)

    def show(self, sink: MotionSink) -> None:
        """Position."""
        sink.see_position(self.position)

    def tell(self, model: NonInertial) -> None:
        """Position."""
        model.use_position(self)

    def observers(self) -> Iterator[Callable[[ErrorStateFilter], Observation]]:
        """Position alone."""
        yield self.observe

    def observe(self, navigation: ErrorStateFilter) -> Observation:
        """Innovation against the predicted antenna position plus the estimated time-correlated error, in metres."""
        arm_n, velocity = rotate(navigation.quaternion, self.lever_arm), navigation.velocity
        z, H = self._beside(navigation, arm_n), antenna_position_matrix(arm_n)
        along = np.multiply(velocity, self.time_sd_s)  # what an error of the stamp does
        errors = position_errors_of(navigation)
        correlated_share = max(errors.correlated_share, 1e-6) if self.time_correlated else 0.0
        cov = errors.scaled(self.cov) if self.time_correlated else self.cov
        R = (1.0 - correlated_share) * cov + along * along[:, np.newaxis]
        if correlated_share > 0.0:
            root = sqrt(correlated_share) * root_of(cov, "a measurement")
            z -= root @ navigation.parameters_of(GNSS_ERROR)
            H[:, GNSS_ERROR] = -root
        n = self.axes
        return Observation(AidingKind.GNSS_POSITION, z[:n], H[:n], R[:n, :n])

    def unestimated_variances(self, navigation: ErrorStateFilter) -> tuple[float, float]:
        """Variances [m²] on ground and up of its error that the filter follows, and its covariance lacks."""
        return position_errors_of(navigation).unestimated(self.cov) if self.time_correlated else (0.0, 0.0)

    def update_statistics(self, navigation: ErrorStateFilter, _innovation: tuple[float, ...]) -> None:
        """Update the model of GNSS errors of the filter that has used it."""
        errors = position_errors_of(navigation)
        if self.time_correlated and self.axes == 3 and errors.is_due(self.time_ns):
            arm_n = rotate(navigation.quaternion, self.lever_arm)
            path = self._beside(navigation, arm_n) + navigation.position_correction
            variances = navigation.P.diagonal()[em.VELOCITY]
            use_position_errors(navigation, errors.after(self.time_ns, path, np.sqrt(self.cov.diagonal()), variances))

    def _beside(self, navigation: ErrorStateFilter, arm_n: Vector) -> FloatArray:
        """Measured minus predicted antenna position [m, NED] at its time of validity."""
        antenna = geodetic_from_ned_difference(arm_n, navigation.position)
        return np.array(ned_from_geodetic_difference(self.position, antenna))


@dataclass(frozen=True)
class GnssVelocity(Kind):
    """Velocity of the antenna [m/s, NED] with its covariance; without its vertical part if `axes` is 2."""

    sensor, epoch = Sensor.GNSS, True
    inflation: ClassVar[Mapping[str, float]] = MappingProxyType({"velocity_sd": 0.1})  # [m/s]

    time_ns: int
    received_ns: int
    source: str
    velocity: Vector
    cov: FloatArray
    axes: int
    lever_arm: Vector
    time_correlated: bool = False  # the error of the position beside it, in part
    stated: bool = True  # its covariance, by the receiver
    removed_s: float = 0.0  # of its age, in `time_ns`
    left_out: tuple[str, ...] = ()  # satellites; not empty of a fault-free fix

    def implausible(self) -> str | None:
        """Limit of speeds."""
        return None if hypot(*self.velocity) < MAX_SPEED_M_S else "implausible velocity"

    def corrected(self, position_s: float, velocity_s: float) -> Self:
        """At its time of validity."""
        shift_ns = round((velocity_s - self.removed_s) * 1e9)
        return replace(self, time_ns=self.time_ns - shift_ns, removed_s=velocity_s)

    def align(self, start: Start) -> None:
        """Heading and initial velocity."""
        start.use_velocity(self)

    def show(self, sink: MotionSink) -> None:
        """Velocity."""
        sink.see_velocity(self.velocity, self.axes)

    def tell(self, model: NonInertial) -> None:
        """Velocity."""
        model.use_velocity(self)

    def observers(self) -> Iterator[Callable[[ErrorStateFilter], Observation]]:
        """Velocity alone."""
        yield self.observe

    def observe(self, navigation: ErrorStateFilter) -> Observation:
        """Innovation against the predicted velocity of the antenna plus the estimated time-correlated error."""
        (north, east, down), (vn, ve, vd) = self.velocity, navigation.velocity
        an, ae, ad = antenna_velocity(navigation, self.lever_arm)
        z = np.array([north - vn - an, east - ve - ae, down - vd - ad])
        H = antenna_velocity_matrix(self.lever_arm, navigation.rate, navigation.ned_from_body)
        if self.time_correlated:
            z -= navigation.parameters_of(GNSS_VELOCITY_ERROR)
            H[:, GNSS_VELOCITY_ERROR] = -em.UNIT
        n = self.axes
        late = navigation.late
        R = self.cov if late is None else self.cov + late.velocity_cov(navigation.velocity)
        return Observation(AidingKind.GNSS_VELOCITY, z[:n], H[:n], R[:n, :n])

    def update_statistics(self, navigation: ErrorStateFilter, innovation: tuple[float, ...]) -> None:
        """Update the model of velocity errors of the filter that has used it; a standstill shows nothing of them."""
        known = isinstance(position_errors_of(navigation), KnownGnssErrors)
        if known or not self.time_correlated or is_standstill(navigation.state.quiet):
            return
        n = self.axes
        residual = np.array(innovation) + navigation.parameters_of(GNSS_VELOCITY_ERROR)[:n]
        variances = self.cov.diagonal()[:n]
        learned = velocity_errors_of(navigation).after(self.time_ns, residual, variances, stated=self.stated)
        use_velocity_errors(navigation, learned)


def true_time_ns(settings: Settings, sampled_ns: int) -> int:
    """When an epoch of this stamp was true, on the clock of the inertial samples."""
    return sampled_ns - round(settings.gnss.delay_s * 1e9)


def gnss_measurements(
    settings: Settings,
    stamp: Stamp,
    position: Geodetic,
    reading: Reading,
    velocity: Reading | None,
    *,
    fixed: bool = False,
    left_out: tuple[str, ...] = (),
) -> list[Measurement]:
    """Make measurements of one epoch of a receiver, with plausible covariances.

    Parameters
    ----------
    settings : Settings
        Delays, lever arm, and the standard deviations of a receiver that states none.
    stamp : Stamp
        Of the epoch.
    position : Geodetic
        Of the antenna.
    reading : Reading
        The position's covariance [m², NED] and axes; its vector is not used.
    velocity : Reading or None
        [m/s, NED]
    fixed : bool
        Whether the carrier's ambiguities are resolved, so that no time-correlated error of metres remains.
    left_out : tuple of str
        Satellites that a fault-free fix does not contain.

    Returns
    -------
    list of Measurement
        Velocity, if there is one, before position. A stated covariance is scaled by `gnss.position_sd_factor`
        (positions only) and its diagonal kept between a floor, because some receivers state zero, and a ceiling.
    """
    true_ns = true_time_ns(settings, stamp.sampled_ns)
    arm = settings.vehicle.gnss.lever_arm_of(receiver_of(stamp.source))
    floor, factor = settings.gnss.position_sd_floor_m, settings.gnss.position_sd_factor
    cov = _trusted(reading.cov, settings.gnss.position_sd_ned_m, floor, factor)
    time_correlated = (
        settings.gnss.time_correlated_errors and not fixed and bool(cov[:2, :2].max() > CORRELATED_ABOVE_M**2)
    )
    measurements: list[Measurement] = []
    if velocity is not None and not settings.gnss.position_only:
        measurements.append(
            GnssVelocity(
                time_ns=true_ns - round(settings.gnss.velocity_delay_s * 1e9),
                received_ns=stamp.received_ns,
                source=stamp.source,
                velocity=velocity.vector,
                cov=_trusted(velocity.cov, settings.gnss.velocity_sd_ned_m_s, settings.gnss.velocity_sd_floor_m_s, 1.0),
                axes=velocity.axes,
                lever_arm=arm,
                time_correlated=time_correlated,
                stated=velocity.cov is not None,
                left_out=left_out,
            )
        )
    measurements.append(
        GnssPosition(
            time_ns=true_ns,
            received_ns=stamp.received_ns,
            source=stamp.source,
            position=position,
            cov=cov,
            axes=reading.axes,
            lever_arm=arm,
            time_sd_s=settings.gnss.time_sd_s,
            time_correlated=time_correlated,
            left_out=left_out,
        )
    )
    return measurements


def _trusted(cov: FloatArray | None, default_sd: Vector, floor_sd: float, factor: float) -> FloatArray:
    """Covariance that is finite, positive definite and not too small; impossible correlations are dropped.

    A variance of zero or less is invalid and replaced by the default.
    """
    if cov is None or not np.isfinite(cov).all():
        return np.diag(np.square(default_sd))
    cov = np.clip(cov, -(MAX_SD**2), MAX_SD**2)
    known = cov.diagonal() > MIN_SD**2
    stated = np.sqrt(np.maximum(cov.diagonal(), floor_sd**2))
    correlation = np.where(np.outer(known, known), np.clip(cov / np.outer(stated, stated), -1.0, 1.0), 0.0)
    np.fill_diagonal(correlation, 1.0)
    if np.linalg.eigvalsh(correlation)[0] < MIN_EIGENVALUE:
        correlation = np.eye(3)
    sd = np.where(known, np.clip(stated * factor, floor_sd, MAX_SD), default_sd)
    trusted: FloatArray = correlation * np.outer(sd, sd)
    return trusted
