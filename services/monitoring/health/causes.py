"""Dependencies between topics and processes, by the tables: what is expected of a vehicle, and what lies upstream."""

from collections.abc import Collection
from functools import cache

from shared.processes import BY_NAME as PROCESS_ROWS
from shared.topics import TOPICS, Topic, needs


def producers_of(topic: Topic, configured: Collection[str]) -> tuple[str, ...]:
    """List the processes of this vehicle that publish a topic, other than data of another device that they pass on."""
    return tuple(
        name for name in topic.producers if name in configured and topic.name not in PROCESS_ROWS[name].passes_on
    )


@cache
def upstream_of(topic: Topic) -> frozenset[str]:
    """Name the processes and topics on which a topic depends, directly or not, and the topic itself."""
    found: set[str] = set()
    todo = [topic]
    while todo:
        found.add((one := todo.pop()).name)
        for producer in producers_of(one, one.producers):
            found.add(producer)
            todo += [need for need in needs(producer) if need.name not in found]
    return frozenset(found)


def expected_topics(configured: Collection[str]) -> frozenset[str]:
    """Name the topics that this vehicle should have, given its sensors.

    A topic is expected if one of its producers runs here and either needs no input or has at least
    one expected input: without a CAN bus no wheel speeds are expected.
    """
    expected: set[str] = set()
    while True:
        found = {
            topic.name
            for topic in TOPICS
            if topic.rate_hz is not None and not topic.per_process
            for producer in producers_of(topic, configured)
            if not needs(producer) or any(need.name in expected for need in needs(producer))
        }
        if found == expected:
            return frozenset(found)
        expected = found
