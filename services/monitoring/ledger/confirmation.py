"""Whether detectors confirm passages: alone in their lane, or several that overlap, of which the pulses are counted."""

from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass, field
from enum import Enum

from shared.messages.explanation import Explanation, explain

from .codes import Code

TIGHT_SD = 3.0  # standard deviations of crossing and pulse within which a passage need not wait for its neighbours


class Verdict(Enum):
    """What follows for the passages of a group."""

    STANDS = "stands"  # each keeps its outcome; what waits for it is charged
    WAITS = "waits"
    REVIEW = "review"
    ALONE = "alone"  # the contracts are charged, and what has no pulse left is a ghost
    GHOSTS = "ghosts"  # no contract among them, and no vehicle


@dataclass(frozen=True)
class Claim:
    """A passage that has crossed the gate line, as one that a pulse may confirm."""

    passage_id: str
    overlaps: frozenset[str]  # passages within its vehicle's length at the gate line, as far as they were seen
    has_detector: bool  # its lane
    is_charge: bool  # charged, or to be charged
    is_derivable: bool
    pulse_sds: float | None  # distance of its pulse in standard deviations; None: no pulse is left for it
    waited: bool  # long enough for the pulses and passages around it
    authenticated: bool = False
    pulse: int | None = None  # key of its pulse
    explains: frozenset[int] = frozenset()  # pulses of its lane within three standard deviations of its crossing
    is_counted: bool = True  # with the probability that is required, given all pulses and crossings around it
    has_lane: bool = True  # by its CAM; without one it waits for what is around it
    probability: float | None = None  # that it was counted, by its pulse
    has_second: bool = False  # a pulse of another vehicle is in its lane within three standard deviations

    @property
    def is_confirmed(self) -> bool:
        """Whether it has a pulse, which a vehicle before or behind it cannot claim any more."""
        if self.pulse_sds is None or not self.is_counted:
            return False
        return self.waited or (self.has_lane and self.pulse_sds <= TIGHT_SD and not self.has_second)


@dataclass(frozen=True)
class Judgement:
    """What follows for a group, why, and where there are ghosts: which, and the pulses of what is charged."""

    verdict: Verdict
    why: Explanation | None = None
    charged: Mapping[str, int] = field(default_factory=dict)  # key of the pulse by passage
    ghosts: tuple[str, ...] = ()


def groups(claims: Mapping[str, Claim]) -> list[list[Claim]]:
    """Join the passages that overlap each other, directly or by another one; a passage alone is a group.

    What is not authenticated is in no group of what is.
    """
    group_of = {passage_id: {passage_id} for passage_id in claims}
    for claim in claims.values():
        for other in claim.overlaps & claims.keys():
            if claims[other].authenticated != claim.authenticated:
                continue
            joined = group_of[claim.passage_id] | group_of[other]
            group_of.update(dict.fromkeys(joined, joined))
    unique = {min(members): members for members in group_of.values()}
    return [[claims[passage_id] for passage_id in sorted(members)] for _, members in sorted(unique.items())]


def judge(group: Iterable[Claim], known: Set[str]) -> Judgement:
    """Decide on passages that overlap one another, or on one alone.

    Parameters
    ----------
    group : iterable of Claim
        The passages of which final statements are there.
    known : set of str
        IDs of the group; one that a claim overlaps and that is not among them has no final statement yet.

    Returns
    -------
    Judgement
        The verdict, and why there is a review.

    Notes
    -----
    Detectors count vehicles. As many pulses as passages: all stand. Fewer: one of them is not there, and which one no
    CAM can say, so that none is dropped and none is charged, but for one case: every contract is authenticated and has
    a pulse of its own within three standard deviations. Then all contracts are charged, whatever stations without
    contract are around them, and those of these that no pulse is left for are ghosts. Without detectors a group stands
    if at most one of it is charged: a vehicle without contract ahead must not make the passage behind it free.
    """
    claims = list(group)
    charges = [claim for claim in claims if claim.is_charge]
    if any(not claim.is_derivable for claim in charges):
        return Judgement(Verdict.REVIEW, explain(Code.NOT_DERIVABLE))
    is_complete = all(claim.overlaps <= known or claim.waited for claim in claims)
    counted = all(claim.has_detector for claim in claims)
    if is_complete and (all(claim.is_confirmed for claim in claims) if counted else len(charges) <= 1):
        return Judgement(Verdict.STANDS)
    if not (all(claim.waited for claim in claims) if counted else is_complete):
        return Judgement(Verdict.WAITS)
    if counted and not charges and all(claim.overlaps for claim in claims):
        return Judgement(Verdict.GHOSTS)
    if counted and charges and (charged := _own_pulses(charges, claims)):
        taken = set(charged.values())
        others = [claim for claim in claims if not claim.is_charge]
        ghosts = tuple(claim.passage_id for claim in others if claim.pulse is None or claim.pulse in taken)
        return Judgement(Verdict.ALONE, explain(Code.ALONE, ghost_count=len(ghosts)), charged, ghosts)
    return Judgement(Verdict.REVIEW, _doubt(claims, len(charges), counted=counted))


def _own_pulses(charges: list[Claim], claims: list[Claim]) -> dict[str, int]:
    """Assign to each authenticated contract one pulse of its group, within three standard deviations of its crossing.

    Empty if that cannot be done for all of them. A contract keeps the pulse that it has; one without takes that of a
    station without contract, or of a contract that another pulse is left for (augmenting paths).
    """
    if len(claims) < 2 or not all(charge.authenticated for charge in charges):
        return {}
    pulses = {claim.pulse for claim in claims if claim.pulse is not None}
    charge_of = {
        charge.pulse: charge for charge in charges if charge.pulse is not None and charge.pulse in charge.explains
    }

    def assign(charge: Claim, tried: set[int]) -> bool:
        for pulse in sorted((charge.explains & pulses) - tried, key=lambda pulse: (pulse in charge_of, pulse)):
            tried.add(pulse)
            if pulse not in charge_of or assign(charge_of[pulse], tried):
                charge_of[pulse] = charge
                return True
        return False

    if not all(charge.pulse in charge.explains or assign(charge, set()) for charge in charges):
        return {}
    return {charge.passage_id: pulse for pulse, charge in charge_of.items()}


def _doubt(claims: list[Claim], charges: int, *, counted: bool) -> Explanation:
    """Say why passages are to be reviewed."""
    if not counted:
        return explain(Code.OVERLAP_WITHOUT_DETECTOR, passage_count=charges)
    if len(claims) == 1:
        claim = claims[0]
        if claim.pulse_sds is None:
            return explain(Code.NOT_COUNTED)
        return explain(Code.UNSURE, probability=claim.probability or 0.0)
    pulses = sum(claim.pulse_sds is not None for claim in claims)
    return explain(Code.OVERLAP_COUNTED, passage_count=len(claims), pulse_count=pulses)
