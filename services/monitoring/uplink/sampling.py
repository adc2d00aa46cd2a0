"""What is reported: position and verdict once a second, once a minute where the vehicle is parked, and events."""

from collections.abc import Mapping
from enum import StrEnum
from math import ceil, hypot
from typing import cast

from shared.fleet.batch import Event, Report, verdict_code
from shared.fleet.times import RESTING_S
from shared.messages.base import Message
from shared.messages.navigation import NavigationSolution
from shared.messages.operation import Origin, Outage
from shared.messages.toll import TollTransaction
from shared.messages.trust import Outcome, TrustEvent, TrustLevel, TrustState

NS = 1_000_000_000
NS_PER_MS = 1_000_000
STALE_AFTER_NS = 2 * NS  # deadline of navigation/solution in shared/topics.py
VERDICT_SILENT_NS = 5 * NS  # deadline of trust/state there
PARKED_NS = 300 * NS
TRIP_NS = 30 * NS  # standing for as long is a part of a trip
PERIOD_NS, PARKED_PERIOD_NS = NS, RESTING_S * NS
MOVING_M_S = 0.5
WITHOUT_POSITION = (TrustLevel.NO_FIX, TrustLevel.INITIALISING)
NO_POSITION = (None,) * 6
# Largest values of a batch; an estimate beyond them is none.
MOST_HEIGHT_CM, MOST_SPEED_CM_S, MOST_LEVEL_DM = 10_000_000, 100_000, 10_000_000
PLACES = ("latitude", "longitude", "height", "position", "apart")  # begin names of fields


class Tracking(StrEnum):
    """How much the centre is told."""

    OFF = "off"
    VERDICT = "verdict"
    TRIPS = "trips"
    LIVE = "live"


class Sampler:
    """The newest solution and verdict; times in ns on the OBU time line."""

    def __init__(self, tracking: Tracking, now_ns: int) -> None:
        self._tracking = tracking
        self._solution: NavigationSolution | None = None
        self._trust: TrustState | None = None
        self._begun_ns = self._moved_ns = now_ns
        self._sampled_ns: int | None = None  # when the last report was made
        self._solved_ns = 0  # stamp of the last solution that was reported
        self._verdict: TrustLevel | None = None  # of the last report

    @property
    def gnss_excluded(self) -> bool:
        """Whether the newest verdict excludes GNSS."""
        return self._trust is not None and self._trust.gnss_excluded

    def add_solution(self, solution: NavigationSolution) -> None:
        """Take the newest solution."""
        self._solution = solution
        north, east, _ = solution.velocity_ned_m_s
        if not solution.stationary and hypot(north, east) >= MOVING_M_S:
            self._moved_ns = max(self._moved_ns, solution.sampled_ns)

    def add_trust(self, trust: TrustState) -> None:
        """Take a verdict."""
        self._trust = trust

    def is_parked(self, now_ns: int) -> bool:
        """Whether no solution has moved for five minutes."""
        return now_ns - self._moved_ns >= PARKED_NS

    def is_on_a_trip(self, now_ns: int) -> bool:
        """Whether the vehicle moves, or has just stopped."""
        return now_ns - self._moved_ns < TRIP_NS

    def shows_positions(self, now_ns: int) -> bool:
        """Whether positions may leave the unit now."""
        return self._tracking is Tracking.LIVE or (self._tracking is Tracking.TRIPS and self.is_on_a_trip(now_ns))

    def is_due(self, now_ns: int) -> bool:
        """Whether a report is to be made."""
        if self._tracking is Tracking.OFF:
            return False
        level, last_ns = self._level(now_ns), self._sampled_ns
        if last_ns is None:  # this process may have begun before it has received anything
            return level is not TrustLevel.NO_FIX or not 0 <= now_ns - self._begun_ns < VERDICT_SILENT_NS
        if level is not self._verdict:
            return True
        solution = self._solution
        if level not in WITHOUT_POSITION and solution is not None and solution.sampled_ns <= self._solved_ns:
            return False  # it is reported already, and the next one is not late yet
        return not 0 <= now_ns - last_ns < (PARKED_PERIOD_NS if self.is_parked(now_ns) else PERIOD_NS)

    def report(self, now_ns: int, offset_ns: int) -> tuple[Report, bool]:
        """Make a report; `offset_ns` is UTC minus the OBU time line. Also gives whether the verdict has changed."""
        level = self._level(now_ns)
        changed, self._verdict = level is not self._verdict, level
        self._sampled_ns = now_ns // NS * NS
        solution, time_ns, place = self._solution, now_ns, NO_POSITION
        if solution is not None and level not in WITHOUT_POSITION:
            time_ns = self._solved_ns = solution.sampled_ns
            if self.shows_positions(now_ns):
                place = cast("tuple[None, None, None, None, None, None]", _place(solution))
        return Report((time_ns + offset_ns) // NS_PER_MS, *place, verdict_code(level)), changed

    def _level(self, now_ns: int) -> TrustLevel:
        """The verdict; no fix where solution or verdict are missing or too old."""
        trust, solution = self._trust, self._solution
        if trust is None or abs(now_ns - trust.sampled_ns) > VERDICT_SILENT_NS:
            return TrustLevel.NO_FIX
        if trust.state is TrustLevel.INITIALISING:
            return trust.state
        if solution is None or abs(now_ns - solution.sampled_ns) > STALE_AFTER_NS:
            return TrustLevel.NO_FIX
        return trust.state


def _place(solution: NavigationSolution) -> tuple[int | None, ...]:
    """Position, velocity and level in the units of a batch; nothing where they are out of its range."""
    north, east, _ = (round(100.0 * value) for value in solution.velocity_ned_m_s)
    height = round(100.0 * solution.height_ellipsoid_m)
    if max(abs(north), abs(east)) > MOST_SPEED_CM_S or abs(height) > MOST_HEIGHT_CM:
        return NO_POSITION
    level_m = solution.protection_level_horizontal_m
    level = None if level_m is None or level_m > MOST_LEVEL_DM / 10 else ceil(10.0 * level_m)
    return round(1e7 * solution.latitude_deg), round(1e7 * solution.longitude_deg), height, north, east, level


def event_of(message: Message, topic: str, utc_ms: int, *, places: bool) -> Event | None:
    """Make an event of a message; None for one that is none. Without `places` positions are left out."""
    match message:
        case TrustEvent():
            content = message.model_dump(mode="json", exclude_none=True, exclude={"monitors"})
            accusing = [monitor for monitor in message.monitors if monitor.outcome is Outcome.ACCUSES]
            content["monitors"] = [
                trust_monitor.model_dump(
                    mode="json", include={"monitor", "outcome", "reason", "reason_code", "accused"}, exclude_none=True
                )
                for trust_monitor in accusing
            ]
        case Outage() | TollTransaction() | Origin():
            content = message.model_dump(mode="json", exclude_none=True)
        case _:
            return None
    return Event(utc_ms, topic, content if places else without_places(content))


def without_places(content: Mapping[str, object]) -> dict[str, object]:
    """Leave out fields that name a position."""
    found: dict[str, object] = {}
    for name, value in content.items():
        if name.startswith(PLACES):
            continue
        found[name] = [_without_places(item) for item in value] if isinstance(value, list) else _without_places(value)
    return found


def _without_places(value: object) -> object:
    return without_places(value) if isinstance(value, Mapping) else value
