"""What other programs get of the unit: position, errors and verdict in the terms of gpsd and NMEA 0183.

No fix is given unless solution, verdict and origin are known and recent, and the verdict allows its use. A program that
reads gpsd or NMEA cannot ask for reasons: a position that must not be used is not given.
"""

from collections import OrderedDict
from dataclasses import dataclass, field
from enum import IntEnum
from math import atan2, cos, degrees, hypot, pi, sin, sqrt

from shared.messages.base import Symmetric3
from shared.messages.gnss import CarrierSolution, GnssFix, GnssSatellites
from shared.messages.navigation import NavigationPhase, NavigationSolution
from shared.messages.operation import Origin, OriginKind
from shared.messages.trust import TrustLevel, TrustState

NS = 1_000_000_000
STALE_AFTER_NS = 2 * NS  # deadline of navigation/solution in shared/topics.py
VERDICT_SILENT_NS = 5 * NS  # deadline of trust/state there
ORIGIN_SILENT_NS = 10 * NS  # deadline of origin/state there
FIX_SILENT_NS = 5 * NS  # of gnss/fix and gnss/satellites: their DOP and satellites are not of the solution any more
MAX_PRODUCERS = 16  # of origin/state that are remembered; a unit has four
SLOWEST_COURSE_M_S = 1.0  # below it the course is noise; the CAM has the same limit
USABLE = (TrustLevel.SAFE, TrustLevel.CAUTION, TrustLevel.DEAD_RECKONING)


class Quality(IntEnum):
    """Quality of a position: the numbers of the GGA sentence of NMEA 0183."""

    INVALID = 0
    AUTONOMOUS = 1
    DIFFERENTIAL = 2
    RTK_FIXED = 4
    RTK_FLOAT = 5
    ESTIMATED = 6  # dead reckoning
    SIMULATOR = 8


@dataclass(frozen=True)
class Place:
    """Position, motion and attitude of the IMU with their 1-sigma errors.

    Lengths in m, speeds in m/s, directions in degrees clockwise from true north, latitude and longitude in degrees.
    """

    latitude_deg: float
    longitude_deg: float
    height_ellipsoid_m: float
    separation_m: float | None  # geoid above the ellipsoid, as the receiver states it
    velocity_ned_m_s: tuple[float, float, float]
    speed_m_s: float
    course_deg: float | None  # None: too slow to have one
    position_sd_ned_m: tuple[float, float, float]
    ellipse_sd_m: tuple[float, float]  # semi-axes of the horizontal 1-sigma ellipse: major, minor
    ellipse_orientation_deg: float  # of the major axis
    speed_sd_m_s: float
    climb_sd_m_s: float
    course_sd_deg: float | None
    attitude_deg: tuple[float, float, float] | None  # roll, pitch, heading; None: not measured

    @property
    def height_msl_m(self) -> float | None:
        """Height above mean sea level; None where the receiver states no separation."""
        return None if self.separation_m is None else self.height_ellipsoid_m - self.separation_m


@dataclass(frozen=True)
class Report:
    """State of the unit for other programs at one time; without a `place` there is no fix."""

    utc_ns: int | None  # since 1970; None: no receiver has stated UTC yet
    quality: Quality = Quality.INVALID
    verdict: TrustLevel | None = None
    place: Place | None = None
    fused: bool = True  # with inertial sensors, and not a fix of the receiver alone
    coasting: bool = False  # without GNSS
    fix: GnssFix | None = None  # recent, for its dilution of precision
    satellites: GnssSatellites | None = None  # recent


@dataclass
class LatestMessages:
    """The newest messages, and what follows from them for other programs. Times in ns on the OBU time line."""

    _solution: NavigationSolution | None = None
    _solution_at_ns: int = 0  # when it arrived here
    _solution_age_ns: int = 0  # at its arrival
    _replayed: bool = False
    _trust: TrustState | None = None
    _fix: GnssFix | None = None
    _satellites: GnssSatellites | None = None
    _utc_offset_ns: int | None = None  # UTC - OBU time line
    _separation_m: float | None = None
    _origins: OrderedDict[str, tuple[OriginKind, int]] = field(default_factory=OrderedDict)  # by producer

    def add_solution(self, solution: NavigationSolution, now_ns: int, *, recorded_ns: int | None) -> None:
        """Take a solution that arrived now, or at `recorded_ns` at the recorder if it is replayed."""
        self._solution, self._solution_at_ns = solution, now_ns
        self._replayed = recorded_ns is not None
        self._solution_age_ns = (now_ns if recorded_ns is None else recorded_ns) - solution.sampled_ns

    def add_trust(self, trust: TrustState) -> None:
        """Take a verdict."""
        self._trust = trust

    def add_origin(self, origin: Origin, producer: str, now_ns: int, *, retained: bool) -> None:
        """Take where the data come from; a retained statement of an earlier run counts by its own time."""
        if retained and now_ns - origin.now_ns > ORIGIN_SILENT_NS:
            return
        self._origins[producer] = origin.kind, now_ns
        self._origins.move_to_end(producer)
        if len(self._origins) > MAX_PRODUCERS:
            self._origins.popitem(last=False)

    def add_fix(self, fix: GnssFix) -> None:
        """Take a receiver's epoch: UTC, unless the receiver is excluded, and the separation of the geoid."""
        self._fix = fix
        excluded = self._trust is not None and self._trust.gnss_excluded
        if fix.utc_ns is not None and not (excluded and self._utc_offset_ns is not None):
            self._utc_offset_ns = fix.utc_ns - fix.sampled_ns
        if fix.height_ellipsoid_m is not None and fix.height_msl_m is not None:
            self._separation_m = fix.height_ellipsoid_m - fix.height_msl_m

    def add_satellites(self, satellites: GnssSatellites) -> None:
        """Take the satellites of a receiver's epoch."""
        self._satellites = satellites

    def utc_ns(self, time_ns: int) -> int | None:
        """UTC of a time on the OBU time line; None before a receiver has stated it."""
        return None if self._utc_offset_ns is None else time_ns + self._utc_offset_ns

    def report(self, now_ns: int) -> Report:
        """Give the state now."""
        solution, trust = self._solution, self._trust
        if solution is None:
            return self._without_fix(now_ns)
        age_ns = self._solution_age_ns + now_ns - self._solution_at_ns
        if age_ns > STALE_AFTER_NS:
            return self._without_fix(solution.sampled_ns + age_ns)
        time_ns = solution.sampled_ns
        simulated = self._simulated(now_ns)
        recent = trust is not None and abs(time_ns - trust.sampled_ns) <= VERDICT_SILENT_NS
        if trust is None or not recent or simulated is None or trust.state not in USABLE:
            return self._without_fix(time_ns, trust.state if trust is not None and recent else None)
        fused = solution.phase is not NavigationPhase.GNSS_ONLY
        coasting = (
            solution.phase is NavigationPhase.COASTING
            or trust.state is TrustLevel.DEAD_RECKONING
            or solution.gnss_excluded_since_ns is not None
        )
        if fused and solution.phase not in (NavigationPhase.NAVIGATING, NavigationPhase.COASTING):
            return self._without_fix(time_ns, trust.state)
        fix = self._recent_fix(time_ns)
        return Report(
            utc_ns=self.utc_ns(time_ns),
            quality=_quality(fix, simulated=simulated, coasting=coasting),
            verdict=trust.state,
            place=_place(solution, self._separation_m, fused=fused),
            fused=fused,
            coasting=coasting,
            fix=fix,
            satellites=self._recent_satellites(time_ns),
        )

    def _without_fix(self, time_ns: int, verdict: TrustLevel | None = None) -> Report:
        return Report(self.utc_ns(time_ns), verdict=verdict, satellites=self._recent_satellites(time_ns))

    def _simulated(self, now_ns: int) -> bool | None:
        """Whether the data are not those of a vehicle now; None if nobody has said."""
        if self._replayed:
            return True
        kinds = [kind for kind, at_ns in self._origins.values() if now_ns - at_ns <= ORIGIN_SILENT_NS]
        return any(kind is not OriginKind.LIVE for kind in kinds) if kinds else None

    def _recent_fix(self, time_ns: int) -> GnssFix | None:
        fix = self._fix
        return fix if fix is not None and abs(time_ns - fix.sampled_ns) <= FIX_SILENT_NS else None

    def _recent_satellites(self, time_ns: int) -> GnssSatellites | None:
        seen = self._satellites
        return seen if seen is not None and abs(time_ns - seen.sampled_ns) <= FIX_SILENT_NS else None


def _quality(fix: GnssFix | None, *, simulated: bool, coasting: bool) -> Quality:
    if simulated:
        return Quality.SIMULATOR
    if coasting:
        return Quality.ESTIMATED
    if fix is not None and fix.carrier_solution is CarrierSolution.FIXED:
        return Quality.RTK_FIXED
    if fix is not None and fix.carrier_solution is CarrierSolution.FLOAT:
        return Quality.RTK_FLOAT
    return Quality.DIFFERENTIAL if fix is not None and fix.differential else Quality.AUTONOMOUS


def _place(solution: NavigationSolution, separation_m: float | None, *, fused: bool) -> Place:
    north, east, _ = solution.velocity_ned_m_s
    speed = hypot(north, east)
    course = atan2(east, north)
    nn, _, _, ee, _, dd = solution.position_cov_ned_m2
    major, minor, orientation = horizontal_ellipse(solution.position_cov_ned_m2)
    moving = speed >= SLOWEST_COURSE_M_S
    across = _sd_along(solution.velocity_cov_ned_m2_s2, course + pi / 2)
    return Place(
        latitude_deg=solution.latitude_deg,
        longitude_deg=solution.longitude_deg,
        height_ellipsoid_m=solution.height_ellipsoid_m,
        separation_m=separation_m,
        velocity_ned_m_s=solution.velocity_ned_m_s,
        speed_m_s=speed,
        course_deg=degrees(course) % 360.0 if moving else None,
        position_sd_ned_m=(_root(nn), _root(ee), _root(dd)),
        ellipse_sd_m=(major, minor),
        ellipse_orientation_deg=degrees(orientation),
        speed_sd_m_s=_sd_along(solution.velocity_cov_ned_m2_s2, course),
        climb_sd_m_s=_root(solution.velocity_cov_ned_m2_s2[5]),
        course_sd_deg=min(degrees(across / speed), 180.0) if moving else None,
        attitude_deg=(
            (degrees(solution.roll_rad), degrees(solution.pitch_rad), degrees(solution.yaw_rad) % 360.0)
            if fused
            else None
        ),
    )


def horizontal_ellipse(cov_ned: Symmetric3) -> tuple[float, float, float]:
    """Semi-axes and orientation of the 1-sigma ellipse of a horizontal covariance.

    Parameters
    ----------
    cov_ned : tuple of float
        [m2, NED] Upper triangle of the covariance of the position: NN NE ND EE ED DD.

    Returns
    -------
    tuple of float
        [m] Semi-major and semi-minor axis, [rad] orientation of the major axis in [0, pi), clockwise from north.

    Notes
    -----
    The eigenvalues of a symmetric matrix of two rows, with m = (NN + EE) / 2 and d = (NN - EE) / 2::

        m +- sqrt(d² + NE²),    orientation = atan2(NE, d) / 2
    """
    nn, ne, _, ee, _, _ = cov_ned
    mean, difference = (nn + ee) / 2.0, (nn - ee) / 2.0
    radius = hypot(difference, ne)
    return _root(mean + radius), _root(mean - radius), atan2(ne, difference) / 2.0 % pi


def _sd_along(cov_ned: Symmetric3, azimuth: float) -> float:
    """Standard deviation of the component along a horizontal direction u: sqrt(u^T P u)."""
    nn, ne, _, ee, _, _ = cov_ned
    north, east = cos(azimuth), sin(azimuth)
    return _root(north * north * nn + 2.0 * north * east * ne + east * east * ee)


def _root(variance: float) -> float:
    return sqrt(max(variance, 0.0))
