"""Why a topic is silent: upstream along the contract to the process or device behind it."""

from collections.abc import Callable, Collection

from shared.processes import BY_NAME as PROCESS_ROWS
from shared.topics import TOPICS, Topic, subscriptions

from .process_watch import Condition


def inputs_of(process: str) -> tuple[Topic, ...]:
    """List the topics with a rate that drive a process; none for one that only observes."""
    if PROCESS_ROWS[process].observes_all:
        return ()
    return tuple(topic for topic in subscriptions(process) if topic.rate_hz is not None)


def producers_of(topic: Topic, configured: Collection[str]) -> tuple[str, ...]:
    """List the processes of this vehicle that may say something on a topic."""
    return tuple(name for name in topic.producers if name in configured)


def expected_topics(configured: Collection[str]) -> frozenset[str]:
    """Name the topics that this vehicle should have, by what it has for sensors.

    A topic is expected if one of its producers runs here and either needs no input or has at least
    one expected input: without a CAN bus nobody waits for wheel speeds.
    """
    expected: set[str] = set()
    while True:
        found = {
            topic.name
            for topic in TOPICS
            if topic.rate_hz is not None and not topic.per_process
            for producer in producers_of(topic, configured)
            if not inputs_of(producer) or any(need.name in expected for need in inputs_of(producer))
        }
        if found == expected:
            return frozenset(found)
        expected = found


class Upstream:
    """What the search for a cause needs to know of the unit at one moment."""

    def __init__(
        self,
        configured: Collection[str],
        condition: Callable[[str], Condition],
        stopped_ns: Callable[[Topic], int | None],
        producer: Callable[[Topic], str | None],
    ) -> None:
        self._configured, self._condition = configured, condition
        self._stopped_ns, self._producer = stopped_ns, producer

    def cause(self, topic: Topic, seen: tuple[str, ...] = ()) -> str | None:
        """Say why a topic is silent; None as long as a process on the way is neither up nor down for sure.

        Parameters
        ----------
        topic : Topic
            A topic that is silent.
        seen : tuple of str
            Topics passed on the way here, which end a circle.

        Returns
        -------
        str or None
            One clause that names the process or device at the root.
        """
        newest = self._producer(topic)
        producers = (newest,) if newest else producers_of(topic, self._configured)
        if not producers:
            return f"nothing in this vehicle says {topic.name}"
        conditions = {name: self._condition(name) for name in producers}
        for name, condition in conditions.items():
            if condition.down:
                return f"{name} is {condition}"
        if not all(condition is Condition.RUNNING for condition in conditions.values()):
            return None
        silent = self._silent_inputs(topic, producers, (*seen, topic.name))
        if silent:
            return self.cause(silent[0], (*seen, topic.name))
        if PROCESS_ROWS[producers[0]].layer == 1:
            return f"{producers[0]} runs, but its device sends nothing"
        return f"{producers[0]} runs, but says nothing on {topic.name}"

    def _silent_inputs(self, topic: Topic, producers: tuple[str, ...], seen: tuple[str, ...]) -> list[Topic]:
        """List silent inputs of the producers, the one that stopped last before the topic did first.

        An input that has been silent while the topic still lived is not to blame.
        """
        end_ns = self._stopped_ns(topic) or 0
        stops = [
            (stop_ns, need)
            for name in producers
            for need in inputs_of(name)
            if need.name not in seen and (stop_ns := self._stopped_ns(need)) is not None
        ]
        before = [(stop_ns, need) for stop_ns, need in stops if stop_ns <= end_ns + _slack_ns(need, topic)]
        return [need for _, need in sorted(before, key=lambda item: -item[0])]


def _slack_ns(*topics: Topic) -> int:
    """Two periods of each: how long one topic may go on after the last word of the other."""
    return sum(round(2e9 / (topic.rate_hz or 1.0)) for topic in topics)
