"""Codes of problems and outages; `words.toml` beside this file has their words."""

from collections.abc import Collection
from enum import StrEnum

from shared.messages.explanation import Explanation, Reference, explain, process, topic
from shared.messages.operation import ProcessStatus

TOPICS_MAXIMUM = 16  # named by a code; `affected` has all of them


class Code(StrEnum):
    """What is wrong. The subject is the root cause: a process or a topic."""

    LOST = "health.lost"
    STALE = "health.stale"
    ENDED = "health.ended"
    MISSING = "health.missing"
    RESTARTED = "health.restarted"
    RESTARTED_WAITING = "health.restarted_waiting"  # some of its topics are not published again
    RUNNING_AGAIN = "health.running_again"
    RUNNING_AGAIN_WAITING = "health.running_again_waiting"
    BROKER_BACK = "health.broker_back"
    BROKER_BACK_WAITING = "health.broker_back_waiting"
    TOPIC_BACK_WAITING = "health.topic_back_waiting"
    NO_PRODUCER = "health.no_producer"
    PRODUCER_ENDED = "health.producer_ended"
    DEVICE_SILENT = "health.device_silent"
    NOT_PUBLISHED = "health.not_published"
    NOT_MONITORED = "health.not_monitored"  # while monitoring.health itself was restarted
    NOT_RECEIVED = "health.not_received"
    RUNS_TWICE = "health.runs_twice"
    REFUSED = "health.refused"
    CROWDED = "health.crowded"
    OVERLOADED = "health.overloaded"
    OVERLOADED_FUSION = "health.overloaded_fusion"  # with the delay of core.fusion
    SLOW = "health.slow"  # without a load that explains it
    SLOW_FUSION = "health.slow_fusion"
    DISK_LOW = "health.disk_low"


OF_STATUS = {
    ProcessStatus.LOST: Code.LOST,
    ProcessStatus.STALE: Code.STALE,
    ProcessStatus.ENDED: Code.ENDED,
    ProcessStatus.MISSING: Code.MISSING,
}


def down(name: str, status: ProcessStatus) -> Explanation:
    """Say how a process is down."""
    return explain(OF_STATUS[status], process(name))


def back(code: Code, waiting_code: Code, subject: Reference | None, waiting: Collection[str]) -> Explanation:
    """Say that a root cause is over, and which topics are not published again yet."""
    if not waiting:
        return explain(code, subject)
    return explain(waiting_code, subject, topics=tuple(topic(name) for name in [*waiting][:TOPICS_MAXIMUM]))
