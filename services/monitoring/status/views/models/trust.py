"""The verdict, monitors and hypotheses."""

from typing_extensions import TypedDict

from shared.messages.trust import TrustLevel
from shared.page.answers import Object, Stamp, answer

from ...history.columns import TrustColumns
from ..banner import Trust
from .hypotheses import AlternativeTrack, HypothesisRow, SatelliteSolution


@answer()
class Accusation(TypedDict):
    """A monitor that accused at the time of an event."""

    monitor: str
    accused: str
    statistic: float | None
    threshold: float | None


@answer()
class Event(TypedDict):
    """A change of the verdict."""

    sampled_ns: Stamp
    before: TrustLevel
    after: TrustLevel
    reasons: list[str]
    accusing: list[Accusation]


@answer()
class TrustShown(TypedDict):
    """The newest verdict, monitors, hypotheses, and changes."""

    verdict: Object | None
    """`trust/state` without its monitors"""
    monitors: dict[str, Object]
    hypotheses: dict[str, HypothesisRow]
    """what may be wrong: beliefs of core.trust, and the solutions behind them"""
    events: list[Event]
    """changes of the verdict, newest first"""


@answer()
class TrustReport(TrustShown):
    """The verdict with its reasons and every monitor."""

    state: Trust
    sentence: str
    history: TrustColumns


@answer()
class HypothesesReport(TypedDict):
    """What may be wrong, and the positions that follow."""

    now_ns: Stamp
    hypotheses: dict[str, HypothesisRow]
    satellites: list[SatelliteSolution]
    """solutions without one satellite or one constellation, the largest separation first"""
    tracks: list[AlternativeTrack]
    """of the last two minutes"""
