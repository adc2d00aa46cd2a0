"""Posteriors of the hypotheses, which of them survive, and which one is acted on.

Posterior = prior times likelihood of all that the monitors have said, over the sum of these. A hypothesis survives
while its posterior is above the integrity risk. One that alone survives, with more than `CERTAIN_PROBABILITY`, is
acted on: its source is not used. Of several survivors all sources are used.
"""

from collections.abc import Collection, Iterable, Mapping
from math import exp, log

from shared.messages.explanation import Explanation, explain
from shared.messages.trust import Belief, Hypothesis, Outcome

from ..codes import Code
from ..facts import SECOND_NS, Facts, Monitor, Posterior
from .evidence import MAX_LOG_LIKELIHOOD, Evidence, explained_by
from .priors import PRIOR, SUSPECTED

CERTAIN_PROBABILITY = 0.99
NO_FAULT = 1.0 - sum(PRIOR.values())  # prior of "nothing is wrong"
DRIFT_NS = 30 * SECOND_NS  # before the first accusation of a drift: its shortest window
RESTART_LOG_ODDS = (
    MAX_LOG_LIKELIHOOD  # sum of logarithms by which a hypothesis that survived a restart is above "nothing is wrong"
)


def suspected_priors(suspects: Collection[Hypothesis], risk: float) -> dict[Hypothesis, float]:
    """Priors while a test is exceeded or an offset is held: the suspects share a floor in proportion to their own.

    A floor for each of them would make them alike, whatever the table says of them.
    """
    total = sum(PRIOR[suspect] for suspect in suspects)
    return {suspect: max(PRIOR[suspect], SUSPECTED * risk * PRIOR[suspect] / total) for suspect in suspects}


class Beliefs:
    """Accumulated evidence of all monitors, and the posteriors that follow."""

    def __init__(self) -> None:
        self._evidence = {monitor: Evidence(monitor) for monitor in Monitor}
        self._earlier: dict[Hypothesis, float] = {}  # the same sums of a process before
        self._since_ns: dict[Hypothesis, int] = {}  # suspect time of those that a monitor has spoken for

    def resume(self, saved: Iterable[Belief], risk: float) -> None:
        """Go on with what a process before has believed of hypotheses that a monitor had spoken for."""
        found = [
            belief for belief in saved if belief.since_ns is not None and belief.survives and belief.probability > 0.0
        ]
        priors = suspected_priors([belief.hypothesis for belief in found], risk)
        for belief in found:
            if belief.since_ns is not None:
                self._since_ns[belief.hypothesis] = belief.since_ns
                self._earlier[belief.hypothesis] = (
                    log(belief.probability / priors[belief.hypothesis]) + RESTART_LOG_ODDS
                )

    def update(self, facts: Facts, open_ones: Collection[Hypothesis]) -> tuple[Posterior, ...]:
        """Use the statements of one time.

        Parameters
        ----------
        facts : Facts
            Of this time.
        open_ones : collection of Hypothesis
            Those whose contradiction has not ended: what speaks for them is kept although no monitor says so now.

        Returns
        -------
        tuple of Posterior
            The most probable first; "nothing is wrong" is one of them.
        """
        named = self._count(facts)
        for hypothesis in [known for known in self._since_ns if known not in named and known not in open_ones]:
            del self._since_ns[hypothesis]  # nothing has been said of a hypothesis that is not in it
            self._earlier.pop(hypothesis, None)
            for evidence in self._evidence.values():
                evidence.forget(hypothesis)
        is_contradicted = bool(named) or facts.conflict_open or facts.held_m is not None
        suspected = suspected_priors(self._since_ns, facts.risk) if is_contradicted else {}
        return self._posteriors(facts.risk, {**PRIOR, **suspected})

    def _count(self, facts: Facts) -> set[Hypothesis]:
        """Count what the monitors say; returns the hypotheses that some monitor speaks for."""
        named: set[Hypothesis] = set()
        for monitor in Monitor:
            statement = facts.statement(monitor)
            if statement.outcome is not Outcome.ACCUSES:
                continue
            for hypothesis in explained_by(statement, odometer_in_use=facts.odometer_in_use):
                named.add(hypothesis)
                if monitor is Monitor.HYPOTHESES:
                    continue  # it decides where others have found a contradiction
                # Flags of the receiver alone are no conflict, and late velocities alone are none of its time.
                if (monitor is Monitor.EVIDENCE) is not (hypothesis is Hypothesis.RECEIVER_TIME):
                    continue
                since_ns = facts.time_ns if statement.suspect_since_ns is None else statement.suspect_since_ns
                self._suspect(hypothesis, monitor, since_ns, facts.time_ns)
        for monitor, evidence in self._evidence.items():
            evidence.update(facts.statement(monitor), facts, self._since_ns)
        return named

    def _suspect(self, hypothesis: Hypothesis, monitor: Monitor, since_ns: int, time_ns: int) -> None:
        """Note since when a hypothesis is suspected; a drift grew at some time of its window, and does not say when."""
        known_ns = self._since_ns.get(hypothesis)
        if monitor is Monitor.DRIFT:
            since_ns = max(since_ns, time_ns - DRIFT_NS) if known_ns is None else known_ns
        self._since_ns[hypothesis] = since_ns if known_ns is None else min(known_ns, since_ns)

    def _posteriors(self, risk: float, priors: Mapping[Hypothesis, float]) -> tuple[Posterior, ...]:
        sums = [*(evidence.sums for evidence in self._evidence.values()), self._earlier]
        said = [of_one for of_one in sums if of_one]
        weights = {k: prior * exp(sum([of_one.get(k, 0.0) for of_one in said])) for k, prior in priors.items()}
        weights[Hypothesis.NOTHING] = NO_FAULT
        total = sum(weights.values())
        shares = {k: weight / total for k, weight in weights.items()}
        surviving = {k for k, share in shares.items() if share > risk and k in self._since_ns}
        found = [
            Posterior(
                k,
                PRIOR.get(k, NO_FAULT),
                share,
                k in surviving or (k is Hypothesis.NOTHING and share > risk),
                surviving == {k} and share > CERTAIN_PROBABILITY,
                self._since_ns.get(k),
            )
            for k, share in shares.items()
        ]
        return tuple(sorted(found, key=lambda posterior: -posterior.probability))

    def why(self, hypothesis: Hypothesis) -> Explanation:
        """Which monitors speak for it and against it."""
        if hypothesis is Hypothesis.NOTHING:
            return explain(Code.FALSE_ALARMS if self._since_ns else Code.NO_ACCUSATION)
        sums = {monitor: evidence.sums.get(hypothesis, 0.0) for monitor, evidence in self._evidence.items()}
        supporting = tuple(monitor for monitor, total in sums.items() if total > 0.0) or None
        contradicting = tuple(monitor for monitor, total in sums.items() if total < 0.0) or None
        if supporting is None and contradicting is None:
            return explain(Code.NO_EVIDENCE)
        code = Code.CONTRADICTED if supporting is None else Code.DISPUTED if contradicting else Code.SUPPORTED
        return explain(code, supporting=supporting, contradicting=contradicting)
