"""Why a topic is silent: upstream along the contract to the process or device behind it."""

from collections.abc import Callable, Collection

from shared.processes import BY_NAME as PROCESS_ROWS
from shared.topics import TOPICS, Topic, subscriptions

from .process_watch import Condition


def inputs_of(process: str) -> tuple[Topic, ...]:
    """List the topics with a rate that drive a process; none for one that only observes, or is not ours."""
    if process not in PROCESS_ROWS or PROCESS_ROWS[process].observes_all:
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
    """What the search for a cause needs to know of the unit at one moment.

    `stopped_ns` says when a topic fell silent (None while it is well), `last_ns` when a topic that is
    late but not yet silent was last heard, `producer` who spoke last on it.
    """

    def __init__(
        self,
        configured: Collection[str],
        *,
        condition: Callable[[str], Condition],
        stopped_ns: Callable[[Topic], int | None],
        last_ns: Callable[[Topic], int | None],
        producer: Callable[[Topic], str | None],
    ) -> None:
        self._configured, self._condition = configured, condition
        self._stopped_ns, self._last_ns, self._producer = stopped_ns, last_ns, producer

    def cause(self, topic: Topic, seen: tuple[str, ...] = ()) -> str | None:
        """Say why a topic is silent; None as long as something on the way is neither well nor silent for sure.

        Parameters
        ----------
        topic : Topic
            A topic that is silent.
        seen : tuple of str
            Topics passed on the way here, which end a circle.

        Returns
        -------
        str or None
            One clause that names the process or device at the root; None while that is open.
        """
        newest = self._producer(topic)
        producers = (newest,) if newest else producers_of(topic, self._configured)
        if not producers:
            return f"nothing in this vehicle says {topic.name}"
        conditions = {name: self._condition(name) for name in producers}
        down = [f"{name} is {condition}" for name, condition in conditions.items() if condition.down]
        if down:
            return down[0]
        unsure = any(condition is not Condition.RUNNING for condition in conditions.values())
        if unsure or self._inputs(topic, producers, self._last_ns, seen):
            return None
        silent = self._inputs(topic, producers, self._stopped_ns, seen)
        return self.cause(silent[0], (*seen, topic.name)) if silent else _own_fault(producers[0], topic)

    def _inputs(
        self, topic: Topic, producers: Collection[str], end_of: Callable[[Topic], int | None], seen: tuple[str, ...]
    ) -> list[Topic]:
        """List inputs of the producers that came to an end before the topic did, the last to end first.

        An input that has been silent while the topic still lived is less to blame than a later one.
        """
        end_ns = self._stopped_ns(topic) or 0
        ends = [
            (input_end_ns, need)
            for name in producers
            for need in inputs_of(name)
            if need.name not in (*seen, topic.name) and (input_end_ns := end_of(need)) is not None
        ]
        before = [
            (input_end_ns, need) for input_end_ns, need in ends if input_end_ns <= end_ns + _slack_ns(need, topic)
        ]
        return [need for _, need in sorted(before, key=lambda item: -item[0])]


def _own_fault(process: str, topic: Topic) -> str:
    if process not in PROCESS_ROWS:
        return f"{process} has stopped"
    if PROCESS_ROWS[process].layer == 1:
        return f"{process} runs, but its device sends nothing"
    return f"{process} runs, but says nothing on {topic.name}"


def _slack_ns(*topics: Topic) -> int:
    """Two periods of each: how long one topic may go on after the last word of the other."""
    return sum(round(2e9 / (topic.rate_hz or 1.0)) for topic in topics)
