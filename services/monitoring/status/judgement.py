"""What `monitoring.health` reports of processes, topics and problems, or why no such report can be had."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from shared.bus.codes import broker_down
from shared.messages.explanation import Explanation, explain, process
from shared.messages.operation import DeadlineReport, Outage, Problem, ProcessStatus, TopicAge
from shared.processes import BY_NAME as PROCESS_ROWS
from shared.topics import BY_NAME
from shared.words.words import CodedText, reason, stated

from .views.codes import Code

WATCHDOG = "monitoring.health"
BROKER_SILENT_NS = 2_000_000_000  # our own heartbeat returns through the broker twice a second
REPORT_DEADLINE_NS = round((BY_NAME["deadline/report"].silent_after_s or 2.0) * 1e9)
LENGTH = 200


@dataclass(frozen=True)
class Judgement:
    """The status of every process, the topics by name, and the problems; `complete` unless there is no report."""

    statuses: Mapping[str, ProcessStatus]
    problems: tuple[Problem, ...] = ()
    topics: Mapping[str, TopicAge] = field(default_factory=dict)
    restarts: Mapping[str, int] = field(default_factory=dict)
    complete: bool = True

    @property
    def down(self) -> tuple[str, ...]:
        """Processes that do no work, in the order of the data flow."""
        return tuple(name for name, status in self.statuses.items() if status.down)

    def cause(self, topic: str) -> CodedText | None:
        """Give the root cause of the silence of a topic; None if it is not known, or not silent."""
        if not self.complete:
            if not self.problems:
                return stated(explain(Code.NOT_REPORTED_YET, process(WATCHDOG)))
            return CodedText(self.problems[0].text, self.problems[0].text_code)
        row = self.topics.get(topic)
        return None if row is None or row.cause is None else CodedText(row.cause, row.cause_code)


def from_report(report: DeadlineReport) -> Judgement:
    """Take over what was reported; a process that is not listed is not part of this vehicle."""
    reported = {row.process: row for row in report.processes}
    return Judgement(
        {name: reported[name].status if name in reported else ProcessStatus.ABSENT for name in PROCESS_ROWS},
        report.problems,
        {row.topic: row for row in report.topics},
        {row.process: row.restarts for row in report.processes},
    )


def unavailable(expected: Collection[str], problem: Problem | None) -> Judgement:
    """Judge without a report: nothing is known of the processes; without a problem they have yet to start."""
    status = ProcessStatus.WAITING if problem is None else ProcessStatus.UNKNOWN
    statuses = {name: status if name in expected else ProcessStatus.ABSENT for name in PROCESS_ROWS}
    return Judgement(statuses, () if problem is None else (problem,), complete=False)


def broker_problem(since_ns: int, *, connected: bool) -> Problem:
    """Judgement while the broker does not work; everything else is unknown."""
    return _problem("broker", broker_down(connected=connected), since_ns)


def watchdog_problem(since_ns: int) -> Problem:
    """Judgement while `monitoring.health` does not report; everything else is unknown."""
    return _problem(WATCHDOG, explain(Code.NOT_REPORTED, process(WATCHDOG)), since_ns)


def _problem(what: str, why: Explanation, since_ns: int) -> Problem:
    outage = Outage(what=what, since_ns=since_ns, cause=reason(why), cause_code=why)
    return Problem(what=what, text=outage.cause, text_code=why, since_ns=since_ns, outage=outage)


class OutageList:
    """The newest outages, as `monitoring.health` published them; a later event of one replaces the earlier."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, int], Outage] = {}

    def note(self, outage: Outage) -> None:
        """Take the begin or the end of an outage."""
        self._known[outage.what, outage.since_ns] = outage
        while len(self._known) > LENGTH:
            del self._known[next(iter(self._known))]

    def closed(self) -> list[Outage]:
        """List the outages that are over, newest first."""
        over = (outage for outage in self._known.values() if outage.until_ns is not None)
        return sorted(over, key=lambda outage: outage.since_ns, reverse=True)
