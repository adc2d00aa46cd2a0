"""Makes one verdict on the position of what fusion and the monitors publish."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from math import hypot

from pydantic import Field

from shared.load import CHECKS
from shared.messages.base import Tick
from shared.messages.explanation import Explanation, explain
from shared.messages.navigation import NavigationPhase, NavigationSolution, NavigationState
from shared.messages.operation import ProcessLoad
from shared.messages.trust import (
    Belief,
    Hypothesis,
    Outcome,
    TrustEvent,
    TrustHypotheses,
    TrustLevel,
    TrustMonitor,
    TrustRecord,
    TrustState,
)
from shared.runtime.config import VehicleSettings
from shared.words.words import REASON_LENGTH, reason

from .after_loss import InterferenceLoss
from .codes import Code
from .facts import DEFAULT_RISK, REQUIRED, Alternative, Facts, Limits, Monitor, Solution, Statement
from .hypotheses.beliefs import Beliefs
from .hypotheses.comparison import compared
from .readmission import AGREES, REACHING_BACK, Admission, Readmission, judge_gnss, judge_imu
from .record import OpenConflict, Recorder, is_suspect
from .start import Start
from .steady import VerdictHysteresis

In = (
    TrustMonitor
    | TrustHypotheses
    | NavigationSolution
    | NavigationState
    | TrustState
    | TrustRecord
    | ProcessLoad
    | Tick
)
Out = TrustState | TrustRecord | TrustEvent
MONITORS = frozenset(Monitor)
WITH_POSITION = (NavigationPhase.NAVIGATING, NavigationPhase.COASTING, NavigationPhase.GNSS_ONLY)
RESTART_NS = 10_000_000_000  # longest time between the last verdict of a process and the first of the next
ALTERNATIVES_NS = 5_000_000_000  # age at which solutions of the bank are no longer used
ODOMETER_SILENT_S = 3.0  # after which it decides nothing


class Config(VehicleSettings):
    """Deadlines of the monitors and thresholds of the verdict; the alert limits are those of `[vehicle]`."""

    near_share: float = Field(
        default=0.8, gt=0.0, le=1.0, description="share of the alert limit above which a protection level means CAUTION"
    )
    solution_silent_after_s: float = Field(
        default=2.0, gt=0.0, description="age of the navigation solution from which the verdict is NO_FIX"
    )
    coasting_after_s: float = Field(
        default=3.0, gt=0.0, description="time without a used GNSS fix from which the verdict is DEAD_RECKONING"
    )
    monitor_silent_after_s: float = Field(
        default=5.0, gt=0.0, description="age of a monitor's statement from which it counts as not evaluated"
    )
    required_monitors: tuple[Monitor, ...] = Field(
        default=REQUIRED, description="monitors without whose statements the verdict is at best CAUTION"
    )


class Process:
    """Publishes the verdict once a second and when it changes, and each change as an event."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self.rejects: Counter[str] = Counter()
        self._time_ns = 0
        self._solution: Solution | None = None
        self._navigation: NavigationState | None = None
        self._limits = _limits(config)
        self._monitors: dict[Monitor, TrustMonitor] = {}
        self._statements: dict[Monitor, Statement] = {}  # of these messages
        self._gnss = Readmission()
        self._imu = Readmission()
        self._ended_ns = -(2**62)  # end of the last conflict
        self._odometer_excluded = False
        self._alike_since_ns: int | None = None  # since when solutions without both have shown that they are falsified
        self._beliefs = Beliefs()
        self._steady = VerdictHysteresis()
        self._alternatives: TrustHypotheses | None = None  # newest, of core.fusion
        self._load: ProcessLoad | None = None  # of core.fusion
        self._start, self._recorder, self._after_loss = Start(), Recorder(), InterferenceLoss()
        self._published: TrustState | None = None
        self._record: TrustRecord | None = None  # of an earlier process, until the first verdict
        self._saved: TrustState | None = None  # of an earlier process, until the first verdict

    def handle(self, message: In) -> Iterator[Out]:
        """Use a message, and publish what follows from it."""
        match message:
            case TrustMonitor():
                if message.monitor not in MONITORS:
                    self.rejects["unknown monitor"] += 1
                    return
                monitor = Monitor(message.monitor)
                self._monitors[monitor], self._statements[monitor] = message, _statement(monitor, message)
                self._time_ns = max(self._time_ns, message.sampled_ns)
            case NavigationSolution():
                self._solution = _solution(message)
                self._recorder.see(message)
                self._time_ns = max(self._time_ns, message.sampled_ns)
            case NavigationState():
                self._navigation = message
                return
            case TrustHypotheses():
                if message.source == "core.fusion":
                    self._alternatives = message
                    self._statements[Monitor.HYPOTHESES] = compared(message)
                return
            case ProcessLoad():
                self._load = message
                return
            case TrustRecord() | TrustState():
                self._keep_of_earlier(message)
                return
            case Tick():
                self._time_ns = message.now_ns
        yield from self._judge(at_once=isinstance(message, Tick))

    def _keep_of_earlier(self, message: TrustRecord | TrustState) -> None:
        """Keep what a process before has published, until the first verdict; later ones are its own."""
        if isinstance(message, TrustRecord):
            known = self._record  # the broker may have kept the same one
            if self._published is None and (known is None or message.sampled_ns > known.sampled_ns):
                self._record = message
        else:
            self._saved = message if self._published is None else None

    def _resume(self) -> None:
        """Go on with the exclusion of an earlier process, so that a restart readmits nothing."""
        saved, self._saved = self._saved, None
        record, self._record = self._record, None
        if record is not None:
            self._resume_record(record)
        if (
            saved is not None
            and (saved.gnss_excluded or saved.suspect_since_ns is not None)
            and 0 <= self._time_ns - saved.sampled_ns <= RESTART_NS
        ):
            self._beliefs.resume(saved.beliefs, DEFAULT_RISK)
            since_ns = saved.sampled_ns if saved.suspect_since_ns is None else saved.suspect_since_ns
            self._gnss.update(
                saved.sampled_ns, accused=True, agrees=False, decided=saved.gnss_excluded, suspect_since_ns=since_ns
            )

    def _resume_record(self, record: TrustRecord) -> None:
        """Go on with what was open before a power cut.

        No source is excluded by it: fusion has no solution without that source any more, and what it holds covers both.
        """
        self._start.recall(record)
        self._recorder.recall(record)
        self._beliefs.resume(filter(is_suspect, record.beliefs), DEFAULT_RISK)
        for source, suspect_ns in (
            (self._gnss, record.suspect_since_ns), (self._imu, record.imu_suspect_since_ns)
        ):  # fmt: skip
            if suspect_ns is not None:
                source.update(self._time_ns, accused=True, agrees=False, suspect_since_ns=suspect_ns)
        self._alike_since_ns, self._after_loss.since_ns = record.alike_since_ns, record.disturbed_since_ns
        self._odometer_excluded = record.odometer_excluded

    def close(self) -> Iterator[TrustRecord]:
        """Note that the process was stopped in order."""
        yield from self._recorder.end(self._published, self._open_sources(), self._start.confirmed_ns)

    def _open_sources(self) -> OpenConflict:
        return OpenConflict(
            self._gnss.suspect_since_ns,
            self._imu.suspect_since_ns,
            self._alike_since_ns,
            self._after_loss.since_ns,
            self._odometer_excluded,
        )

    def _judge(self, *, at_once: bool) -> Iterator[Out]:
        self._resume()
        facts = self._facts(Admission(self._gnss.suspect_since_ns is not None, False, self._gnss.suspect_since_ns))
        if facts.conflict_open and (facts.excluded_test_ratio or 0.0) > AGREES:
            self._gnss.was_apart = True
        beliefs = self._beliefs.update(facts, self._open())
        unconfirmed = self._start.unconfirmed(facts, self._navigation)
        facts = facts.with_decided(beliefs=beliefs, gnss_was_apart=self._gnss.was_apart, start_unconfirmed=unconfirmed)
        self._follow_alike(facts)
        facts, admission = self._admitted(facts)
        found = self._steady.after(facts)
        before = self._published
        level = found.state
        horizontal_m, vertical_m = facts.solution.protection_levels_m if facts.solution else (None, None)
        changed = before is None or before.state is not level
        if not (changed or at_once):
            return
        state = TrustState(
            sampled_ns=facts.time_ns,
            state=level,
            since_ns=facts.time_ns if before is None or changed else before.since_ns,
            row=found.row,
            reasons=tuple(reason(explanation) for explanation in found.reasons),
            findings=tuple(reason(finding) for finding in found.findings),
            reason_codes=found.reasons,
            finding_codes=found.findings,
            gnss_excluded=admission.excluded,
            suspect_since_ns=admission.suspect_since_ns,
            gnss_disturbed_since_ns=facts.disturbed_since_ns,
            odometer_excluded=facts.odometer_excluded,
            imu_excluded=facts.imu_excluded,
            beliefs=tuple(_beliefs(facts, self._beliefs)),
            protection_level_horizontal_m=horizontal_m,
            protection_level_vertical_m=vertical_m,
            alert_limit_horizontal_m=facts.limits.horizontal_m,
            alert_limit_vertical_m=facts.limits.vertical_m,
            monitors=tuple(self._current(facts, monitor) for monitor in Monitor),
        )
        self._published = state
        yield state
        yield from self._recorder.update(state, self._open_sources(), self._start.confirmed_ns)
        if changed:
            earlier = before.state if before is not None else TrustLevel.INITIALISING
            if before is not None or level is not TrustLevel.INITIALISING:
                yield TrustEvent(
                    sampled_ns=state.sampled_ns, before=earlier, after=level, reasons=state.reasons,
                    reason_codes=state.reason_codes, monitors=state.monitors,
                )  # fmt: skip

    def _heard(self, statement: Statement) -> Statement:
        """Statement as it counts: an accusation whose window begins before the end of a conflict is part of that."""
        if (
            statement.monitor in REACHING_BACK
            and statement.outcome is Outcome.ACCUSES
            and (statement.since_ns or statement.stated_ns) - round((statement.window_s or 0.0) * 1e9) <= self._ended_ns
        ):
            return replace(
                statement, outcome=Outcome.NOT_EVALUATED, accused=(), statistic=None, suspect_since_ns=None,
                reason="", why=explain(Code.WINDOW_REACHES_BACK),
            )  # fmt: skip
        return statement

    def _open(self) -> frozenset[Hypothesis]:
        """Hypotheses whose contradiction has not ended."""
        found: set[Hypothesis] = set()
        if self._gnss.suspect_since_ns is not None:
            found |= {Hypothesis.GNSS, Hypothesis.IMU, Hypothesis.GNSS_AND_ODOMETER}
        if self._imu.suspect_since_ns is not None:
            found.add(Hypothesis.IMU)
        if self._alike_since_ns is not None:
            found.add(Hypothesis.GNSS_AND_ODOMETER)
        return frozenset(found)

    def _follow_alike(self, facts: Facts) -> None:
        """Keep the hypothesis that GNSS and odometer are falsified alike, once solutions without both have shown it.

        Their solution agrees with that of GNSS for ever. It ends by the inertial sensors: centripetal speeds of later
        bends that pass.
        """
        shown = facts.statement(Monitor.HYPOTHESES)
        if facts.survives(Hypothesis.GNSS_AND_ODOMETER) and len(shown.accused) > 1:
            self._alike_since_ns = self._alike_since_ns or facts.time_ns
        scale, since_ns = facts.statement(Monitor.COHERENT_SCALE), self._alike_since_ns
        if since_ns is not None and (
            not facts.survives(Hypothesis.GNSS_AND_ODOMETER)
            or (scale.outcome is Outcome.PASS and (scale.since_ns or 0) > since_ns)
        ):
            self._alike_since_ns = None

    def _admitted(self, facts: Facts) -> tuple[Facts, Admission]:
        """Decide which sources are used; returns the facts with that, and the admission of GNSS."""
        self._after_loss.update(facts)
        judged, time_ns = self._after_loss.judged(judge_gnss(facts)), facts.time_ns
        if judged.contradicted:  # another source is wrong
            self._gnss.end(time_ns)
        admission = self._gnss.update(
            time_ns, accused=judged.accused, agrees=judged.agrees, decided=judged.decided,
            contradicted=judged.contradicted, declined=facts.exclusion_declined,
            suspect_since_ns=judged.suspect_since_ns, within_s=judged.within_s,
        )  # fmt: skip
        if facts.conflict_open and not admission.open:
            self._ended_ns = time_ns
            self._after_loss.end()
        imu = judge_imu(facts)
        imu_open = self._imu.suspect_since_ns is not None
        wanted = imu.accused if imu_open else imu.decided
        of_imu = self._imu.update(
            time_ns, accused=wanted, agrees=imu.agrees, decided=imu.decided,
            contradicted=facts.acts_on(Hypothesis.GNSS), suspect_since_ns=imu.suspect_since_ns, within_s=imu.within_s,
        )  # fmt: skip
        if imu_open and not of_imu.open:
            self._ended_ns = time_ns
        if of_imu.excluded:
            self._gnss.end(time_ns)
            self._after_loss.end()
            admission = Admission(open=False)
        accused = facts.acts_on(Hypothesis.ODOMETER)
        self._odometer_excluded = accused or (self._odometer_excluded and facts.survives(Hypothesis.ODOMETER))
        confirmed = self._navigation is not None and self._navigation.imu_excluded
        facts = facts.with_decided(
            conflict_open=admission.open, gnss_excluded=admission.excluded,
            exclusion_confirmed=self._confirmed(admission), imu_excluded=of_imu.excluded,
            imu_exclusion_confirmed=of_imu.excluded and confirmed, odometer_excluded=self._odometer_excluded,
            disturbed_since_ns=self._after_loss.since_ns,
        )  # fmt: skip
        return facts, admission

    def _current(self, facts: Facts, monitor: Monitor) -> TrustMonitor:
        """Statement of a monitor as the verdict uses it: a silent one is not evaluated."""
        used, last = facts.statement(monitor), self._monitors.get(monitor)
        if last is not None and used.why is None and used.outcome.value == last.outcome.value:
            return last
        text = reason(used.why) if used.why else used.reason[:REASON_LENGTH]
        return TrustMonitor(
            sampled_ns=facts.time_ns if last is None else last.sampled_ns, monitor=monitor.value,
            outcome=used.outcome, reason=text, reason_code=used.why,
            accused=used.accused, since_ns=used.since_ns, suspect_since_ns=used.suspect_since_ns,
            statistic=used.statistic, threshold=used.threshold, false_alarm_rate=used.false_alarm_rate,
            window_s=used.window_s, doubtful=used.doubtful,
        )  # fmt: skip

    def _facts(self, admission: Admission) -> Facts:
        """Facts of now."""
        state = self._navigation
        return Facts(
            self._time_ns,
            self._solution,
            {monitor: self._heard(statement) for monitor, statement in self._statements.items()},
            conflict_open=admission.open,
            gnss_excluded=admission.excluded,
            exclusion_confirmed=self._confirmed(admission),
            excluded_test_ratio=None if state is None else state.excluded_test_ratio,
            other_distance_m=None if state is None else state.other_distance_m,
            other_level_m=None if state is None else state.other_level_m,
            without_gnss_level_m=None if state is None else state.without_gnss_level_m,
            exclusion_declined=state is not None and state.exclusion_declined is not None,
            held_m=None if state is None or not any(_held_m(state)) else _held_m(state),
            held_why=_held_why(state),
            odometer_in_use=state is not None
            and state.odometer_age_s is not None
            and state.odometer_age_s <= ODOMETER_SILENT_S,
            alternatives=self._newest_alternatives(),
            satellites_left_out=frozenset() if state is None else frozenset(state.satellites_left_out),
            merge_lag_s=0.0 if state is None else state.merge_lag_s or 0.0,
            fixes_late_s=None if state is None else state.fixes_late_s,
            checks_paused=self._load is not None and any(work in CHECKS for work in self._load.paused),
            limits=self._limits,
        )

    def _newest_alternatives(self) -> dict[Hypothesis, Alternative]:
        """Solutions of the bank, if they are not too old."""
        newest = self._alternatives
        if newest is None or self._time_ns - newest.sampled_ns > ALTERNATIVES_NS:
            return {}
        return {
            solution.hypothesis: Alternative(
                hypot(*solution.apart_ned_m[:2]),
                solution.protection_level_horizontal_m,
                solution.separation is not None and solution.separation_limit is not None
                and solution.separation <= solution.separation_limit,
            )
            for solution in newest.solutions
        }  # fmt: skip

    def _confirmed(self, admission: Admission) -> bool:
        """Whether fusion confirms an exclusion by its solution, which has no GNSS since the suspect time."""
        suspect_since_ns = admission.suspect_since_ns
        excluded_ns = None if self._solution is None else self._solution.gnss_excluded_since_ns
        return excluded_ns is not None and suspect_since_ns is not None and excluded_ns <= suspect_since_ns


def _held_m(state: NavigationState) -> tuple[float, float]:
    return state.held_horizontal_m or 0.0, state.held_vertical_m or 0.0


def _held_why(state: NavigationState | None) -> tuple[Explanation, ...]:
    if state is None or state.held_code is None:
        return ()
    return (state.held_code, *(state.held_end_codes or ()))


def _beliefs(facts: Facts, said: Beliefs) -> Iterator[Belief]:
    """Posteriors with the solutions that belong to them, as a message."""
    for belief in facts.beliefs:
        other, why = facts.alternatives.get(belief.hypothesis), said.why(belief.hypothesis)
        yield Belief(
            hypothesis=belief.hypothesis, prior=belief.prior, probability=min(1.0, belief.probability),
            survives=belief.survives,
            acted_on=belief.acted_on, reason=reason(why), reason_code=why, since_ns=belief.since_ns,
            distance_m=None if other is None else other.distance_m, level_m=None if other is None else other.level_m,
        )  # fmt: skip


def _limits(config: Config) -> Limits:
    return Limits(
        *config.vehicle.alert_limits_m,
        near_share=config.near_share,
        solution_silent_after_s=config.solution_silent_after_s,
        coasting_after_s=config.coasting_after_s,
        silent_after_s=dict.fromkeys(Monitor, config.monitor_silent_after_s),
        required=frozenset(config.required_monitors),
    )


def _solution(message: NavigationSolution) -> Solution:
    return Solution(
        message.sampled_ns,
        message.phase in WITH_POSITION,
        message.phase.value,
        message.protection_level_horizontal_m,
        message.protection_level_vertical_m,
        message.gnss_age_s,
        message.gnss_excluded_since_ns,
        message.integrity_risk or DEFAULT_RISK,
        gnss_only=message.phase is NavigationPhase.GNSS_ONLY,
    )


def _statement(monitor: Monitor, message: TrustMonitor) -> Statement:
    return Statement(
        monitor, message.outcome, message.sampled_ns, message.reason, message.accused,
        message.statistic, message.threshold, message.false_alarm_rate, message.window_s, message.since_ns,
        message.suspect_since_ns, message.doubtful,
        tuple(test.name for test in message.tests if test.outcome is Outcome.ACCUSES),
    )  # fmt: skip
