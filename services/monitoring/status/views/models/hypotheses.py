"""What may be wrong, and the positions that follow."""

from typing_extensions import TypedDict

from shared.messages.trust import Hypothesis
from shared.page.answers import Stamp, answer


@answer()
class HypothesisRow(TypedDict):
    """What may be wrong: the belief of core.trust, and the solution that follows."""

    label: str
    probability: float | None
    prior: float | None
    survives: bool | None
    acted_on: bool
    suspected: bool
    reason: str | None
    since_ns: Stamp | None
    distance_m: float | None
    """horizontally, from the published solution"""
    level_m: float | None
    """horizontal protection level of its solution"""
    solutions: int
    left_out: str | None
    ratio: float | None
    """separation over its limit"""
    missing: str | None
    """why it has no solution"""
    source: str | None
    """processes that publish its solutions"""


@answer()
class SatelliteSolution(TypedDict):
    """A solution without one satellite or one constellation."""

    left_out: list[str]
    distance_m: float | None
    vertical_m: float | None
    level_m: float | None
    level_vertical_m: float | None
    separation: float | None
    separation_limit: float | None
    ratio: float | None
    """separation over its limit"""
    innovations: float | None


@answer()
class AlternativeTrack(TypedDict):
    """Positions under one hypothesis, unbroken."""

    hypothesis: Hypothesis
    label: str
    """as the map shows it"""
    source: str
    """process that publishes them"""
    left_out: list[str]
    """sources or satellites that they are without"""
    until_ns: Stamp
    places: list[tuple[float, float]]
    """longitude and latitude [deg], oldest first"""
