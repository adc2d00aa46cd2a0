"""Judges every topic and process of a vehicle against its deadline, and attributes what is wrong to its root cause.

An outage is one root cause: a process that is down, the broker, or a topic that is silent although its producer runs.
It begins with the last message before the silence. It affects the topics of that process at once, and further topics as
they pass their deadlines. It ends when the cause is over and every affected topic was published again: a process that
was killed remains the cause while it starts again.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

from shared.bus.codes import broker_down
from shared.messages.explanation import Explanation, explain, process, topic
from shared.messages.operation import (
    DeadlineReport,
    Freshness,
    Outage,
    Problem,
    ProcessAge,
    ProcessHealth,
    ProcessState,
    ProcessStatus,
    RecordingState,
    TopicAge,
)
from shared.processes import BY_NAME as PROCESS_ROWS
from shared.runtime.freshness import STARTUP_GRACE_S, percentile
from shared.runtime.tally import told
from shared.topics import BY_NAME, TOPICS, Topic, needs, topic_of
from shared.words.words import CodedText, reason, stated

from .causes import expected_topics, producers_of, upstream_of
from .codes import Code, back, down
from .intruders import Intruders
from .overload import Overload
from .process_watch import OVER, ProcessWatch
from .topic_watch import TopicWatch

GRACE_NS = round(STARTUP_GRACE_S * 1e9)
START_NS = 10_000_000_000  # retained messages, which may be older than this run of the unit, count only after this
RETURN_NS = 3_000_000_000  # time for processes to reconnect after the broker is back
RECOVERY_NS = 60_000_000_000  # after it, topics that are still silent are no longer attributed to the broker
SETTLE_NS = 10_000_000_000  # a relapse within this time continues the same outage
BROKER_TIMEOUT_NS = 1_200_000_000  # a broker that does not even return our own heartbeat does not work
STALL_NS = 1_000_000_000  # an observer that was suspended for longer cannot judge the others
SLOW_NS = (
    8_000_000_000  # silence of a process that a slow step explains, while another's loss or start takes the computer
)
RESUME_NS = 60_000_000_000  # maximum age of a report whose outages are continued after a restart
DISK_LOW_BYTES = 1_000_000_000
BROKER, SELF, RECORDER = "broker", "monitoring.health", "monitoring.recorder"
SOLUTION, SAMPLES, HEARTBEATS = "navigation/solution", "imu/sample", "health/+"


@dataclass
class _OpenOutage:
    """An outage, and the topics that were not published since: each with the stamp of its last message before."""

    outage: Outage
    incarnation: int = 0  # of the process that is the root cause
    silent_ns: dict[str, int] = field(default_factory=dict)
    recovered_ns: int = 0  # when the last of them was published again


class Watch:
    """Follows every topic and process of one vehicle.

    `configured` are the processes that should run here. Its only inputs are messages (`take...`) and
    the passage of time (`step`).
    """

    def __init__(
        self, configured: tuple[str, ...] | frozenset[str], now_ns: int, *, processors: int | None = None
    ) -> None:
        self._started_ns = self._judged_from_ns = self._now_ns = self._received_ns = now_ns
        self._configured = frozenset(configured)
        self._topics = {topic.name: TopicWatch(topic) for topic in TOPICS}
        self.untold = frozenset(topic.name for topic in TOPICS if topic.fast)  # of these the messages are needed here
        self._processes = {name: ProcessWatch(name) for name in PROCESS_ROWS if name in self._configured}
        self._expected = expected_topics(self._configured)
        self._recording: RecordingState | None = None
        self._doubtful: dict[str, tuple[ProcessHealth, int, bool]] = {}  # last wills that nothing has followed
        self._open: dict[str, _OpenOutage] = {}
        self._settling: dict[str, _OpenOutage] = {}  # ended less than SETTLE_NS ago
        self._events: list[Outage] = []
        self._overload = Overload(processors)
        self.intruders = Intruders()
        self.answering = True  # whether the broker works
        self._back_ns = now_ns  # since when it does

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
        self._received_ns = max(self._received_ns, received_ns)
        topic = topic_of(name)
        if topic is not None:
            self._topics[topic.name].take(producer, payload, received_ns, retained=retained)

    def take_health(self, health: ProcessHealth, received_ns: int, *, retained: bool = False) -> None:
        """Process a heartbeat, disconnect or last will.

        A process that is not configured is watched from its first message to its disconnect. Around an outage of the
        broker, or of this observer, a last will is doubtful: a broker publishes them for connections that it dropped
        itself. It counts if no heartbeat follows. Our own last will, which we can only receive from a broker that
        shuts down, begins such an outage.
        """
        name = health.process
        over = health.state.is_over
        for carried, published in () if retained else told(health):
            watch = self._topics[carried.topic]
            watch.take_told(health, carried, published=published, now_ns=received_ns)
            if watch.tally.count:
                self.untold -= {carried.topic}
        if name == SELF and health.state is ProcessState.LOST and not retained:
            self._judged_from_ns = received_ns + RETURN_NS
            return
        self._doubtful.pop(name, None)
        if health.state is ProcessState.LOST and (not self.answering or received_ns < self._judged_from_ns):
            self._doubtful[name] = (health, received_ns, retained)
            return
        if name not in self._processes:
            if name not in PROCESS_ROWS or retained or over:
                return
            self._processes[name] = ProcessWatch(name)
        if not retained and self._processes[name].is_of_earlier_life(health):
            self.intruders.second_life(name, received_ns)
        before = self._processes[name].state
        self._processes[name].take(health, received_ns, retained=retained)
        if before is not self._processes[name].state:
            self._expected = expected_topics(self._present())

    def take_recording(self, state: RecordingState) -> None:
        """Note whether the recorder records, and on how full a disk."""
        self._recording = state

    def resume(self, report: DeadlineReport) -> None:
        """Continue the outages that were open in the last report before a restart, and add the interruption itself."""
        starting = self._now_ns < self._started_ns + START_NS
        if not starting or not self._started_ns - RESUME_NS < report.now_ns < self._started_ns:
            return
        for age in report.processes:
            if age.process in self._processes:
                self._processes[age.process].restarts += age.restarts
        for problem in report.problems:
            if (outage := problem.outage) is not None and outage.what not in self._open:
                silent_ns = {name: report.now_ns for name in problem.affected if name in self._topics}
                self._open[outage.what] = _OpenOutage(outage, silent_ns=silent_ns)
        cause = explain(Code.NOT_MONITORED, process(SELF))
        self._events.append(_outage(SELF, report.now_ns, cause, self._started_ns))

    def step(self, now_ns: int, *, connected: bool) -> list[Outage]:
        """Compare everything with its deadline; return the outages that began or ended.

        An outage of the broker is published when it is back.
        """
        slept = now_ns - self._now_ns > STALL_NS
        if slept:
            self._received_ns = now_ns
        answering = connected and now_ns - self._received_ns < BROKER_TIMEOUT_NS
        if slept or (answering and not self.answering):
            self._judged_from_ns, self._back_ns = now_ns + RETURN_NS, now_ns
        self._now_ns, self.answering = now_ns, answering
        if not answering:
            if BROKER not in self._open:
                self._begin(BROKER, self._received_ns, broker_down(connected=connected), self._flowing())
            return []
        if now_ns >= self._judged_from_ns:
            self._judge_processes()
            self._judge_topics()
        self._recover()
        events, self._events = self._events, []
        return events

    def report(self, now_ns: int) -> DeadlineReport:
        """Give the age of every topic that this vehicle has or should have, of every process, and all problems."""
        return DeadlineReport(
            now_ns=now_ns,
            topics=tuple(
                self._topic_age(watch, now_ns)
                for name, watch in self._topics.items()
                if watch.count or name in self._expected
            ),
            processes=tuple(self._process_age(watch, now_ns) for watch in self._processes.values()),
            problems=(
                *(self._problem(entry) for entry in self._open.values()),
                *self._other_problems(),
                *self.intruders.problems(now_ns),
            ),
        )

    def judge_load(self, now_ns: int, load: float) -> None:
        """Find out whether this computer keeps up, by its load and the delays of messages."""
        solution, samples = (percentile(self._topics[name].recent_s, 0.5) for name in (SOLUTION, SAMPLES))
        live = self.answering and self._topics[SOLUTION].freshness(now_ns) is not Freshness.STALE
        behind_s = solution - (samples or 0.0) if live and solution is not None else None
        heartbeats_s = self._topics[HEARTBEATS].recent_s if self.answering else ()
        self._overload.judge(now_ns, load, heartbeats_s, behind_s)

    # --- processes

    def _present(self) -> frozenset[str]:
        """Name the processes that should run: those configured, and others until their disconnect."""
        others = {name for name, watch in self._processes.items() if watch.state is not ProcessState.DISCONNECTED}
        return self._configured | others

    def _status(self, name: str) -> ProcessStatus:
        if name not in self._processes:
            return ProcessStatus.READY  # it has published, and is not one of ours
        watch, uptime_ns = self._processes[name], self._now_ns - self._started_ns
        if name not in self._configured and watch.state is ProcessState.DISCONNECTED:
            return ProcessStatus.ABSENT
        if watch.retained and uptime_ns < START_NS:
            return ProcessStatus.WAITING
        status = watch.status(self._now_ns, self._judged_from_ns, grace_over=uptime_ns >= GRACE_NS)
        if status is ProcessStatus.STALE and self._is_excused(name):
            return ProcessStatus.LATE
        return ProcessStatus.RESTARTING if name in self._open and not status.down else status

    def _is_excused(self, name: str) -> bool:
        """Whether silence of a process is explained by another's loss or restart, or by a computer that is overloaded.

        A start takes a second or more of a processor, and what a process missed meanwhile makes its next step long.
        Its own last will, and longer silence, count as ever.
        """
        return name not in self._open and self._is_slow_since(self._processes[name].heartbeat_ns or 0)

    def _is_slow_since(self, since_ns: int) -> bool:
        """Whether another's loss or restart, or an overload, explains silence since a time."""
        if self._now_ns - since_ns >= SLOW_NS:
            return False
        others = (*self._open.items(), *self._settling.items())
        return self._overload.problem is not None or any(self._was_lost(*other) for other in others)

    def _was_lost(self, what: str, entry: _OpenOutage) -> bool:
        """Whether an outage is that of a process that ended or was started again, and not only of one that hangs."""
        watch = self._processes.get(what)
        return watch is not None and (watch.state in OVER or watch.incarnation > entry.incarnation)

    def _judge_processes(self) -> None:
        for name in self._present():
            status = self._status(name)
            if status is ProcessStatus.STALE and name in self._doubtful:
                health, received_ns, retained = self._doubtful.pop(name)
                self._processes[name].take(health, received_ns, retained=retained)
                status = self._status(name)
            if not status.down or name in self._open:
                continue
            watch = self._processes[name]
            since_ns = self._started_ns if watch.seen_ns is None else max(watch.seen_ns, self._started_ns)
            self._begin(name, since_ns, down(name, status), self._flowing(name))
            self._open[name].incarnation = watch.incarnation

    # --- topics

    def _flowing(self, producer: str | None = None) -> list[str]:
        """Name the topics with a rate that are published at present, by one process or by all."""
        live = (Freshness.FRESH, Freshness.LATE)
        return [
            name
            for name, watch in self._topics.items()
            if producer in (None, watch.producer)
            and not watch.topic.per_process
            and not watch.kept
            and watch.freshness(self._received_ns if producer is None else self._now_ns) in live
        ]

    def _judge_topics(self) -> None:
        """Attribute every silent topic to its root cause."""
        for name, watch in self._topics.items():
            if watch.topic.per_process or self._silent_since_ns(watch.topic) is None:
                continue
            root = self._root(watch.topic)
            if root is None or (name in self._silenced() and not self._is_down(root)):
                continue
            for entry in self._open.values():
                entry.silent_ns.pop(name, None)
            if root in self._settling:
                self._continue(root)
            if root in self._open:
                self._affect(self._open[root], [name])
            else:
                since_ns = self._topics.get(root, watch).newest_ns or self._started_ns
                self._begin(root, since_ns, self._why_silent(root), [name])

    def _silenced(self) -> set[str]:
        return {name for entry in self._open.values() for name in entry.silent_ns}

    def _root(self, topic: Topic, seen: tuple[str, ...] = ()) -> str | None:
        """Find the root cause of the silence of a topic; None while it cannot be determined.

        It is, in this order: a producer that is down, or was restarted since the last message; what silenced the input
        that ended last, as soon as no other is late; an outage upstream that is not over for good; the topic itself.
        """
        if failed := self._failed_producer(topic):
            return failed
        silent = self._ended_inputs(topic, seen, stale=True)
        root = self._root(silent[0], (*seen, topic.name)) if silent else None
        if root is not None and self._is_down(root):
            return root
        if self._ended_inputs(topic, seen, stale=False):
            return None
        return root if silent else self._recent_root(topic) or self._own_root(topic)

    def _failed_producer(self, topic: Topic) -> str | None:
        """Name the producer that is down, or was restarted since the last message of the topic."""
        producers, newest_ns = self._producers(topic), self._topics[topic.name].newest_ns
        failed = [name for name in producers if self._is_down(name)]
        restarted = [
            name
            for name in producers
            if newest_ns and name in self._processes and self._processes[name].incarnation > newest_ns
        ]
        return next(iter(failed + restarted), None)

    def _recent_root(self, topic: Topic) -> str | None:
        """Name the latest outage upstream of a topic that is open, or ended a short while ago."""
        recent = {**self._settling, **self._open}
        upstream = [name for name in recent if name == BROKER or name in upstream_of(topic)]
        return max(upstream, key=lambda name: recent[name].outage.since_ns, default=None)

    def _own_root(self, topic: Topic) -> str | None:
        """Name the topic itself, once its producer has sent heartbeats since the topic's deadline, and steadily.

        The first heartbeat after a slow step is followed by what the step has made.
        """
        if self._is_slow_since(self._topics[topic.name].newest_ns or 0):
            return None
        due_ns = (self._silent_since_ns(topic) or 0) + round((topic.silent_after_s or 0.0) * 1e9)
        ours = [self._processes[name] for name in self._producers(topic) if name in self._processes]
        return topic.name if all(watch.spoke_after(due_ns) for watch in ours) else None

    def _producers(self, topic: Topic) -> tuple[str, ...]:
        newest = self._topics[topic.name].producer
        return (newest,) if newest else producers_of(topic, self._present())

    def _is_down(self, name: str) -> bool:
        return name in self._processes and self._status(name).down

    def _ended_inputs(self, topic: Topic, seen: tuple[str, ...], *, stale: bool) -> list[Topic]:
        """List the inputs, stale or only late, that came to an end before the topic did, the last to end first.

        An input that has been silent while the topic was still published is less likely the cause than a later one.
        """
        end_ns = self._silent_since_ns(topic) or 0
        before = [
            (input_end_ns, need)
            for producer in self._producers(topic)
            for need in needs(producer)
            if need.name not in (*seen, topic.name)
            and (input_end_ns := self._silent_since_ns(need) if stale else self._late_since_ns(need)) is not None
            and input_end_ns <= end_ns + _slack_ns(need, topic)
        ]
        return [need for _, need in sorted(before, key=lambda item: -item[0])]

    def _silent_since_ns(self, topic: Topic) -> int | None:
        """Give the stamp of the last message of a stale topic, 0 if it never came but should; None while it is well."""
        watch = self._topics[topic.name]
        if watch.newest_ns is None or watch.kept:
            return 0 if self._is_missing(topic) else None
        if topic.silent_after_s is None or watch.freshness(self._now_ns) is not Freshness.STALE:
            return None
        judged_ns = max(watch.newest_ns, self._judged_from_ns)
        return watch.newest_ns if (self._now_ns - judged_ns) * 1e-9 >= topic.silent_after_s else None

    def _late_since_ns(self, topic: Topic) -> int | None:
        watch = self._topics[topic.name]
        return watch.newest_ns if watch.freshness(self._now_ns) is Freshness.LATE else None

    def _is_missing(self, topic: Topic) -> bool:
        """Whether an expected topic never came, nor any other of its producers: not every device has all."""
        if topic.name not in self._expected or self._now_ns - self._started_ns < GRACE_NS:
            return False
        published = {watch.producer for watch in self._topics.values() if watch.topic.rate_hz and watch.topic.consumers}
        return not published.intersection(producers_of(topic, self._present()))

    def _why_silent(self, root: str) -> Explanation:
        """Describe a root cause other than a process that is down."""
        if root not in self._topics:
            return explain(Code.RESTARTED, process(root))
        producers = self._producers(BY_NAME[root])
        if not producers:
            return explain(Code.NO_PRODUCER, topic(root))
        if producers[0] not in PROCESS_ROWS:
            code = Code.PRODUCER_ENDED
        else:
            code = Code.DEVICE_SILENT if PROCESS_ROWS[producers[0]].layer == 1 else Code.NOT_PUBLISHED
        return explain(code, topic(root), process=process(producers[0]))

    # --- outages

    def _begin(self, what: str, since_ns: int, cause: Explanation, topics: list[str]) -> None:
        self._settling.pop(what, None)
        self._open[what] = entry = _OpenOutage(_outage(what, since_ns, cause))
        self._affect(entry, topics)
        self._events.append(entry.outage)

    def _continue(self, what: str) -> None:
        """Open an outage again whose topics fell silent once more soon after its end."""
        self._open[what] = entry = self._settling.pop(what)
        entry.outage = entry.outage.model_copy(update={"until_ns": None})
        self._events.append(entry.outage)

    def _affect(self, entry: _OpenOutage, topics: list[str]) -> None:
        entry.silent_ns |= {name: self._topics[name].newest_ns or 0 for name in topics}
        affected = _in_order({*entry.outage.affected, *topics})
        entry.outage = entry.outage.model_copy(update={"affected": affected})

    def _recover(self) -> None:
        """Note the topics that are published again, and end the outages of which nothing is left."""
        self._settling = {
            what: entry for what, entry in self._settling.items() if self._now_ns < entry.recovered_ns + SETTLE_NS
        }
        for what, entry in list(self._open.items()):
            for name, end_ns in list(entry.silent_ns.items()):
                watch = self._topics[name]
                if watch.newest_ns is not None and watch.newest_ns > end_ns and not watch.kept:
                    del entry.silent_ns[name]
                    entry.recovered_ns = self._now_ns
            if self._is_over(what, entry):
                del self._open[what]
                until_ns = max(entry.recovered_ns, self._cause_end_ns(what))
                entry.outage, entry.recovered_ns = entry.outage.model_copy(update={"until_ns": until_ns}), self._now_ns
                self._events.append(entry.outage)
                if not entry.silent_ns:
                    self._settling[what] = entry

    def _is_over(self, what: str, entry: _OpenOutage) -> bool:
        if what == BROKER:
            silent = bool(entry.silent_ns) and self._now_ns < self._back_ns + RECOVERY_NS
            return self._now_ns >= self._judged_from_ns and not silent
        if what in self._processes:
            running = (ProcessStatus.RESTARTING, ProcessStatus.READY, ProcessStatus.ABSENT)
            return not entry.silent_ns and self._status(what) in running
        return not entry.silent_ns

    def _cause_end_ns(self, what: str) -> int:
        """Time at which a root cause that affected no topic ended."""
        if what == BROKER:
            return self._back_ns
        return (self._processes[what].heartbeat_ns or 0) if what in self._processes else 0

    def _problem(self, entry: _OpenOutage) -> Problem:
        outage, told = entry.outage, self._effect(entry)
        return Problem(
            what=outage.what, text=told.text, text_code=told.code, since_ns=outage.since_ns,
            affected=_in_order(entry.silent_ns), outage=outage,
        )  # fmt: skip

    def _effect(self, entry: _OpenOutage) -> CodedText:
        """Describe the present effect of an outage; one of an earlier release has no code."""
        what, waiting = entry.outage.what, _in_order(entry.silent_ns)
        if what == BROKER and self.answering:
            return stated(back(Code.BROKER_BACK, Code.BROKER_BACK_WAITING, None, waiting))
        if what in self._processes:
            status = self._status(what)
            if status.down:
                return stated(down(what, status))
            if self._processes[what].incarnation > entry.incarnation:
                return stated(back(Code.RESTARTED, Code.RESTARTED_WAITING, process(what), waiting))
            return stated(back(Code.RUNNING_AGAIN, Code.RUNNING_AGAIN_WAITING, process(what), waiting))
        if what in self._topics and what not in entry.silent_ns and waiting:
            return stated(back(Code.TOPIC_BACK_WAITING, Code.TOPIC_BACK_WAITING, topic(what), waiting))
        return CodedText(entry.outage.cause, entry.outage.cause_code)

    def _other_problems(self) -> list[Problem]:
        """List what is wrong although nothing is silent because of it."""
        overload = self._overload.problem
        return [*([overload] if overload else []), *self._deaf(), *self._recording_problems()]

    def _deaf(self) -> Iterator[Problem]:
        """List the processes that do not receive what is published, as when the broker refuses a subscription."""
        if self._now_ns < self._judged_from_ns:
            return
        for name, watch in self._topics.items():
            for receiver, since_ns in watch.tally.deaf():
                if receiver in self._processes and not self._status(receiver).down:
                    why = explain(
                        Code.NOT_RECEIVED, process(receiver), topic=topic(name), producer=process(watch.producer or "")
                    )
                    yield Problem(what=receiver, text=reason(why), text_code=why, since_ns=since_ns)

    def _recording_problems(self) -> list[Problem]:
        state, fresh = self._recording, self._topics["recording/state"].freshness(self._now_ns) is not Freshness.STALE
        if state is None or not fresh:
            return []
        if not state.recording and state.reason:
            return [Problem(what=RECORDER, text=state.reason, text_code=state.reason_code)]
        if state.flood:
            return [Problem(what=RECORDER, text=state.flood, text_code=state.flood_code)]
        if state.free_bytes < DISK_LOW_BYTES:
            why = explain(Code.DISK_LOW, free_bytes=state.free_bytes)
            return [Problem(what=RECORDER, text=reason(why), text_code=why)]
        return []

    # --- rows of the report

    def _topic_age(self, watch: TopicWatch, now_ns: int) -> TopicAge:
        median_s, p99_s = watch.latencies_s()
        name = watch.topic.name
        cause = next((self._effect(entry) for entry in self._open.values() if name in entry.silent_ns), None)
        return TopicAge(
            topic=name,
            freshness=watch.freshness(now_ns),
            age_s=watch.age_s(now_ns),
            rate_hz=watch.rate_hz(now_ns),
            count=watch.count,
            latency_p50_s=median_s,
            latency_p99_s=p99_s,
            cause=None if cause is None else cause.text,
            cause_code=None if cause is None else cause.code,
        )

    def _process_age(self, watch: ProcessWatch, now_ns: int) -> ProcessAge:
        return ProcessAge(
            process=watch.name,
            status=self._status(watch.name),
            heartbeat_age_s=watch.age_s(now_ns),
            restarts=watch.restarts,
        )


def _outage(what: str, since_ns: int, cause: Explanation, until_ns: int | None = None) -> Outage:
    return Outage(what=what, since_ns=since_ns, until_ns=until_ns, cause=reason(cause), cause_code=cause)


def _slack_ns(*topics: Topic) -> int:
    """Two periods of each: by how much the last message of one topic may be newer than that of another."""
    return sum(round(2e9 / (topic.rate_hz or 1.0)) for topic in topics)


def _in_order(names: Collection[str]) -> tuple[str, ...]:
    """In the order of the contract, which is that of the data flow: found in the order of a machine's load."""
    return tuple(topic.name for topic in TOPICS if topic.name in names)
