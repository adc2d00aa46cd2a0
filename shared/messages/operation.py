"""What the unit says of itself: mode, health, ages, outages, recording, origin."""

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from .base import Bytes, Count, DeviceName, Integer, Message, Name, Nanoseconds, Quantity, Ratio, Reason, Seconds, unit
from .explanation import Explanation
from .power import LowReason

MAX_KINDS = 64  # of messages of the devices of one process
Incarnation = Annotated[Nanoseconds, unit("ns")]  # start of a process on the OBU time line


class Mode(StrEnum):
    """What the on-board unit is doing."""

    BOOT = "boot"
    DETECTING = "detecting"
    CONFIGURING = "configuring"
    ALIGNING = "aligning"
    MEASURING = "measuring"
    DEGRADED = "degraded"
    SHUTTING_DOWN = "shutting_down"


class SourceSwitch(Message):
    """Another device was selected."""

    sampled_ns: Nanoseconds
    kind: Name  # gnss, imu, speed
    before: Name
    after: Name
    reason: Reason


class ModeState(Message):
    """The mode of the unit, since when and why, and the sources that it chose, which every consumer uses."""

    sampled_ns: Nanoseconds
    mode: Mode
    since_ns: Nanoseconds
    reason: Reason
    gnss_source: Name | None = None
    imu_source: Name | None = None
    speed_source: Name | None = None
    time_to_first_fix_s: Seconds | None = None  # from the first message of a receiver, or its last reset, on
    sources: Annotated[tuple[Name, ...], Field(max_length=64)] = ()  # of all kinds that are received
    switches: Annotated[tuple[SourceSwitch, ...], Field(max_length=16)] = ()  # the newest of each kind, oldest first
    power_off: bool | None = None  # true: the battery is nearly empty; state is saved, recordings are closed
    power_off_reason: LowReason | None = None  # of `power_off`


class OperatorCommand(StrEnum):
    """What an operator can ask of a unit."""

    COLD_START = "cold_start"  # of a GNSS receiver, without anything that it knows
    WARM_START = "warm_start"  # without its ephemerides
    NAVIGATION_RATE = "navigation_rate"  # of a GNSS receiver
    SELECT_SOURCE = "select_source"  # use a device; without a name, leave the choice to the unit
    CONFIRM_POSITION = "confirm_position"  # it is right: what GNSS has contradicted before is over
    CALIBRATE_AT_REST = "calibrate_at_rest"  # measure the biases of the gyroscopes at standstill
    CROSSING_BEGIN = "crossing_begin"  # the vehicle is carried by a ferry or train from now on
    CROSSING_END = "crossing_end"


class ModeCommand(Message):
    """A command of the operator."""

    request_id: Name
    command: OperatorCommand
    source: Name | None = None  # device; of a receiver None: the one in use
    navigation_period_s: Annotated[float, Field(ge=0.04, le=10.0)] | None = None  # of NAVIGATION_RATE


class CommandStage(StrEnum):
    """How far a command has come."""

    ACCEPTED = "accepted"
    DONE = "done"
    FAILED = "failed"


class ModeAnswer(Message):
    """How far a command of the operator has come."""

    sampled_ns: Nanoseconds
    request_id: Name
    command: OperatorCommand
    stage: CommandStage
    reason: Reason = ""  # why it failed, or what it led to


class CrossingEnd(StrEnum):
    """What has ended a crossing."""

    DRIVER = "driver"
    WHEELS = "wheels"  # they have turned for 100 m: the vehicle drives


class Crossing(Message):
    """Whether the vehicle is carried by a ferry or train, as its driver has entered it: at each change.

    Only the driver's begin and end silence the comparison of GNSS with the odometer. One that is open at the end of a
    unit is open at its next start, with the time and the distance that it had; it is published each minute and 10 m.
    """

    sampled_ns: Nanoseconds
    is_open: bool
    since_ns: Nanoseconds  # of the begin; after a restart: of the start, less the time that it had been open before
    ended_by: CrossingEnd | None = None  # None while it is open
    wheels_m: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0  # distance that the wheels have turned in it


class ProcessState(StrEnum):
    """Life states of a process, after Homie."""

    INIT = "init"
    READY = "ready"
    ALERT = "alert"
    DISCONNECTED = "disconnected"  # ended as asked
    LOST = "lost"  # last will

    @property
    def is_over(self) -> bool:
        """Whether the process has ended, as asked or not."""
        return self in (ProcessState.DISCONNECTED, ProcessState.LOST)


class Work(StrEnum):
    """Work that a unit pauses while its computer is too slow, in the order in which it is paused.

    The position comes first: it is computed as long as anything is.
    """

    HYPOTHESES = "hypotheses"  # solutions that leave sensors out
    INERTIAL_WINDOWS = "inertial_windows"  # comparison of GNSS with inertial sensors over 5 s to 5 minutes
    INNOVATIONS = "innovations"  # of each measurement, for charts
    PAGES = "pages"  # frames a second for browsers
    SOLUTIONS = "solutions"  # solutions a second


class ProcessLoad(Message):
    """How far a process is behind its inputs, and what is paused until it has caught up."""

    sampled_ns: Nanoseconds
    process: Name
    lag_s: Seconds  # from the arrival of an input at its driver to its use
    paused: Annotated[tuple[Work, ...], Field(max_length=16)] = ()
    skipped: Count = 0  # inputs that were too old, since the start of the process


class TopicTraffic(Message):
    """What one fast topic has carried from or to a process since its start."""

    topic: Name
    count: Count
    newest_ns: Nanoseconds | None = None  # when the newest was sent, or arrived here
    stamp_ns: Nanoseconds | None = None  # of the newest: when its bytes arrived at the driver, else when it was true
    producer: Name | None = None  # of the newest; None: this process


CarriedTopics = Annotated[tuple[TopicTraffic, ...], Field(max_length=64)]


class DeviceFound(StrEnum):
    """What a driver has found at its port."""

    ABSENT = "absent"  # it cannot be opened
    SEARCHING = "searching"  # the rate of the port is being found out
    SILENT = "silent"  # no bytes at any rate
    NOISE = "noise"  # bytes that are no messages at any rate
    OTHER = "other"  # messages of a protocol that the unit does not read
    WORKING = "working"


class DeviceState(Message):
    """What a driver has found at its port: when it changes, and every ten seconds."""

    sampled_ns: Nanoseconds
    source: DeviceName
    process: Name
    device: Annotated[str, Field(max_length=200)]  # its URL, without user and password
    found: DeviceFound
    protocols: tuple[Name, ...] = ()
    rate_baud: Annotated[int, Field(gt=0, le=100_000_000), unit("Bd")] | None = None  # None of a port without a rate
    sentence: Reason = ""  # what it means, and what to do


class MessageUse(StrEnum):
    """What the unit does with a kind of message of a device."""

    USED = "used"
    UNUSED = "unused"  # known, and nothing follows from it
    UNKNOWN = "unknown"


class MessageKind(Message):
    """How often a kind of message of a device came since the start of its parser."""

    kind: Name  # `UBX NAV-PVT`, `NMEA GGA`, `Xbus MTData2`, `CAN 0x7E8`
    use: MessageUse
    count: Count
    rejected: Count = 0  # of these
    reason: Name | None = None  # of the newest reject, as in `rejects`


class ProcessHealth(Message):
    """Start, heartbeat, disconnect or last will of one process."""

    process: Name
    state: ProcessState
    incarnation: Incarnation
    sent_ns: Nanoseconds
    messages_in: Count = 0
    messages_out: Count = 0
    dropped: Count = 0  # by a full queue
    rejects: dict[str, Count] = Field(default_factory=dict)  # bad input by kind
    kinds: Annotated[tuple[MessageKind, ...], Field(max_length=MAX_KINDS)] = ()  # of messages of its devices
    reconnections: Count = 0
    cpu_s: Seconds = 0.0
    rss_bytes: Bytes = 0
    pss_bytes: Bytes = 0  # proportional set size: shared pages are divided by the number of processes that share them
    last_error: Reason | None = None
    published: CarriedTopics = ()  # fast topics that it has published; empty from programs that do not count
    received: CarriedTopics = ()  # fast topics to which it subscribes, also those of which nothing came


class Freshness(StrEnum):
    """How old the newest message of a topic is, against its own rate."""

    FRESH = "fresh"
    LATE = "late"
    STALE = "stale"
    NEVER = "never"
    QUIET = "quiet"  # a topic without a rate


class ProcessStatus(StrEnum):
    """How `monitoring.health` judges a process, by its heartbeats, its last will and the topics that it publishes."""

    READY = "ready"
    LATE = "late"  # its heartbeat is overdue, but within the deadline
    RESTARTING = "restarting"  # it runs again, but a topic that it published before is still silent
    STALE = "stale"  # connected, but no heartbeat within the deadline
    LOST = "lost"  # last will
    ENDED = "ended"  # stopped on request
    WAITING = "waiting"  # not seen yet, and the unit has just started
    MISSING = "missing"  # should run in this vehicle, but was never seen
    ABSENT = "absent"  # the vehicle's file does not ask for it
    UNKNOWN = "unknown"  # the broker or `monitoring.health` is not available

    @property
    def down(self) -> bool:
        """Whether the process does no work."""
        return self in (ProcessStatus.STALE, ProcessStatus.LOST, ProcessStatus.ENDED, ProcessStatus.MISSING)


class TopicAge(Message):
    """Rate, age and latency of one topic."""

    topic: Name
    freshness: Freshness
    age_s: Seconds | None = None
    rate_hz: Quantity
    count: Count
    latency_p50_s: Seconds | None = None  # from `received_ns` or `sampled_ns` to the observer
    latency_p99_s: Seconds | None = None
    cause: Reason | None = None  # root cause of its silence
    cause_code: Explanation | None = None  # which `cause` says; as that of all codes, absent from earlier releases


class ProcessAge(Message):
    """Status, age of the last heartbeat and number of restarts of one process."""

    process: Name
    status: ProcessStatus
    heartbeat_age_s: Seconds | None = None
    restarts: Count


class Outage(Message):
    """One root cause and what it silenced, from the last message before it until all of that was published again.

    `what` and `since_ns` identify it: an outage that goes on soon after its end is published again without an end.
    """

    what: Name  # the root cause: a process, a topic whose device or producer is silent, or "broker"
    since_ns: Nanoseconds
    until_ns: Nanoseconds | None = None
    cause: Reason
    cause_code: Explanation | None = None  # which `cause` says
    affected: tuple[Name, ...] = ()  # topics that it silenced


class Problem(Message):
    """Something that is wrong now: the root cause, what it means at the moment, and the topics that are silent."""

    what: Name  # as in `Outage`
    text: Reason
    text_code: Explanation | None = None  # which `text` says
    since_ns: Nanoseconds | None = None
    affected: tuple[Name, ...] = ()
    outage: Outage | None = None  # None if nothing is silent because of it


class DeadlineReport(Message):
    """Every topic and every process against its deadline, and the root cause of all that is wrong."""

    now_ns: Nanoseconds
    topics: tuple[TopicAge, ...]
    processes: tuple[ProcessAge, ...]
    problems: tuple[Problem, ...] = ()


class RecordingState(Message):
    """What is being recorded, and how much room is left."""

    now_ns: Nanoseconds
    recording: bool
    file: Name | None = None
    bytes_written: Annotated[Bytes, unit("bytes")]
    messages: Count
    dropped: Count
    free_bytes: Bytes
    reason: Reason | None = None
    reason_code: Explanation | None = None  # which `reason` says
    left_out: Count = 0  # messages of topics or processes that sent more than is recorded
    flood: Reason | None = None  # which ones do so at present
    flood_code: Explanation | None = None  # which `flood` says


class OriginKind(StrEnum):
    """Where the data of this bus come from."""

    LIVE = "live"
    SIMULATED = "simulated"
    REPLAY = "replay"


class Origin(Message):
    """Where the data come from, repeated so that nobody takes a simulation for a vehicle."""

    now_ns: Nanoseconds
    kind: OriginKind
    name: Name  # scenario, recording or vehicle
    seed: Count | None = None
    speed: Ratio = 1.0


class HostClock(Message):
    """The host's clock at one time of the OBU time line, and whether NTP or the like holds it."""

    sampled_ns: Nanoseconds
    utc_ns: Nanoseconds  # since 1970-01-01, as the host's clock shows it
    synchronised: bool
    maximum_error_s: Seconds | None = None  # as the kernel states it; None of a clock that nothing holds


class ConsumptionOrder(Message):
    """The order in which a process consumed its messages, so that its work can be repeated exactly.

    Each run is (topic, producer, incarnation of the producer, first sequence number, count);
    a tick is ("tick", "", its stamp, 0, 1), and the end of the process ("close", "", 0, 0, 1).
    """

    process: Name
    incarnation: Incarnation
    runs: tuple[tuple[Name, Name, Integer, Integer, Count], ...]
