"""The positions of an export: solutions, or fixes where there are no solutions."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from math import atan2, cos, degrees, hypot, sin

from shared.messages.base import Message
from shared.messages.gnss import CarrierSolution, FixType, GnssFix
from shared.messages.navigation import NavigationPhase, NavigationSolution
from shared.track_files import TrackPoint, crosses_antimeridian

from ..utc import UtcLine

GAP_NS = 5_000_000_000  # a longer one breaks the track
FIX_AGE_NS = 3_000_000_000  # of the fix whose kind a solution takes over


@dataclass(frozen=True)
class Position:
    """A position with what the formats need besides; None is unknown."""

    time_ns: int  # [ns] UTC since 1970
    latitude_deg: float
    longitude_deg: float
    height_ellipsoid_m: float | None
    velocity_ned_m_s: tuple[float, float, float] | None
    heading_deg: float | None = None  # of the vehicle; of a fix its course
    position_sd_m: float | None = None  # horizontal, DRMS
    protection_level_horizontal_m: float | None = None
    protection_level_vertical_m: float | None = None
    dead_reckoning: bool = False
    fix: GnssFix | None = None  # newest fix

    @property
    def speed_m_s(self) -> float | None:
        """Speed over ground."""
        return None if self.velocity_ned_m_s is None else hypot(*self.velocity_ned_m_s[:2])

    @property
    def course_deg(self) -> float | None:
        """Course over ground, clockwise from north."""
        v = self.velocity_ned_m_s
        return None if v is None else degrees(atan2(v[1], v[0])) % 360.0

    def track_point(self) -> TrackPoint:
        """Give the point of a GPX or KML file."""
        extras = {
            "speed_m_s": self.speed_m_s,
            "heading_deg": self.heading_deg,
            "position_sd_m": self.position_sd_m,
            "protection_level_horizontal_m": self.protection_level_horizontal_m,
            "protection_level_vertical_m": self.protection_level_vertical_m,
        }
        return TrackPoint(self.time_ns, self.latitude_deg, self.longitude_deg, self.height_ellipsoid_m, extras)


def of_solutions(messages: Iterable[Message], fixes: Iterable[Message], utc: UtcLine) -> Iterator[Position]:
    """Make positions of solutions, each with the newest fix at its time; both in time order."""
    waiting = iter([fix for fix in fixes if isinstance(fix, GnssFix)])
    newest: GnssFix | None = None
    following = next(waiting, None)
    for s in messages:
        if not isinstance(s, NavigationSolution):
            continue
        while following is not None and following.sampled_ns <= s.sampled_ns:
            newest, following = following, next(waiting, None)
        current = newest is not None and s.sampled_ns - newest.sampled_ns <= FIX_AGE_NS
        cov = s.position_cov_ned_m2
        yield Position(
            utc.utc_ns(s.sampled_ns),
            s.latitude_deg,
            s.longitude_deg,
            s.height_ellipsoid_m,
            s.velocity_ned_m_s,
            degrees(s.yaw_rad) % 360.0,
            max(cov[0] + cov[3], 0.0) ** 0.5,
            s.protection_level_horizontal_m,
            s.protection_level_vertical_m,
            dead_reckoning=s.phase is NavigationPhase.COASTING,
            fix=newest if current else None,
        )


def of_fixes(messages: Iterable[Message], utc: UtcLine) -> Iterator[Position]:
    """Make positions of the fixes that have one."""
    for fix in messages:
        if not isinstance(fix, GnssFix) or fix.latitude_deg is None or fix.longitude_deg is None:
            continue
        sd, velocity = fix.position_sd_ned_m, fix.velocity_ned_m_s
        if velocity is None and fix.ground_speed_m_s is not None and fix.course_rad is not None:
            velocity = fix.ground_speed_m_s * cos(fix.course_rad), fix.ground_speed_m_s * sin(fix.course_rad), 0.0
        position = Position(
            utc.of_fix(fix),
            fix.latitude_deg,
            fix.longitude_deg,
            fix.height_ellipsoid_m,
            velocity,
            position_sd_m=hypot(*sd[:2]) if sd else None,
            dead_reckoning=fix.fix_type is FixType.DEAD_RECKONING,
            fix=fix,
        )
        yield replace(position, heading_deg=position.course_deg)


def spaced(positions: Iterable[Position], period_s: float) -> Iterator[Position]:
    """Leave out positions that follow the one before by less than a period; a period of 0 leaves out none."""
    due_ns: int | None = None
    for position in positions:
        if due_ns is None or period_s <= 0.0 or position.time_ns >= due_ns:
            due_ns = position.time_ns + round(period_s * 0.95e9)
            yield position


def segments(positions: Iterable[Position]) -> list[list[Position]]:
    """Cut a track where no position was published for longer than `GAP_NS`, and where it crosses 180 degrees.

    A line from 179.9 to -179.9 degrees would be drawn around the world (RFC 7946, section 3.1.9).
    """
    cut: list[list[Position]] = []
    for position in positions:
        last = cut[-1][-1] if cut else None
        if (
            last is None
            or position.time_ns - last.time_ns > GAP_NS
            or crosses_antimeridian(last.longitude_deg, position.longitude_deg)
        ):
            cut.append([])
        cut[-1].append(position)
    return cut


def quality(position: Position) -> int:
    """Give the quality indicator of NMEA 0183 GGA: 1 GNSS, 2 differential, 4 and 5 RTK fixed and float, 6 estimated."""
    fix = position.fix
    if position.dead_reckoning or fix is None:
        return 6
    if fix.carrier_solution is not CarrierSolution.NONE:
        return 4 if fix.carrier_solution is CarrierSolution.FIXED else 5
    return 2 if fix.differential else 1
