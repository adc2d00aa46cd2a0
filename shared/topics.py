"""The topics of the bus: one row a topic. Who produces and consumes it follows from the table of processes."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property, lru_cache

from .messages.base import Message, RawBytes
from .messages.corrections import CorrectionBytes, CorrectionSources, CorrectionsState, GnssCorrection
from .messages.gnss import (
    CarrierDisplacement,
    FaultFreeFix,
    GnssConfiguration,
    GnssConfigure,
    GnssFix,
    GnssNavigationBits,
    GnssRaw,
    GnssRawEpoch,
    GnssReceiver,
    GnssReset,
    GnssSatellites,
    GnssSignalQuality,
    GnssSignals,
    GnssWrite,
)
from .messages.imu import ImuRaw, ImuSamples
from .messages.navigation import (
    AidingUpdate,
    ConflictRecord,
    FilterState,
    LastPosition,
    NavigationSolution,
    NavigationState,
    SetUpState,
    TruthState,
)
from .messages.neighbours import NeighbourStates
from .messages.operation import (
    ConsumptionOrder,
    Crossing,
    DeadlineReport,
    DeviceState,
    HostClock,
    ModeAnswer,
    ModeCommand,
    ModeState,
    Origin,
    Outage,
    ProcessHealth,
    ProcessLoad,
    RecordingState,
)
from .messages.power import PowerEvent, PowerRaw, PowerState
from .messages.replay import ReplayControl, ReplayEvents, ReplayState
from .messages.settings import SettingsAnswer, SettingsCatalogue, SettingsCommand, SettingsState
from .messages.simulation import RoadNetwork, SimulationAttack, SimulationState
from .messages.tachograph import TachographEvent, TachographRecords
from .messages.toll import (
    GateCommand,
    LedgerHead,
    LedgerState,
    OpenPassages,
    PictureOrder,
    PictureState,
    PlazaDescription,
    PlazaDetector,
    PlazaTruth,
    RestoredCams,
    TollAlarm,
    TollDelta,
    TollPassage,
    TollPayment,
    TollReceipt,
    TollRegistration,
    TollReview,
    TollTracks,
    TollTransaction,
    UsedCams,
)
from .messages.trust import (
    LearnedGrade,
    LearnedScale,
    TrustEvent,
    TrustHypotheses,
    TrustMonitor,
    TrustRecord,
    TrustState,
)
from .messages.uplink import UplinkState
from .messages.v2x import CamFrames, CamList, OwnCam, V2xSend
from .messages.vehicle import CanRaw, VehicleSignal, VehicleSpeed, WheelSpeeds
from .processes import BY_NAME as PROCESS_ROWS
from .processes import LAYERS, PROCESSES, ProcessRow, Role
from .programs import ROLES

TOPIC_NAME = re.compile(r"[a-z][a-z0-9_]*/([a-z][a-z0-9_]*|\+)")
ONE_BYTES, MANY_BYTES = 131_072, 245_760  # with topic and header below `max_packet_size` of the broker
OF_MANY = ("v2x/", "toll/", "plaza/", "simulation/", "replay/", "mode/", "settings/")
SETTINGS = "settings/state"  # every process listens to it: one whose settings differ ends, and starts again with them
BROKER_LOG = "$SYS/broker/log/N"  # what the broker has refused, for monitoring.health
REPLAY = "replay"  # the program `obu replay --broker`
PROCESS_NAME = re.compile(rf"({'|'.join(LAYERS)})\.[a-z][a-z0-9_]*")


@dataclass(frozen=True)
class Topic:
    """One kind of message on the bus.

    `rate_hz` is the expected rate (None: whenever it happens), `silent_after_s` the age after which
    the newest message is stale, `persist` says that the newest message outlives a power-off, and `personal` that
    it describes other road users: a road-side unit does not record it. A `fast` one may come more than ten times a
    second: heartbeats tell how much of it was sent and received, so that observers need not wake for each message.
    Consumers of an `advisory` one go on without it: they have a rule of their own.
    """

    name: str
    message: type[Message]
    purpose: str
    rate_hz: float | None = None
    silent_after_s: float | None = None
    qos: int = 0
    retain: bool = False
    persist: bool = False
    personal: bool = False
    fast: bool = False
    advisory: bool = False

    @cached_property
    def most_bytes(self) -> int:
        """Largest payload: many vehicles, or the roads of a region, take more than what one vehicle measures."""
        return MANY_BYTES if self.name.startswith(OF_MANY) else ONE_BYTES

    @cached_property
    def per_process(self) -> bool:
        """Whether every process produces it, with its own name as the last level of the topic."""
        return self.name.endswith("/+")

    @cached_property
    def is_covered(self) -> bool:
        """Whether the pattern of a topic of all processes covers this one too, so that one filter finds both."""
        return not self.per_process and f"{self.name.split('/')[0]}/+" in BY_NAME

    @cached_property
    def producers(self) -> tuple[str, ...]:
        """Processes that publish the topic."""
        return tuple(row.name for row in PROCESSES if self.per_process or self.name in row.produces)

    @cached_property
    def consumers(self) -> tuple[str, ...]:
        """Processes that subscribe to the topic by its name; those that observe every topic are not among them."""
        return tuple(row.name for row in PROCESSES if self.name in row.consumes)

    @cached_property
    def is_raw(self) -> bool:
        """Whether the message holds bytes of a device as they are."""
        return issubclass(self.message, RawBytes)


TOPICS = (
    Topic("gnss/raw", GnssRaw, "bytes from the GNSS receiver", rate_hz=1.0, silent_after_s=5.0, fast=True),
    Topic("imu/raw", ImuRaw, "bytes from the inertial measurement unit", rate_hz=100.0, silent_after_s=1.0, fast=True),
    Topic("can/raw", CanRaw, "frames from the vehicle's CAN bus", rate_hz=10.0, silent_after_s=5.0, fast=True),
    Topic("gnss/write", GnssWrite, "bytes to the GNSS receiver", qos=1),
    Topic("gnss/fix", GnssFix, "position and velocity of the antenna, one message an epoch",
          rate_hz=1.0, silent_after_s=5.0),
    Topic("gnss/satellites", GnssSatellites, "satellites in view", rate_hz=1.0, silent_after_s=10.0),
    Topic("gnss/signals", GnssSignals, "C/N0 and use of each signal, from receivers that send them"),
    Topic("gnss/raw_epoch", GnssRawEpoch, "pseudoranges, carrier phases and Doppler, from receivers that send them"),
    Topic("gnss/fault_free_fix", FaultFreeFix, "least-squares fix of an epoch without the excluded satellites"),
    Topic("gnss/carrier_displacement", CarrierDisplacement,
          "displacement of the antenna between two epochs, by the change of its carrier phases"),
    Topic("gnss/navigation_bits", GnssNavigationBits, "subframes and pages that satellites broadcast"),
    Topic("gnss/signal_quality", GnssSignalQuality, "jamming, spoofing, gain and clock as the receiver states them"),
    Topic("host/clock", HostClock, "the host's clock beside the OBU time line, and whether NTP holds it"),
    Topic("device/state", DeviceState, "what a driver has found at its port, and what to do", qos=1),
    Topic("gnss/receiver", GnssReceiver, "kinds of messages that the receiver sends, by its bytes", qos=1, retain=True),
    Topic("gnss/configuration", GnssConfiguration, "configuration of the receiver, as read back", qos=1, retain=True),
    Topic("imu/sample", ImuSamples, "specific force and angular rate in body axes",
          rate_hz=100.0, silent_after_s=1.0, fast=True),
    Topic("vehicle/speed", VehicleSpeed, "speed of the vehicle by OBD-II", rate_hz=1.0, silent_after_s=5.0),
    Topic("vehicle/signal", VehicleSignal, "further quantities of the vehicle's network, by name", fast=True),
    Topic("vehicle/wheel_speed", WheelSpeeds, "speed of each wheel", rate_hz=10.0, silent_after_s=5.0, fast=True),
    Topic("corrections/raw", CorrectionBytes, "bytes from the sources of GNSS corrections"),
    Topic("corrections/sources", CorrectionSources, "connections to the sources of GNSS corrections",
          rate_hz=1.0, silent_after_s=5.0),
    Topic("gnss/correction", GnssCorrection, "whole frames of corrections for the GNSS receiver"),
    Topic("corrections/state", CorrectionsState, "source of corrections in use, age and kinds of its frames",
          rate_hz=1.0, silent_after_s=5.0, qos=1, retain=True),
    Topic("power/raw", PowerRaw, "readings of the power supply"),
    Topic("power/state", PowerState, "mains or battery, voltage, current and share of charge",
          rate_hz=1.0, silent_after_s=5.0, qos=1, retain=True),
    Topic("power/event", PowerEvent, "loss and return of the mains, and a battery that is nearly empty", qos=1),
    Topic("v2x/neighbours", NeighbourStates, "neighbouring vehicles: states, and frequency offsets of their carriers",
          rate_hz=1.0, silent_after_s=5.0),
    Topic("v2x/raw", CamFrames, "frames that the V2X radio received, in batches of at most 20 ms",
          personal=True, fast=True),
    Topic("v2x/cam", CamList, "Cooperative Awareness Messages of other stations, in SI units",
          personal=True, fast=True),
    Topic("v2x/own_cam", OwnCam, "Cooperative Awareness Message of this vehicle, by the generation rules"),
    Topic("v2x/send", V2xSend, "frames to be sent by the V2X radio"),
    Topic("gnss/configure", GnssConfigure, "configuration wanted of the receiver", qos=1),
    Topic("gnss/reset", GnssReset, "lets a receiver start anew", qos=1),
    Topic("mode/command", ModeCommand, "commands of the operator", qos=1),
    Topic("mode/answer", ModeAnswer, "how far a command of the operator has come", qos=1),
    Topic("mode/crossing", Crossing, "ferry or train that carries the vehicle, as the driver has entered it",
          qos=1, retain=True, persist=True),
    Topic("mode/state", ModeState, "operating mode of the unit, and the sources in use",
          rate_hz=1.0, silent_after_s=5.0, qos=1, retain=True, advisory=True),
    Topic("settings/command", SettingsCommand, "settings to be checked or changed", qos=1),
    Topic("settings/answer", SettingsAnswer, "what a change of settings would do, or why it is refused", qos=1),
    Topic("settings/state", SettingsState, "digests of the settings that hold, and the newest change",
          qos=1, retain=True),
    Topic("settings/catalogue", SettingsCatalogue, "every setting with its value, bounds and meaning",
          qos=1, retain=True),
    Topic("navigation/last_position", LastPosition, "last known position of the vehicle",
          qos=1, retain=True, persist=True),
    Topic("navigation/solution", NavigationSolution, "position, velocity and attitude, with covariance",
          rate_hz=10.0, silent_after_s=2.0, fast=True),
    Topic("navigation/state", NavigationState, "phase of the navigation filter, and why",
          rate_hz=1.0, silent_after_s=5.0, qos=1, retain=True),
    Topic("navigation/set_up", SetUpState, "checks of axes, mounting, signs, delays, scales and lever arm",
          qos=1, retain=True),
    Topic("navigation/filter_state", FilterState, "state and covariance of the filter, for its next process",
          qos=1, retain=True),
    Topic("navigation/conflict_record", ConflictRecord, "contradiction that the protection level holds",
          qos=1, retain=True, persist=True),
    Topic("navigation/aiding", AidingUpdate, "innovation of each measurement, and whether it was used", fast=True),
    Topic("trust/monitor", TrustMonitor, "result of one integrity monitor", rate_hz=1.0, silent_after_s=5.0),
    Topic("trust/hypotheses", TrustHypotheses, "position under each hypothesis of what may be wrong",
          rate_hz=1.0, silent_after_s=5.0),
    Topic("trust/state", TrustState, "whether the position can be used, and why",
          rate_hz=1.0, silent_after_s=5.0, qos=1, retain=True),
    Topic("trust/grade", LearnedGrade, "what this vehicle's drives have taught about its IMU and receiver",
          qos=1, retain=True, persist=True),
    Topic("trust/inertial_scale", LearnedScale, "what this vehicle's bends have taught about its IMU's scale",
          qos=1, retain=True, persist=True),
    Topic("tachograph/event", TachographEvent, "begin and end of an event of the smart tachograph", qos=1),
    Topic("tachograph/records", TachographRecords, "events that the smart tachograph's annex keeps",
          qos=1, retain=True, persist=True),
    Topic("trust/record", TrustRecord, "what core.trust believes and what is open, for its next process",
          qos=1, retain=True, persist=True),
    Topic("trust/event", TrustEvent, "each change of the verdict, with the evidence", qos=1),
    Topic("plaza/description", PlazaDescription, "lanes and lines of the toll plaza", qos=1, retain=True),
    Topic("toll/registration", TollRegistration, "contract and present station ID of a vehicle", qos=1, personal=True),
    Topic("plaza/detector", PlazaDetector, "a vehicle at the gate line of a lane, by its detector", qos=1),
    Topic("plaza/picture_order", PictureOrder, "orders to the lanes' cameras: take, keep or delete a picture", qos=1),
    Topic("plaza/pictures", PictureState, "how many pictures the cameras hold, and since when"),
    Topic("toll/paid_otherwise", TollPayment, "vehicles of mixed lanes that have paid the operator otherwise", qos=1,
          personal=True),
    Topic("toll/alarm", TollAlarm, "attacks on the plaza, and tickets that misbehave", qos=1, personal=True),
    Topic("toll/seal", LedgerHead, "the newest signed entry of the ledger, for the operator to keep", qos=1,
          retain=True),
    Topic("toll/delta", TollDelta, "common GNSS error at the plaza", rate_hz=1.0, silent_after_s=10.0, qos=1,
          retain=True),
    Topic("toll/tracks", TollTracks, "vehicles tracked at the plaza", rate_hz=2.0, silent_after_s=5.0, personal=True),
    Topic("toll/passage", TollPassage, "progress of each passage, with its evidence", qos=1, personal=True),
    Topic("toll/gate", GateCommand, "when the gate of a lane opens, and for which passage", qos=1),
    Topic("toll/open_passages", OpenPassages, "passages in progress and settled, as the ledger holds them",
          rate_hz=1.0, silent_after_s=5.0, qos=1, personal=True),
    Topic("toll/used_cam", UsedCams, "CAM that were used, which the ledger keeps for a minute in memory", qos=1,
          personal=True, fast=True),
    Topic("toll/restored_cam", RestoredCams, "CAM that were used before a restart of `core.toll`", qos=1,
          personal=True),
    Topic("toll/transaction", TollTransaction, "charges and reversals for the operator", qos=1, personal=True),
    Topic("toll/review", TollReview, "passages that a person has to judge: not confirmed, or contradictory",
          qos=1, personal=True),
    Topic("toll/receipt", TollReceipt, "answers of the operator", qos=1, personal=True),
    Topic("ledger/state", LedgerState, "charges, outbox and reconciliation",
          rate_hz=1.0, silent_after_s=5.0, qos=1, personal=True),
    Topic("plaza/truth", PlazaTruth, "true positions of the simulated vehicles",
          rate_hz=2.0, silent_after_s=5.0, personal=True),
    Topic("deadline/report", DeadlineReport, "age and status of every topic and process, and problems by root cause",
          rate_hz=2.0, silent_after_s=2.0, qos=1, retain=True),
    Topic("outage/event", Outage, "begin and end of an outage, with its root cause", qos=1),
    Topic("recording/state", RecordingState, "file in progress, and free space",
          rate_hz=1.0, silent_after_s=10.0, qos=1, retain=True),
    Topic("uplink/state", UplinkState, "connection to the control centre, what waits for it, and who watches",
          rate_hz=0.1, silent_after_s=30.0, qos=1, retain=True),
    Topic("origin/state", Origin, "whether the data are live, simulated or replayed",
          rate_hz=0.5, silent_after_s=10.0, qos=1, retain=True),
    Topic("replay/control", ReplayControl, "plays, pauses, seeks in a replay, or changes its speed"),
    Topic("replay/state", ReplayState, "position, extent and speed of a replay"),
    Topic("replay/events", ReplayEvents, "changes of the verdict and outages of a recorded drive", qos=1,
          retain=True),
    Topic("simulation/attack", SimulationAttack, "starts or stops an attack on a simulated vehicle", qos=1),
    Topic("simulation/state", SimulationState, "the attacks of a simulated drive, and the answer to the last command",
          qos=1, retain=True),
    Topic("simulation/roads", RoadNetwork, "the roads of the simulated world, for a map", qos=1, retain=True),
    Topic("truth/state", TruthState, "true position of the simulated vehicle",
          rate_hz=10.0, silent_after_s=5.0, fast=True),
    Topic("health/load", ProcessLoad, "how far core.fusion is behind its inputs, and which work is paused for it",
          qos=1, retain=True),
    Topic("health/+", ProcessHealth, "start, heartbeat, disconnect and last will of a process",
          rate_hz=2.0, silent_after_s=2.0, qos=1, retain=True),
    Topic("consumed/+", ConsumptionOrder, "the order in which a process consumed its messages",
          rate_hz=1.0, silent_after_s=10.0),
)  # fmt: skip
BY_NAME = {topic.name: topic for topic in TOPICS}
BY_MESSAGE = {topic.message: topic for topic in TOPICS}


def topic_of(name: str) -> Topic | None:
    """Find the row of a topic's name without prefix; None for a name that the contract does not hold."""
    return BY_NAME.get(name) or BY_NAME.get(name.rsplit("/", 1)[0] + "/+")


@lru_cache(4_000)
def may_send(process: str, name: str) -> bool:
    """Whether a process may be the sender of a message on a topic, named without prefix.

    `obu replay --broker` sends the topics of devices in the place of sensors.
    """
    topic = topic_of(name)
    if topic is None:
        return False
    if topic.per_process:
        return name == topic.name[:-1] + process and process in PROCESS_ROWS
    program = ROLES.get(process)
    if program is not None:
        return topic.name in program.writes
    return process in topic.producers or (process == REPLAY and (topic in measurements() or name == "origin/state"))


@lru_cache
def subscriptions(process: str) -> tuple[Topic, ...]:
    """List what a process listens to."""
    everything = any(row.observes_all for row in PROCESSES if row.name == process)
    return tuple(t for t in TOPICS if everything or process in t.consumers)


def on_request(process: str) -> tuple[Topic, ...]:
    """List what a process may listen to while somebody asks for it."""
    return tuple(BY_NAME[name] for row in PROCESSES if row.name == process for name in row.on_request)


def readable(process: str) -> tuple[Topic, ...]:
    """List what a process has the right to read: what it listens to, may ask for, and the settings of the unit."""
    return tuple(dict.fromkeys((*subscriptions(process), *on_request(process), BY_NAME[SETTINGS])))


def publications(process: str) -> tuple[Topic, ...]:
    """List what a process may say."""
    return tuple(t for t in TOPICS if process in t.producers)


def measurements() -> tuple[Topic, ...]:
    """List what devices say and what is read from it: the topics of layers 1 and 2 that have a rate."""
    return tuple(
        t for t in TOPICS
        if t.rate_hz is not None and not t.per_process and t.name != "origin/state"
        and any(PROCESS_ROWS[name].layer <= 2 for name in t.producers)
    )  # fmt: skip


@lru_cache
def needs(process: str) -> tuple[Topic, ...]:
    """List the topics with a rate that a process needs: not advice, nor feedback of processes that follow it."""
    order = list(PROCESS_ROWS)
    if process not in order or PROCESS_ROWS[process].observes_all:
        return ()
    place = order.index(process)
    return tuple(
        topic for topic in subscriptions(process)
        if topic.rate_hz is not None and not topic.advisory
        and any(order.index(name) < place for name in topic.producers)
    )  # fmt: skip


def hot_path() -> tuple[str, ...]:
    """List an on-board unit's processes upstream of the solution along topics that each needs."""
    found: set[str] = set()
    waiting = [BY_NAME["navigation/solution"]]
    while waiting:
        new = set(waiting.pop().producers) - found
        found |= new
        waiting += [topic for name in new for topic in needs(name)]
    return tuple(row.name for row in PROCESSES if row.name in found and Role.OBU in row.roles)


def contradictions(processes: Sequence[ProcessRow], topics: Sequence[Topic]) -> list[str]:
    """Compare the two tables; give one sentence for each row that contradicts another, with what to change."""
    found = [
        f"{table}: {key} stands in {keys.count(key)} rows; keep one of them"
        for table, keys in (
            ("shared/processes.py", [row.name for row in processes]),
            ("shared/topics.py", [topic.name for topic in topics]),
            ("shared/topics.py", [topic.message.__name__ for topic in topics]),
        )
        for key in sorted({key for key in keys if keys.count(key) > 1})
    ]
    produced = {name for row in processes for name in row.produces}
    for topic in topics:
        if not TOPIC_NAME.fullmatch(topic.name):
            found.append(f"shared/topics.py: {topic.name!r} is not two lower-case nouns such as 'gnss/fix'; rename it")
        if not topic.per_process and topic.name not in produced:
            found.append(f"shared/topics.py: no process produces {topic.name!r}; name it in `produces` of a process")
    names = [topic.name for topic in topics]
    return [*found, *(text for row in processes for text in _contradictions_of(row, names))]


def _contradictions_of(row: ProcessRow, topics: Sequence[str]) -> Iterator[str]:
    if not PROCESS_NAME.fullmatch(row.name):
        yield f"shared/processes.py: {row.name!r} is not a layer ({', '.join(LAYERS)}), a dot and a noun; rename it"
    for column, listed in (("consumes", row.consumes), ("produces", row.produces), ("on_request", row.on_request)):
        where = f"shared/processes.py: {row.name}: `{column}`"
        for name in dict.fromkeys(listed):
            if name not in topics:
                near = get_close_matches(name, topics, n=1)
                hint = f"did you mean {near[0]!r}?" if near else "add its row to shared/topics.py"
                yield f"{where} names {name!r}, which is no topic; {hint}"
            if listed.count(name) > 1:
                yield f"{where} names {name!r} {listed.count(name)} times; once is enough"
    if any(name.endswith("/+") for name in row.produces):
        yield f"shared/processes.py: {row.name}: every process produces what ends in '/+'; do not list it"
    if row.observes_all and row.consumes:
        yield f"shared/processes.py: {row.name} observes every topic; leave `consumes` out"


if found := contradictions(PROCESSES, TOPICS):
    raise ValueError("\n".join(found))
