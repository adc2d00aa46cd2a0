"""Displacement of the antenna between two epochs by carrier phases, as a measurement of the filter.

Successive displacements share an epoch, whose noise is in both with opposite signs. So they are integrated to a path
that begins at an anchor, and what is measured is the position against that path::

    z = Q - (p + b + e T),    Q = Q_0 + sum of d

with p the antenna, b the offset of the path (the error of the anchor, which is that of p at its time, and the noise of
its epoch), e the drift and T the time since the anchor. The noise of z is that of one epoch alone.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import sqrt
from typing import Self

import numpy as np
import numpy.typing as npt

from shared.chosen import receiver_of
from shared.inertial.strapdown import rotate
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference
from shared.maths.rotation import Vector
from shared.messages.base import Symmetric3
from shared.messages.gnss import CarrierDisplacement
from shared.messages.navigation import AidingKind

from ...inertial import error_model as em
from ...inertial.filter import ErrorStateFilter
from ...settings import Settings
from ...states import LAYOUT
from ..base import Kind, Observation, Sensor
from ..gnss.antenna import antenna_position_matrix
from ..gnss.fix import GnssVelocity, true_time_ns

FloatArray = npt.NDArray[np.float64]

OFFSET, DRIFT = LAYOUT.place("carrier_offset"), LAYOUT.place("carrier_drift")  # [m, NED], [m/s, NED]
ANCHOR_S = 10.0  # [s] longest path from one anchor: the drift is taken as constant along it
SAME_EPOCH_NS = 1_000_000  # stamps of one epoch differ by less
VELOCITY_EPOCH_NS = 15_000_000  # stamps of a velocity and of a displacement of one epoch differ by less
MAX_INTERVAL_S = 2.0  # of a displacement that is used: the filter's own error grows over a longer one
MAX_REJECTIONS = 3  # in a row, after which displacements are left out
LEFT_OUT_NS = 30_000_000_000
WIDE = 300.0  # [-] standard deviations of the position that an offset begins with, before the anchor sets it
MIN_WIDE_M = 100.0
MIN_NOISE_M = 1e-4  # of one epoch
MAX_DRIFT_M_S = 10.0
NOWHERE = Geodetic(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class CarrierDrift:
    """Statistics of the drift of a path: the errors of displacements that successive ones share."""

    correlation_s: float
    variance: FloatArray  # [m²/s²] shape (3,)

    def stationary(self, _estimated: bool) -> FloatArray:
        """Stationary variances [m²/s²]."""
        return self.variance


@dataclass(frozen=True)
class CarrierPath:
    """Path of the antenna by displacements since an anchor."""

    source: str = ""
    time_ns: int = 0  # of the newest epoch
    interval_ns: int = 0  # that it took
    anchor_ns: int | None = None  # None: there is no path
    position: Geodetic = NOWHERE  # Q, of the newest epoch
    removed_ns: int = 0  # of its age, in `time_ns`
    rejections: int = 0  # in a row, also over paths that ended
    left_out_ns: int | None = None  # since when displacements are left out

    def carries(self, velocity: GnssVelocity) -> bool:
        """Whether the newest displacement, or the one that is due next, is of the epoch of a velocity.

        Such a velocity is left out, unless the last displacement was rejected: path or filter may be wrong, and the
        velocity decides. Velocities of epochs between displacements are used.
        """
        if self.anchor_ns is None or self.rejections or receiver_of(velocity.source) != receiver_of(self.source):
            return False
        past_ns = velocity.time_ns + round(velocity.removed_s * 1e9) - self.time_ns - self.removed_ns
        return min(abs(past_ns), abs(past_ns - self.interval_ns)) < VELOCITY_EPOCH_NS

    def is_left_out(self, time_ns: int) -> bool:
        """Whether displacements are left out, after several that were rejected in a row."""
        return self.left_out_ns is not None and 0 <= time_ns - self.left_out_ns < LEFT_OUT_NS

    def ended(self) -> "CarrierPath":
        """No path; what was rejected is known."""
        return CarrierPath(rejections=self.rejections, left_out_ns=self.left_out_ns)


@dataclass(frozen=True)
class AntennaDisplacement(Kind):
    """Displacement [m, NED] of the antenna since an earlier epoch."""

    sensor = Sensor.GNSS

    time_ns: int
    received_ns: int
    source: str
    since_ns: int
    displacement: Vector
    noise_cov: FloatArray  # [m², NED] of one epoch
    drift: CarrierDrift
    lever_arm: Vector
    checked: bool
    path: CarrierPath = CarrierPath()  # up to this epoch
    removed_s: float = 0.0  # of its age, in both times

    def corrected(self, position_s: float, velocity_s: float) -> Self:
        """As late as a position."""
        shift_ns = round((position_s - self.removed_s) * 1e9)
        return replace(self, time_ns=self.time_ns - shift_ns, since_ns=self.since_ns - shift_ns, removed_s=position_s)

    def after(self, path: CarrierPath) -> Self:
        """Along a path that ends where it begins; without a path otherwise, or where no slip would have been found."""
        gap_ns = abs(self.since_ns - path.time_ns)
        follows = self.checked and path.anchor_ns is not None and path.source == self.source and gap_ns < SAME_EPOCH_NS
        if not follows:
            return replace(self, path=path.ended())
        position = geodetic_from_ned_difference(self.displacement, path.position)
        interval_ns = self.time_ns - self.since_ns
        return replace(self, path=replace(path, time_ns=self.time_ns, interval_ns=interval_ns, position=position))

    def observers(self) -> Iterator[Callable[[ErrorStateFilter], Observation]]:
        """Position of the antenna against the path, if there is one."""
        if self.path.anchor_ns is not None:
            yield self.observe

    def observe(self, navigation: ErrorStateFilter) -> Observation:
        """Innovation against the predicted position of the antenna, plus offset and drift of the path."""
        assert self.path.anchor_ns is not None
        arm_n = rotate(navigation.quaternion, self.lever_arm)
        antenna = geodetic_from_ned_difference(arm_n, navigation.position)
        past_s = (self.time_ns - self.path.anchor_ns) * 1e-9
        offset, drift = navigation.parameters_of(OFFSET), navigation.parameters_of(DRIFT)
        z = np.array(ned_from_geodetic_difference(self.path.position, antenna)) - offset - past_s * drift
        H = antenna_position_matrix(arm_n)
        H[:, OFFSET], H[:, DRIFT] = -em.UNIT, -past_s * em.UNIT
        return Observation(AidingKind.CARRIER_DISPLACEMENT, z, H, self.noise_cov)

    def path_after(self, navigation: ErrorStateFilter, *, used: bool) -> CarrierPath:
        """Path to which the next displacement belongs: this one, or one with its anchor here where it is too long.

        One that was rejected, or is the first, has a new anchor; one that was not checked has no path. After several
        that were rejected there is none for a while, and after it for as long again if the first is rejected.
        """
        if not self.checked or self.path.is_left_out(self.time_ns):
            return self.path.ended()
        anchor_ns = self.path.anchor_ns
        rejected = anchor_ns is not None and not used
        rejections = 0 if used else min(self.path.rejections + rejected, MAX_REJECTIONS)
        if rejected and rejections == MAX_REJECTIONS:
            return CarrierPath(rejections=rejections, left_out_ns=self.time_ns)
        if used and anchor_ns is not None and self.time_ns - anchor_ns < ANCHOR_S * 1e9:
            return replace(self.path, rejections=0, left_out_ns=None)
        anchored = self._anchored(navigation, keeps_drift=not rejected)
        return replace(anchored, rejections=rejections)

    def _anchored(self, navigation: ErrorStateFilter, *, keeps_drift: bool) -> CarrierPath:
        """Anchor a path at the antenna of now: its offset becomes that position's error and the noise of the epoch."""
        navigation.propagate_covariance()
        if not keeps_drift or navigation.P[DRIFT.start, DRIFT.start] == 0.0:
            for k, variance in zip(range(DRIFT.start, DRIFT.stop), self.drift.variance.tolist(), strict=True):
                navigation.set_parameter(k, 0.0, sqrt(variance))
        navigation.use_errors("carrier_drift", self.drift)
        position_sd = sqrt(float(navigation.P[em.POSITION, em.POSITION].diagonal().max()))
        navigation.set_parameters(OFFSET, max(MIN_WIDE_M, WIDE * position_sd))
        arm_n = rotate(navigation.quaternion, self.lever_arm)
        path = CarrierPath(
            self.source, self.time_ns, self.time_ns - self.since_ns, self.time_ns,
            geodetic_from_ned_difference(arm_n, navigation.position), round(self.removed_s * 1e9),
        )  # fmt: skip
        anchor = replace(self, path=path).observe(navigation)  # its innovation is zero
        navigation.apply(navigation.innovate(anchor.z, anchor.H, anchor.R))
        return path


def of_displacement(message: CarrierDisplacement, settings: Settings) -> Iterator[AntennaDisplacement]:
    """Displacement of a message, with its covariance in two parts: noise of each epoch, and drift."""
    if not settings.carrier.enabled:
        return
    interval_s = (message.sampled_ns - message.since_ns) * 1e-9
    if interval_s <= 0.0:
        return
    slow, whole = _matrix(message.slow_cov_ned_m2), _matrix(message.displacement_cov_ned_m2)
    floor, ceiling = settings.carrier.drift_sd_floor_m_s**2, MAX_DRIFT_M_S**2
    drift = CarrierDrift(settings.carrier.drift_correlation_s, np.clip(slow.diagonal() / interval_s**2, floor, ceiling))
    noise = 0.5 * (whole - slow) + MIN_NOISE_M**2 * np.eye(3)
    yield AntennaDisplacement(
        time_ns=true_time_ns(settings, message.sampled_ns), received_ns=message.received_ns, source=message.source,
        since_ns=true_time_ns(settings, message.since_ns), displacement=message.displacement_ned_m, noise_cov=noise,
        drift=drift, lever_arm=settings.vehicle.gnss.lever_arm_of(receiver_of(message.source)),
        checked=message.checked and interval_s <= MAX_INTERVAL_S and bool(np.linalg.eigvalsh(noise)[0] > 0.0),
    )  # fmt: skip


def _matrix(upper: Symmetric3) -> FloatArray:
    nn, ne, nd, ee, ed, dd = upper
    return np.array([[nn, ne, nd], [ne, ee, ed], [nd, ed, dd]])


KINDS = {CarrierDisplacement: (of_displacement,)}
