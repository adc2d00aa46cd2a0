"""What is wrong now, each told once, at its root: a silent process rather than every topic that fell silent with it."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from enum import StrEnum

from shared.messages.operation import Freshness, ProcessState, RecordingState
from shared.processes import BY_NAME as PROCESS_ROWS
from shared.runtime.freshness import STARTUP_GRACE_S, freshness_of, limits_of
from shared.topics import BY_NAME, Topic, subscriptions

from .flow import ProcessFlow, TopicFlow

HEARTBEAT = limits_of(BY_NAME["health/+"])
DISK_LOW_BYTES = 1_000_000_000


class Status(StrEnum):
    """How a process looks from here."""

    READY = "ready"
    STARTING = "starting"
    ALERT = "alert"
    SILENT = "silent"  # no heartbeat within the deadline: stopped, stuck or overloaded
    LOST = "lost"  # its connection broke without a farewell: it crashed or was killed
    ENDED = "ended"  # it said farewell
    WAITING = "waiting"  # not seen yet, and the unit has just started
    MISSING = "missing"  # should run, was never seen
    ABSENT = "absent"  # the vehicle's file does not ask for it


DOWN = (Status.SILENT, Status.LOST, Status.ENDED, Status.MISSING)
_STATUS_OF = {
    ProcessState.INIT: Status.STARTING,
    ProcessState.READY: Status.READY,
    ProcessState.ALERT: Status.ALERT,
    ProcessState.DISCONNECTED: Status.ENDED,
    ProcessState.LOST: Status.LOST,
}


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong, since when, and what to look at: a process, a topic, or the broker."""

    what: str
    text: str
    since_ns: int | None
    lost: bool = True  # counts as an outage


def status_of(flow: ProcessFlow, now_ns: int, *, expected: bool, uptime_s: float) -> Status:
    """Judge one process by its newest health message and that message's age."""
    if flow.health is None or flow.heartbeat_ns is None:
        if not expected:
            return Status.ABSENT
        return Status.WAITING if uptime_s < STARTUP_GRACE_S else Status.MISSING
    status = _STATUS_OF[flow.health.state]
    age_s = (now_ns - flow.heartbeat_ns) * 1e-9
    if status not in (Status.LOST, Status.ENDED) and freshness_of(age_s, HEARTBEAT) is Freshness.STALE:
        return Status.SILENT
    return status


def root_cause(
    topic: Topic, statuses: Mapping[str, Status], freshness: Callable[[str], Freshness], seen: Collection[str] = ()
) -> str:
    """Follow a silent topic upstream to the process or device behind the silence."""
    producers = [name for name in topic.producers if statuses.get(name, Status.ABSENT) is not Status.ABSENT]
    if not producers:
        return f"nothing that runs here says {topic.name}"
    for name in producers:
        if statuses[name] in DOWN:
            return f"{name} is {statuses[name]}"
        if statuses[name] is Status.WAITING:
            return f"{name} has not been heard of yet"
    for producer in producers:
        for upstream in subscriptions(producer):
            if PROCESS_ROWS[producer].observes_all or upstream.name in seen or not upstream.rate_hz:
                continue
            if freshness(upstream.name) is freshness(topic.name):
                return root_cause(upstream, statuses, freshness, (*seen, topic.name))
    return _without_cause(producers[0], topic, freshness(topic.name))


def _without_cause(producer: str, topic: Topic, freshness: Freshness) -> str:
    never = freshness is Freshness.NEVER
    if PROCESS_ROWS[producer].layer == 1:
        return f"{producer} runs, but its device {'has sent nothing yet' if never else 'sends nothing'}"
    return (
        f"{producer} runs, but {f'has said nothing on {topic.name} yet' if never else f'says nothing on {topic.name}'}"
    )


def find_problems(
    topics: Mapping[str, TopicFlow],
    processes: Mapping[str, ProcessFlow],
    statuses: Mapping[str, Status],
    now_ns: int,
) -> list[Problem]:
    """List what is wrong while the broker answers, processes first, in the order of the data flow."""
    found = [
        Problem(name, f"{name} is {status}", processes[name].heartbeat_ns, lost=status is not Status.MISSING)
        for name, status in statuses.items()
        if status in DOWN
    ]

    def judge(name: str) -> Freshness:
        return topics[name].freshness(now_ns)

    for name, flow in topics.items():
        if flow.topic.per_process or judge(name) is not Freshness.STALE:
            continue
        if flow.topic.producers and _stale_at_its_root(flow, statuses, judge):
            cause = root_cause(flow.topic, statuses, judge)
            found.append(Problem(name, f"nothing on {name}: {cause}", flow.updated_ns))
    return found + _recording_problems(topics, now_ns)


def _stale_at_its_root(flow: TopicFlow, statuses: Mapping[str, Status], judge: Callable[[str], Freshness]) -> bool:
    """Tell whether the producer is up and has its own input, so that the silence starts here."""
    producer = flow.newest.producer if flow.newest else ""
    if statuses.get(producer, Status.ABSENT) in (*DOWN, Status.ABSENT):
        return False
    return not any(judge(topic.name) is Freshness.STALE for topic in subscriptions(producer) if topic.rate_hz)


def _recording_problems(topics: Mapping[str, TopicFlow], now_ns: int) -> list[Problem]:
    flow = topics["recording/state"]
    state = flow.message
    if not isinstance(state, RecordingState) or flow.freshness(now_ns) is Freshness.STALE:
        return []
    if not state.recording and state.reason:
        return [Problem("monitoring.recorder", f"not recording: {state.reason}", None, lost=False)]
    if state.free_bytes < DISK_LOW_BYTES:
        return [Problem("monitoring.recorder", f"only {state.free_bytes / 1e6:.0f} MB of disk left", None, lost=False)]
    return []
