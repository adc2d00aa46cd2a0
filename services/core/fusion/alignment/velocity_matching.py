"""Heading from two accounts of one motion: velocity gained by the inertial sensors, and by GNSS.

Both are sums of the same accelerations, seen in frames that differ by a turn about the vertical. In complex numbers
(north + i east), with a and g the mean accelerations of an interval::

    g = w a + c + noise,   arg w is the turn, |w| should be one, and c takes up tilt and biases

Nothing is assumed of how the vehicle is mounted or whether it goes forwards, and any turn is found, also one of 180
degrees, which a filter that is linear about its own heading cannot find.
"""

from cmath import phase, rect
from collections.abc import Sequence
from math import exp, inf, radians, sqrt
from typing import NamedTuple

from shared.maths.earth import STANDARD_GRAVITY, Geodetic, ned_from_geodetic_difference, wrap_angle

from ..measurements.base import Measurement
from ..measurements.gnss import GnssPosition, GnssVelocity

MEMORY_S = 30.0  # time constant with which the past is forgotten
SHORTEST_S = 0.45  # of an interval of velocities, and
CHORD_S = 0.95  # of positions, whose differences are noisier
LONGEST_S = 3.0  # over which tilt and biases are even
FEWEST = 2.5  # informative intervals
MANY = 4.5  # that say themselves how noisy they are
FEW_FACTOR = 4.0  # on the stated variance if they are fewer
REST_OFFSET_SD = 0.05  # [m/s²] of a vehicle that was levelled at rest: tilt and bias
MOTION_OFFSET_SD = 1.5  # of one that was levelled on the move, and
SHIFT_SD = 0.3  # [m/s²] what that changes by meanwhile, for such levelling goes on
NEIGHBOURS = 1.7  # differences of positions share one with the next
LARGEST_JITTER_M = 1.0  # positions differ from each other by less than from the truth
WRONG_YAW = radians(30.0)
WRONG_SDS = 5.0
SURE = radians(12.0)  # at even speed, noise has any turn: one that is less sure than this contradicts nothing
LARGEST_M_S2 = 8.0  # no tyre accelerates a car so much: GNSS has jumped
PERSISTENT_S = {True: 1.0, False: 3.0}  # for which velocities, or positions, must contradict a running filter
GAIN = (0.6, 1.6)  # beyond it the two are not of one motion


class Match(NamedTuple):
    """Weighted sums of a regression, and the two velocities [m/s] at the end of the last interval."""

    time_ns: int = 0
    inertial: complex = 0j
    seen: complex = 0j
    begun: bool = False
    n: float = 0.0
    a: complex = 0j
    g: complex = 0j
    aa: float = 0.0
    gg: float = 0.0
    ag: complex = 0j
    noise: float = 0.0  # [m²/s⁴] summed stated variances

    def after(self, time_ns: int, inertial: complex, seen: complex, sd: float) -> "Match":
        """Take in both velocities [m/s] at an instant; the inertial one may be off by a constant.

        Parameters
        ----------
        time_ns : int
            The instant.
        inertial, seen : complex
            [m/s] North + i east: by inertial sensors alone in their own level frame, and by GNSS.
        sd : float
            [m/s] Standard deviation of an axis of the latter.

        Returns
        -------
        Match
        """
        span_s = (time_ns - self.time_ns) * 1e-9
        if not self.begun or not 0.0 <= span_s < LONGEST_S:
            return self._replace(time_ns=time_ns, inertial=inertial, seen=seen, begun=True)
        if span_s < SHORTEST_S:
            return self
        a, g, keep = (inertial - self.inertial) / span_s, (seen - self.seen) / span_s, exp(-span_s / MEMORY_S)
        if abs(g) > LARGEST_M_S2:
            return self._replace(time_ns=time_ns, inertial=inertial, seen=seen)
        return Match(
            time_ns,
            inertial,
            seen,
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
        """Begin a new interval: between now and the last instant the inertial sensors were not followed."""
        return self._replace(begun=False)

    def turned(self, turn: float) -> "Match":
        """See past accelerations from a frame in which they appear turned by an angle [rad].

        The velocity reached so far is left as it is: a new heading turns what is gained from now on.
        """
        w = rect(1.0, turn)
        return self._replace(a=w * self.a, ag=w.conjugate() * self.ag) if self.n else self

    def result(self, offset_sd: float, shift_sd: float = 0.0) -> tuple[float, float]:
        """Turn from the inertial frame to NED and its standard deviation [rad]; infinite while nothing is known.

        Parameters
        ----------
        offset_sd : float
            [m/s²] What c may be: with r the variance of the noise, it counts as r / offset_sd² observations of zero.
        shift_sd : float
            [m/s²] By how much c may differ between rests and manoeuvres, which no number of intervals averages.

        Returns
        -------
        tuple of float
            The variance is that of the residuals, or what the receiver states if that is more; white errors of
            velocities cancel from interval to interval, so that it errs on the safe side.
        """
        if self.n < FEWEST:
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


class Chords(NamedTuple):
    """The same from positions: the mean velocity between two is held against the mean of the inertial one."""

    match: Match = Match()
    time_ns: int = 0
    position: Geodetic | None = None
    inertial: complex = 0j

    def after(self, time_ns: int, inertial: complex, position: Geodetic, sd: float) -> "Chords":
        """Take in a position with its error [m] from fix to fix, and a velocity."""
        span_s = (time_ns - self.time_ns) * 1e-9
        if self.position is not None and 0.0 <= span_s < CHORD_S:
            return self
        match = self.match
        if self.position is not None and 0.0 < span_s < LONGEST_S:
            north, east, _ = ned_from_geodetic_difference(position, self.position)
            velocity = complex(north, east) / span_s
            mean = 0.5 * (inertial + self.inertial)
            match = match.after(time_ns, mean, velocity, NEIGHBOURS * sd / span_s)
        else:
            match = match.interrupted()
        return Chords(match, time_ns, position, inertial)


class Comparison(NamedTuple):
    """Comparison of one receiver with the inertial sensors: by velocity, or by position if it has none."""

    velocities: Match = Match()
    chords: Chords = Chords()
    source: str = ""
    offset_sd: float = MOTION_OFFSET_SD
    wrong_ns: int | None = None  # since when the result has been far from zero

    def after(self, seen: Measurement, own: complex) -> "Comparison":
        """Use a GNSS measurement and the velocity of the antenna [m/s] by inertial sensors alone."""
        if seen.source != self.source and not self._is_silent(seen.time_ns):
            return self
        if isinstance(seen, GnssVelocity):
            sd = sqrt(0.5 * float(seen.cov[0, 0] + seen.cov[1, 1]))
            match = self.velocities.after(seen.time_ns, own, complex(seen.velocity[0], seen.velocity[1]), sd)
            return self._replace(velocities=match, source=seen.source)._watched(seen.time_ns)
        if isinstance(seen, GnssPosition) and seen.time_ns - self.velocities.time_ns > LONGEST_S * 1e9:
            sd = min(LARGEST_JITTER_M, sqrt(0.5 * float(seen.cov[0, 0] + seen.cov[1, 1])))
            chords = self.chords.after(seen.time_ns, own, seen.position, sd)
            return self._replace(chords=chords, source=seen.source)._watched(seen.time_ns)
        return self

    def _watched(self, now_ns: int) -> "Comparison":
        if not self.contradicts(0.0):
            return self if self.wrong_ns is None else self._replace(wrong_ns=None)
        return self if self.wrong_ns is not None else self._replace(wrong_ns=now_ns)

    def is_wrong(self, now_ns: int) -> bool:
        """Whether the frame of the inertial side has been far from NED for long enough."""
        persistent_s = PERSISTENT_S[self.velocities.time_ns >= self.chords.time_ns]
        return self.wrong_ns is not None and now_ns - self.wrong_ns >= persistent_s * 1e9

    def _is_silent(self, now_ns: int) -> bool:
        return now_ns - max(self.velocities.time_ns, self.chords.time_ns) > LONGEST_S * 1e9

    def turned(self, turn: float) -> "Comparison":
        """See past accelerations from a frame in which they appear turned by an angle [rad]."""
        match, time_ns, position, inertial = self.chords
        chords = Chords(match.turned(turn), time_ns, position, inertial)
        return Comparison(self.velocities.turned(turn), chords, self.source, self.offset_sd, self.wrong_ns)

    def interrupted(self) -> "Comparison":
        """Go on with another account of the inertial velocity, which differs from the last by a constant."""
        return self._replace(velocities=self.velocities.interrupted(), chords=Chords(self.chords.match.interrupted()))

    def result(self) -> tuple[float, float]:
        """Turn from the inertial frame to NED and its standard deviation [rad]; infinite while nothing is known."""
        both = self.velocities.result(self.offset_sd), self.chords.match.result(self.offset_sd)
        return min(both, key=lambda found: found[1])

    def precise(self) -> tuple[float, float]:
        """Find the turn to start a filter with: by velocities, and with all that its error may be."""
        return self.velocities.result(self.offset_sd, SHIFT_SD if self.offset_sd == MOTION_OFFSET_SD else 0.0)

    def contradicts(self, turn: float) -> bool:
        """Whether a turn from the inertial frame to NED [rad] is so wrong that no small correction mends it."""
        found, sd = self.result()
        return sd < SURE and abs(wrap_angle(found - turn)) > max(WRONG_YAW, WRONG_SDS * sd)


class Corrections(NamedTuple):
    """Sum of the corrections of a filter since its start, so that its uncorrected velocity is known.

    A filter whose heading is wrong explains accelerations by a tilt, and seems right.
    """

    time_ns: int = 0
    velocity: complex = 0j  # [m/s]
    lean: complex = 0j  # [m/s²] of tilt, as an acceleration
    yaw: float = 0.0  # [rad]

    def at(self, time_ns: int) -> "Corrections":
        """Carry on to an instant, with a tilt that is undone all the time."""
        span_s = (time_ns - self.time_ns) * 1e-9 if self.time_ns else 0.0
        return Corrections(time_ns, self.velocity + span_s * self.lean, self.lean, self.yaw)

    def after(self, time_ns: int, x: Sequence[float]) -> "Corrections":
        """Take in what was estimated of the errors of attitude [rad, NED] and velocity [m/s, NED], in this order."""
        now = self.at(time_ns)
        lean = now.lean + STANDARD_GRAVITY * complex(-x[1], x[0])
        return Corrections(time_ns, now.velocity + complex(x[3], x[4]), lean, now.yaw + x[2])
