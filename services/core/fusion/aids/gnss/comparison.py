"""Heading by matching accelerations of the inertial sensors with those of GNSS.

Both measure the same accelerations, in frames that differ by a turn about the vertical. In complex numbers (north +
i east), with a and g the mean accelerations of an interval by inertial sensors and by GNSS::

    g = w a + c + noise,   arg w is the turn, |w| should be one, and c contains tilt and biases

The mounting and the direction of motion need not be known, and any turn is found, also one of 180 degrees, which is
beyond the linear range of the filter.
"""

from cmath import phase, rect
from collections.abc import Sequence
from math import exp, inf, radians, sqrt
from typing import NamedTuple

from shared.maths.earth import STANDARD_GRAVITY, Geodetic, ned_from_geodetic_difference, wrap_angle

from ..base import Measurement
from .fix import GnssPosition, GnssVelocity

MEMORY_S = 30.0  # time constant of the exponential weights of past intervals
MIN_DURATION_S = 0.45  # shortest interval of velocities
MIN_OF_POSITIONS_S = 0.95  # shortest interval of positions, whose differences are noisier
MAX_DURATION_S = 3.0  # longest interval: tilt and biases are constant in it
MIN_INTERVALS = 2.5  # smallest number of intervals (exponentially weighted) that give a turn
MANY = 4.5  # number of intervals from which their noise is estimated
FEW_FACTOR = 4.0  # on the stated variance below that number
STANDSTILL_OFFSET_SD = 0.05  # [m/s²] of c after levelling at standstill
MOTION_OFFSET_SD = 1.5  # [m/s²] of c after levelling on the move
SHIFT_SD = 0.3  # [m/s²] of changes of c while levelling on the move goes on
NEIGHBOURS = 1.7  # on the noise of a difference of positions, which shares a position with the next
MAX_JITTER_M = 1.0  # largest noise from position to position, of which the stated error is more
WRONG_YAW = radians(30.0)  # smallest heading error that resets a filter
MIN_ERROR_SDS = 5.0  # smallest such error in standard deviations
MAX_TURN_SD = radians(12.0)  # largest standard deviation of such a turn: at constant speed it is noise
MAX_M_S2 = 8.0  # largest acceleration of a car; beyond it GNSS has jumped
PERSISTENT_S = {True: 1.0, False: 3.0}  # time for which velocities (True) or positions must contradict a filter
GAIN = (0.6, 1.6)  # range of |w| of one motion


class Match(NamedTuple):
    """Weighted sums of the regression, and the two velocities [m/s] at the end of the last interval."""

    time_ns: int = 0
    inertial: complex = 0j
    gnss: complex = 0j
    begun: bool = False
    n: float = 0.0
    a: complex = 0j
    g: complex = 0j
    aa: float = 0.0
    gg: float = 0.0
    ag: complex = 0j
    noise: float = 0.0  # [m²/s⁴] summed stated variances

    def after(self, time_ns: int, inertial: complex, gnss: complex, sd: float) -> "Match":
        """Sums with both velocities at one more instant; the inertial velocity may have a constant error.

        Parameters
        ----------
        time_ns : int
            The instant.
        inertial, gnss : complex
            [m/s] North + i east: by inertial sensors alone in the level frame, and by GNSS in NED.
        sd : float
            [m/s] Standard deviation of one axis of the GNSS velocity.

        Returns
        -------
        Match
        """
        span_s = (time_ns - self.time_ns) * 1e-9
        if not self.begun or not 0.0 <= span_s < MAX_DURATION_S:
            return self._replace(time_ns=time_ns, inertial=inertial, gnss=gnss, begun=True)
        if span_s < MIN_DURATION_S:
            return self
        a, g, keep = (inertial - self.inertial) / span_s, (gnss - self.gnss) / span_s, exp(-span_s / MEMORY_S)
        if abs(g) > MAX_M_S2:
            return self._replace(time_ns=time_ns, inertial=inertial, gnss=gnss)
        return Match(
            time_ns,
            inertial,
            gnss,
            True,
            keep * self.n + 1.0,
            keep * self.a + a,
            keep * self.g + g,
            keep * self.aa + abs(a) ** 2,
            keep * self.gg + abs(g) ** 2,
            keep * self.ag + a.conjugate() * g,
            keep * self.noise + 2.0 * (sd / span_s) ** 2,
        )

    def interrupted(self) -> "Match":
        """Sums that begin a new interval, after a discontinuity of the inertial velocity."""
        return self._replace(begun=False)

    def turned(self, turn: float) -> "Match":
        """Sums with the past inertial accelerations turned by an angle [rad], as in a corrected level frame.

        The current inertial velocity is not turned, because a new heading acts on future accelerations only.
        """
        w = rect(1.0, turn)
        return self._replace(a=w * self.a, ag=w.conjugate() * self.ag) if self.n else self

    def result(self, offset_sd: float, shift_sd: float = 0.0) -> tuple[float, float]:
        """Turn from the level frame to NED and its standard deviation [rad]; infinite while nothing is known.

        Parameters
        ----------
        offset_sd : float
            [m/s²] Prior standard deviation of c: with r the noise variance, r / offset_sd² observations of zero.
        shift_sd : float
            [m/s²] Standard deviation of changes of c between intervals, which do not average out.

        Returns
        -------
        tuple of float
            The noise variance is that of the residuals, or the stated one if that is larger. This is conservative:
            white velocity errors cancel from interval to interval.
        """
        if self.n < MIN_INTERVALS:
            return 0.0, inf
        stated = self.noise / self.n * (1.0 if self.n > MANY else FEW_FACTOR)
        n = self.n + stated / offset_sd**2
        aa = self.aa - abs(self.a) ** 2 / n
        gg = self.gg - abs(self.g) ** 2 / n
        ag = self.ag - self.a.conjugate() * self.g / n
        if aa <= 0.0 or not GAIN[0] * aa < abs(ag) < GAIN[1] * aa:
            return 0.0, inf
        residual = max(0.0, gg - abs(ag) ** 2 / aa) / (2.0 * (self.n - 1.5))
        return phase(ag), sqrt((max(residual, stated) + shift_sd**2) / aa)


class PositionMatch(NamedTuple):
    """The same from positions: their differences are compared with the mean of the inertial velocity."""

    match: Match = Match()
    time_ns: int = 0
    position: Geodetic | None = None
    inertial: complex = 0j

    def after(self, time_ns: int, inertial: complex, position: Geodetic, sd: float) -> "PositionMatch":
        """Sums with one more position, its noise [m] from fix to fix, and the inertial velocity [m/s]."""
        span_s = (time_ns - self.time_ns) * 1e-9
        if self.position is not None and 0.0 <= span_s < MIN_OF_POSITIONS_S:
            return self
        match = self.match
        if self.position is not None and 0.0 < span_s < MAX_DURATION_S:
            north, east, _ = ned_from_geodetic_difference(position, self.position)
            velocity = complex(north, east) / span_s
            mean = 0.5 * (inertial + self.inertial)
            match = match.after(time_ns, mean, velocity, NEIGHBOURS * sd / span_s)
        else:
            match = match.interrupted()
        return PositionMatch(match, time_ns, position, inertial)


class Comparison(NamedTuple):
    """Comparison of one receiver with the inertial sensors: by velocities, or by positions if it has none."""

    velocities: Match = Match()
    positions: PositionMatch = PositionMatch()
    source: str = ""
    offset_sd: float = MOTION_OFFSET_SD
    wrong_ns: int | None = None  # since when the turn has contradicted zero

    def after(self, gnss: Measurement, inertial: complex) -> "Comparison":
        """Comparison with one more GNSS measurement; `inertial` [m/s] is the antenna's velocity at its stamp."""
        if gnss.source != self.source and not self._is_silent(gnss.time_ns):
            return self
        if isinstance(gnss, GnssVelocity):
            sd = sqrt(0.5 * float(gnss.cov[0, 0] + gnss.cov[1, 1]))
            match = self.velocities.after(gnss.time_ns, inertial, complex(gnss.velocity[0], gnss.velocity[1]), sd)
            return self._replace(velocities=match, source=gnss.source)._checked(gnss.time_ns)
        if isinstance(gnss, GnssPosition) and gnss.time_ns - self.velocities.time_ns > MAX_DURATION_S * 1e9:
            sd = min(MAX_JITTER_M, sqrt(0.5 * float(gnss.cov[0, 0] + gnss.cov[1, 1])))
            positions = self.positions.after(gnss.time_ns, inertial, gnss.position, sd)
            return self._replace(positions=positions, source=gnss.source)._checked(gnss.time_ns)
        return self

    def _checked(self, now_ns: int) -> "Comparison":
        if not self.contradicts(0.0):
            return self if self.wrong_ns is None else self._replace(wrong_ns=None)
        return self if self.wrong_ns is not None else self._replace(wrong_ns=now_ns)

    def is_wrong(self, now_ns: int) -> bool:
        """Whether the turn has contradicted zero for `PERSISTENT_S`."""
        persistent_s = PERSISTENT_S[self.velocities.time_ns >= self.positions.time_ns]
        return self.wrong_ns is not None and now_ns - self.wrong_ns >= persistent_s * 1e9

    def _is_silent(self, now_ns: int) -> bool:
        return now_ns - max(self.velocities.time_ns, self.positions.time_ns) > MAX_DURATION_S * 1e9

    def turned(self, turn: float) -> "Comparison":
        """Comparison with the past inertial accelerations turned by an angle [rad]."""
        match, time_ns, position, inertial = self.positions
        positions = PositionMatch(match.turned(turn), time_ns, position, inertial)
        return Comparison(self.velocities.turned(turn), positions, self.source, self.offset_sd, self.wrong_ns)

    def interrupted(self) -> "Comparison":
        """Comparison after a discontinuity of the inertial velocity."""
        positions = PositionMatch(self.positions.match.interrupted())
        return self._replace(velocities=self.velocities.interrupted(), positions=positions)

    def result(self) -> tuple[float, float]:
        """Turn from the level frame to NED and its standard deviation [rad]; infinite while nothing is known."""
        both = self.velocities.result(self.offset_sd), self.positions.match.result(self.offset_sd)
        return min(both, key=lambda pair: pair[1])

    def precise(self) -> tuple[float, float]:
        """Turn and standard deviation [rad] to start a filter with: by velocities only, with the changes of c."""
        return self.velocities.result(self.offset_sd, SHIFT_SD if self.offset_sd == MOTION_OFFSET_SD else 0.0)

    def contradicts(self, turn: float) -> bool:
        """Whether a turn from the level frame to NED [rad] is wrong by more than the filter can correct."""
        found, sd = self.result()
        return sd < MAX_TURN_SD and abs(wrap_angle(found - turn)) > max(WRONG_YAW, MIN_ERROR_SDS * sd)


class Corrections(NamedTuple):
    """Sum of all corrections of a filter since its start, which gives the velocity by its inertial sensors alone.

    The corrected velocity does not show a wrong heading, because the filter attributes the accelerations to a tilt.
    """

    time_ns: int = 0
    velocity: complex = 0j  # [m/s]
    tilt: complex = 0j  # [m/s²] corrections of tilt, times gravity
    yaw: float = 0.0  # [rad]

    def at(self, time_ns: int) -> "Corrections":
        """Corrections at a later instant; corrections of tilt have been integrated to velocity."""
        span_s = (time_ns - self.time_ns) * 1e-9 if self.time_ns else 0.0
        return Corrections(time_ns, self.velocity + span_s * self.tilt, self.tilt, self.yaw)

    def after(self, time_ns: int, x: Sequence[float]) -> "Corrections":
        """Corrections with one more estimate of the errors `error_model.LEVEL` [rad, NED; m/s]."""
        now, (roll, pitch, yaw, north, east) = self.at(time_ns), x
        tilt = now.tilt + STANDARD_GRAVITY * complex(-pitch, roll)
        return Corrections(time_ns, now.velocity + complex(north, east), tilt, now.yaw + yaw)
