"""The whole unit against its deadlines: ages, and outages with the cause at their root."""

from collections.abc import Collection, Mapping

from shared.messages.operation import (
    DeadlineReport,
    Freshness,
    Outage,
    ProcessAge,
    ProcessHealth,
    ProcessState,
    TopicAge,
)
from shared.processes import BY_NAME as PROCESS_ROWS
from shared.runtime.freshness import STARTUP_GRACE_S
from shared.topics import TOPICS, Topic, topic_of

from .causes import Upstream, expected_topics, producers_of
from .process_watch import Condition, ProcessWatch
from .topic_watch import TopicWatch

GRACE_NS = round(STARTUP_GRACE_S * 1e9)
START_NS = 10_000_000_000  # what the broker kept from a former life of the unit counts only after this
RETURN_NS = 2_000_000_000  # what everybody gets to come back after the broker did
RECOVERY_NS = 8_000_000_000  # what a process that was down gets to say something again
MUTE_NS = 1_200_000_000  # a broker from which not even our own heartbeat returns is not working
STALL_NS = 1_000_000_000  # an observer that slept longer cannot tell who else was silent
BROKER = "broker"
GONE = (ProcessState.DISCONNECTED, ProcessState.LOST)


class Watch:
    """Follows every topic and process of one vehicle.

    `configured` are the processes that should run here. Nothing but what it is told moves it:
    messages by `take` and `take_health`, time by `step`.
    """

    def __init__(self, configured: Collection[str], now_ns: int) -> None:
        self._started_ns = self._judged_from_ns = self._now_ns = self._heard_ns = now_ns
        self._configured = frozenset(configured)
        self._topics = {topic.name: TopicWatch(topic) for topic in TOPICS}
        self._processes = {name: ProcessWatch(name) for name in PROCESS_ROWS if name in self._configured}
        self._expected = expected_topics(self._configured)
        self._open: dict[str, Outage] = {}
        self._answering = True
        self._broker_outage: Outage | None = None

    def take(
        self,
        name: str,
        payload: bytes,
        *,
        producer: str,
        received_ns: int,
        retained: bool = False,
    ) -> None:
        """Note that a message came, without decoding it."""
        self._heard_ns = max(self._heard_ns, received_ns)
        topic = topic_of(name)
        if topic is not None:
            self._topics[topic.name].take(producer, payload, received_ns, retained=retained)

    def take_health(self, health: ProcessHealth, received_ns: int, *, retained: bool = False) -> None:
        """Note what a process says of itself, or the broker of a process that it lost.

        A process that nobody configured is watched from its birth to its farewell.
        """
        name = health.process
        if name not in self._processes:
            if name not in PROCESS_ROWS or retained or health.state in GONE:
                return
            self._processes[name] = ProcessWatch(name)
        before = self._processes[name].state
        self._processes[name].take(health, received_ns, retained=retained)
        if before is not self._processes[name].state:
            self._expected = expected_topics(self._present())

    def step(self, now_ns: int, *, connected: bool) -> list[Outage]:
        """Compare everything with its deadline; return the outages that began, ended or have another cause.

        An outage of the broker is told once it is over and the others are back to hear of it.
        """
        slept = now_ns - self._now_ns > STALL_NS
        if slept:
            self._heard_ns = now_ns
        answering = connected and now_ns - self._heard_ns < MUTE_NS
        if slept or (answering and not self._answering):
            self._judged_from_ns = now_ns + RETURN_NS
        self._now_ns, self._answering = now_ns, answering
        if not answering:
            cause = "the broker is connected but delivers nothing" if connected else "the connection to it broke"
            self._broker_outage = self._broker_outage or Outage(what=BROKER, since_ns=self._heard_ns, cause=cause)
            return []
        wrong = {**self._silent_processes(), **self._silent_topics()}
        return [*self._broker_events(), *self._end(wrong), *self._begin(wrong)]

    def report(self, now_ns: int) -> DeadlineReport:
        """Give the age of every topic that this vehicle has or should have, and of every process."""
        return DeadlineReport(
            now_ns=now_ns,
            topics=tuple(
                self._topic_age(watch, now_ns)
                for name, watch in self._topics.items()
                if watch.count or name in self._expected
            ),
            processes=tuple(self._process_age(watch, now_ns) for watch in self._processes.values()),
        )

    def _broker_events(self) -> list[Outage]:
        if self._broker_outage is None or self._now_ns < self._judged_from_ns:
            return []
        outage, self._broker_outage = self._broker_outage, None
        return [outage.model_copy(update={"until_ns": self._judged_from_ns - RETURN_NS})]

    def _begin(self, wrong: Mapping[str, str | None]) -> list[Outage]:
        """Open outages, or give open ones another cause; None holds one back until its cause is known."""
        events = []
        for what, cause in wrong.items():
            known = self._open.get(what)
            if cause is None or (known is not None and known.cause == cause):
                continue
            since_ns = known.since_ns if known else self._last_seen_ns(what)
            self._open[what] = Outage(what=what, since_ns=since_ns, until_ns=None, cause=cause)
            events.append(self._open[what])
        return events

    def _end(self, wrong: Collection[str]) -> list[Outage]:
        """Close the outages of what was heard again."""
        events = []
        for what, outage in list(self._open.items()):
            until_ns = self._last_seen_ns(what)
            if what not in wrong and until_ns > outage.since_ns:
                events.append(outage.model_copy(update={"until_ns": until_ns}))
                del self._open[what]
        return events

    def _present(self) -> frozenset[str]:
        """Name the processes that should run: those configured, and guests until their farewell."""
        guests = {name for name, watch in self._processes.items() if watch.state is not ProcessState.DISCONNECTED}
        return self._configured | guests

    def _silent_processes(self) -> dict[str, str | None]:
        conditions = {name: self._condition(name) for name in self._present()}
        words = {
            Condition.LOST: "was lost: it crashed, was killed, or its connection broke",
            Condition.SILENT: "is connected but silent: it hangs or is overloaded",
            Condition.ENDED: "ended as asked",
            Condition.MISSING: "should run here but was never seen",
        }
        return {name: f"{name} {words[condition]}" for name, condition in conditions.items() if condition.down}

    def _silent_topics(self) -> dict[str, str | None]:
        upstream = Upstream(
            self._present(),
            condition=self._condition_to_blame,
            stopped_ns=self._stopped_ns,
            last_ns=self._late_since_ns,
            producer=lambda topic: self._topics[topic.name].producer,
        )
        return {
            name: upstream.cause(watch.topic)
            for name, watch in self._topics.items()
            if not watch.topic.per_process and self._stopped_ns(watch.topic) is not None
        }

    def _condition(self, name: str) -> Condition:
        if name not in self._processes:
            return Condition.RUNNING  # not ours to watch, and it did speak
        watch, uptime_ns = self._processes[name], self._now_ns - self._started_ns
        if watch.kept and uptime_ns < START_NS:
            return Condition.WAITED_FOR
        return watch.condition(self._now_ns, self._judged_from_ns, grace_over=uptime_ns >= GRACE_NS)

    def _condition_to_blame(self, name: str) -> Condition:
        """Judge a process; one that is just back is not to blame for what it did not say while it was down."""
        condition = self._condition(name)
        back_ns = self._processes[name].back_ns if name in self._processes else None
        recovering = back_ns is not None and self._now_ns - back_ns < RECOVERY_NS
        return Condition.WAITED_FOR if recovering and condition is Condition.RUNNING else condition

    def _stopped_ns(self, topic: Topic) -> int | None:
        """Say when a topic fell silent, 0 if it never spoke and should; None while it is well."""
        watch = self._topics[topic.name]
        if watch.newest_ns is None or watch.kept:
            return 0 if self._is_missing(topic) else None
        if topic.silent_after_s is None or watch.freshness(self._now_ns) is not Freshness.STALE:
            return None
        heard_ns = max(watch.newest_ns, self._judged_from_ns)
        return watch.newest_ns if (self._now_ns - heard_ns) * 1e-9 >= topic.silent_after_s else None

    def _late_since_ns(self, topic: Topic) -> int | None:
        watch = self._topics[topic.name]
        return watch.newest_ns if watch.freshness(self._now_ns) is Freshness.LATE else None

    def _is_missing(self, topic: Topic) -> bool:
        """Whether a topic never came although its producers say nothing else either: not every device has all."""
        if topic.name not in self._expected or self._now_ns - self._started_ns < GRACE_NS:
            return False
        spoken = {watch.producer for watch in self._topics.values() if watch.topic.rate_hz and watch.topic.consumers}
        return not spoken.intersection(producers_of(topic, self._present()))

    def _last_seen_ns(self, what: str) -> int:
        seen_ns = self._processes[what].seen_ns if what in self._processes else self._topics[what].newest_ns
        return self._started_ns if seen_ns is None else seen_ns

    def _topic_age(self, watch: TopicWatch, now_ns: int) -> TopicAge:
        median_s, p99_s = watch.latencies_s()
        outage = self._open.get(watch.topic.name)
        return TopicAge(
            topic=watch.topic.name,
            freshness=watch.freshness(now_ns),
            age_s=watch.age_s(now_ns),
            rate_hz=watch.rate_hz(now_ns),
            count=watch.count,
            latency_p50_s=median_s,
            latency_p99_s=p99_s,
            cause=outage.cause if outage else None,
        )

    def _process_age(self, watch: ProcessWatch, now_ns: int) -> ProcessAge:
        return ProcessAge(
            process=watch.name,
            state=watch.state,
            silent=self._condition(watch.name).down,
            heartbeat_age_s=watch.age_s(now_ns),
            restarts=watch.restarts,
        )
