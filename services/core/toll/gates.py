"""Gate commands: which lane's gate opens for which passage, and when the vehicle crosses the gate line."""

from dataclasses import dataclass
from math import hypot

from shared.messages.explanation import explain
from shared.messages.explanation import passage as reference_of
from shared.words.words import CodedText, stated

from .codes import Code
from .passages import Here, Passage
from .settings import PassageSettings

MIN_SPEED_M_S = 1.0  # [m/s] below which no crossing time is predicted


@dataclass(frozen=True)
class Arrival:
    """A vehicle that comes to the gate line of a lane."""

    crossing_ns: int | None  # None: it stands or creeps
    sd_s: float | None

    @classmethod
    def of(cls, here: Here) -> "Arrival":
        """Predict the crossing at constant speed: t = -s/v, σ_t = hypot(σ_s, t σ_v) / v."""
        if here.speed < MIN_SPEED_M_S:
            return cls(None, None)
        seconds = -here.along / here.speed
        sd_s = hypot(here.along_sd, seconds * here.speed_sd) / here.speed
        return cls(here.time_ns + round(seconds * 1e9), sd_s)


def is_near(here: Here, settings: PassageSettings) -> bool:
    """Whether a gate is commanded for a vehicle: it arrives soon, or is close to the gate line."""
    if not here.along < settings.crossed_m:
        return False
    return -here.along <= max(settings.gate_lead_m, settings.gate_lead_s * here.speed)


def refusal(passage: Passage, ahead: Passage | None) -> CodedText | None:
    """Why the gate stays closed for a vehicle; None: it opens.

    `ahead` is another passage in the same lane of a stop-and-go gate that is nearer to its gate line.
    """
    if not passage.registered:
        return stated(explain(Code.NO_CONTRACT))
    if passage.doubt:
        return passage.doubt
    if ahead is not None:
        return stated(explain(Code.QUEUED, passage=reference_of(ahead.passage_id)))
    return None
