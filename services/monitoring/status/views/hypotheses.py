"""What may be wrong, for the page Trust and the map: beliefs of `core.trust`, and the solutions behind them."""

from collections.abc import Iterable, Sequence
from math import hypot

from shared.messages.trust import Belief, Hypothesis, HypothesisSolution, TrustHypotheses
from shared.words.words import said, words

from ..history.alternatives import Line, separation_ratio, worst
from .models.hypotheses import AlternativeTrack, HypothesisRow, SatelliteSolution
from .plain_words import who

Stated = tuple[str, TrustHypotheses]  # process and its newest message, while that is live


def suspected(beliefs: Iterable[Belief]) -> list[Belief]:
    """Select what survives and is spoken for; a hypothesis that only its prior keeps alive is not suspected."""
    return [
        belief
        for belief in beliefs
        if belief.hypothesis is not Hypothesis.NOTHING
        and belief.survives
        and (belief.acted_on or belief.since_ns is not None)
    ]


def figures(beliefs: Iterable[Belief]) -> list[str]:
    """Give probability and reason of each hypothesis that is suspected, for those who ask why."""
    return [
        f"{label}: {100.0 * belief.probability:.3g} %; {said(belief.reason, belief.reason_code)}"
        for belief in suspected(beliefs)
        for label in (words().name("belief", belief.hypothesis),)
    ]


def table(beliefs: Iterable[Belief], stated: Sequence[Stated]) -> dict[str, HypothesisRow]:
    """Show each hypothesis by its name: probability, what follows from it, and its solution or why it has none."""
    known = {belief.hypothesis: belief for belief in beliefs}
    return {
        hypothesis.value: _row(hypothesis, known.get(hypothesis), stated)
        for hypothesis in Hypothesis
        if hypothesis in known or _is_stated(hypothesis, stated)
    }


def _is_stated(hypothesis: Hypothesis, stated: Sequence[Stated]) -> bool:
    return any(
        any(solution.hypothesis is hypothesis for solution in message.solutions)
        or any(name is hypothesis for name, _ in message.missing)
        for _, message in stated
    )


def _row(hypothesis: Hypothesis, belief: Belief | None, stated: Sequence[Stated]) -> HypothesisRow:
    found = [(producer, solution) for producer, message in stated for solution in message.solutions]
    mine = [
        (producer, hypothesis_solution)
        for producer, hypothesis_solution in found
        if hypothesis_solution.hypothesis is hypothesis
    ]
    solution = worst([hypothesis_solution for _, hypothesis_solution in mine])
    missing = [why for _, message in stated for why in _missing(hypothesis, message)]
    distance_m, level_m = (belief.distance_m, belief.level_m) if belief else (None, None)
    if solution is not None and hypothesis is not Hypothesis.SATELLITES:
        distance_m = _distance_m(solution) if distance_m is None else distance_m
        level_m = solution.protection_level_horizontal_m if level_m is None else level_m
    return {
        "label": words().name("belief", hypothesis),
        "probability": None if belief is None else float(f"{belief.probability:.4g}"),
        "prior": None if belief is None else belief.prior,
        "survives": None if belief is None else belief.survives,
        "acted_on": bool(belief and belief.acted_on),
        "suspected": bool(belief and suspected((belief,))),
        "reason": None if belief is None else said(belief.reason, belief.reason_code),
        "since_ns": belief.since_ns if belief else None,
        "distance_m": _rounded(distance_m),
        "level_m": _rounded(level_m),
        "solutions": len(mine),
        "left_out": who(solution.left_out) if solution and solution.left_out else None,
        "ratio": None if solution is None else _ratio(solution),
        "missing": None if mine or not missing else "; ".join(missing),
        "source": ", ".join(dict.fromkeys(producer for producer, _ in mine)) or None,
    }


def _missing(hypothesis: Hypothesis, message: TrustHypotheses) -> list[str]:
    """Why a process has no solution of a hypothesis: by codes, else by the texts of an earlier release."""
    codes = dict(message.missing_codes)
    return [said(text, codes.get(name)) for name, text in message.missing if name is hypothesis]


def satellites(stated: Sequence[Stated]) -> list[SatelliteSolution]:
    """List the solutions without satellites, the largest separation over its limit first."""
    found = [
        solution
        for _, message in stated
        for solution in message.solutions
        if solution.hypothesis is Hypothesis.SATELLITES
    ]
    return [
        {
            "left_out": list(hypothesis_solution.left_out),
            "distance_m": _rounded(_distance_m(hypothesis_solution)),
            "vertical_m": _rounded(abs(hypothesis_solution.apart_ned_m[2])),
            "level_m": _rounded(hypothesis_solution.protection_level_horizontal_m),
            "level_vertical_m": _rounded(hypothesis_solution.protection_level_vertical_m),
            "separation": _rounded(hypothesis_solution.separation),
            "separation_limit": _rounded(hypothesis_solution.separation_limit),
            "ratio": _ratio(hypothesis_solution),
            "innovations": _rounded(hypothesis_solution.innovations),
        }
        for hypothesis_solution in sorted(found, key=lambda solution: separation_ratio(solution) or 0.0, reverse=True)
    ]


def tracks(lines: Iterable[Line]) -> list[AlternativeTrack]:
    """Show the lines of the map: places as [longitude, latitude] in degrees, as in GeoJSON."""
    return [
        {
            "hypothesis": line.hypothesis,
            "label": words().name("condition", line.hypothesis),
            "source": line.producer,
            "left_out": list(line.points[-1].left_out),
            "until_ns": line.points[-1].time_ns,
            "places": [
                (round(point.place.longitude_deg, 8), round(point.place.latitude_deg, 8)) for point in line.points
            ],
        }
        for line in lines
    ]


def _distance_m(solution: HypothesisSolution) -> float:
    return hypot(solution.apart_ned_m[0], solution.apart_ned_m[1])


def _ratio(solution: HypothesisSolution) -> float | None:
    ratio = separation_ratio(solution)
    return None if ratio is None else float(f"{ratio:.3g}")


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 2)
