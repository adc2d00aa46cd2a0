"""The topics of the bus: one row an edge. Everything else about who may say what to whom is derived."""

from dataclasses import dataclass
from functools import cached_property

from .messages.base import Message, RawBytes
from .messages.gnss import GnssConfiguration, GnssConfigure, GnssFix, GnssRaw, GnssSatellites, GnssWrite
from .messages.imu import ImuRaw, ImuSamples
from .messages.navigation import (
    AidingUpdate,
    FilterState,
    LastPosition,
    NavigationSolution,
    NavigationState,
    TruthState,
)
from .messages.operation import Consumed, DeadlineReport, ModeState, Origin, Outage, ProcessHealth, RecordingState
from .messages.vehicle import CanRaw, VehicleSpeed, WheelSpeeds
from .processes import BY_NAME as PROCESS_ROWS
from .processes import PROCESSES


@dataclass(frozen=True)
class Topic:
    """One kind of message on the bus.

    `rate_hz` is the expected rate (None: whenever it happens), `silent_after_s` the age after which
    the newest message is stale, `expiry_s` how long the broker keeps a retained one, and `persist`
    says that the newest message outlives a power-off.
    """

    name: str
    message: type[Message]
    purpose: str
    producers: tuple[str, ...]
    consumers: tuple[str, ...] = ()
    rate_hz: float | None = None
    silent_after_s: float | None = None
    qos: int = 0
    retain: bool = False
    expiry_s: int | None = None
    persist: bool = False

    @cached_property
    def per_process(self) -> bool:
        """Whether the producer's name is the last level of the topic."""
        return self.name.endswith("/+")

    @cached_property
    def is_raw(self) -> bool:
        """Whether the payload is what a device sent, and the rest of the message user properties."""
        return issubclass(self.message, RawBytes)


EVERYONE = tuple(row.name for row in PROCESSES)

TOPICS = (
    Topic("gnss/raw", GnssRaw, "bytes from the GNSS receiver",
          ("sensors.gnss", "sensors.simulator"), ("parsers.gnss",), rate_hz=1.0, silent_after_s=5.0),
    Topic("imu/raw", ImuRaw, "bytes from the inertial measurement unit",
          ("sensors.imu", "sensors.simulator"), ("parsers.imu",), rate_hz=100.0, silent_after_s=1.0),
    Topic("can/raw", CanRaw, "frames from the vehicle's CAN bus",
          ("sensors.can", "sensors.simulator"), ("parsers.can",), rate_hz=10.0, silent_after_s=5.0),
    Topic("gnss/write", GnssWrite, "bytes to the GNSS receiver",
          ("parsers.gnss",), ("sensors.gnss", "sensors.simulator"), qos=1),
    Topic("gnss/fix", GnssFix, "position and velocity of the antenna, one message an epoch",
          ("parsers.gnss",), ("controller.mode", "core.fusion"), rate_hz=1.0, silent_after_s=5.0),
    Topic("gnss/satellites", GnssSatellites, "satellites in view",
          ("parsers.gnss",), (), rate_hz=1.0, silent_after_s=10.0),
    Topic("gnss/configuration", GnssConfiguration, "what the receiver was found to be set to",
          ("parsers.gnss",), ("controller.mode",), qos=1, retain=True),
    Topic("imu/sample", ImuSamples, "specific force and angular rate in body axes",
          ("parsers.imu",), ("controller.mode", "core.fusion"), rate_hz=100.0, silent_after_s=1.0),
    Topic("vehicle/speed", VehicleSpeed, "speed of the vehicle by OBD-II",
          ("parsers.can",), ("controller.mode", "core.fusion"), rate_hz=1.0, silent_after_s=5.0),
    Topic("vehicle/wheel_speed", WheelSpeeds, "speed of each wheel",
          ("parsers.can",), ("core.fusion",), rate_hz=10.0, silent_after_s=5.0),
    Topic("gnss/configure", GnssConfigure, "what the receiver shall be set to",
          ("controller.mode",), ("parsers.gnss",), qos=1),
    Topic("mode/state", ModeState, "what the unit is doing",
          ("controller.mode",), (), rate_hz=1.0, silent_after_s=5.0, qos=1, retain=True, expiry_s=30),
    Topic("navigation/last_position", LastPosition, "where the vehicle was last known to be",
          ("controller.mode",), ("core.fusion",), qos=1, retain=True, persist=True),
    Topic("navigation/solution", NavigationSolution, "where the vehicle is, with covariance",
          ("core.fusion",), ("controller.mode",), rate_hz=10.0, silent_after_s=2.0),
    Topic("navigation/state", NavigationState, "what the navigation filter is doing and why",
          ("core.fusion",), ("controller.mode",), rate_hz=1.0, silent_after_s=5.0, qos=1, retain=True, expiry_s=30),
    Topic("navigation/filter_state", FilterState, "state and covariance of the filter, for its next process",
          ("core.fusion",), ("core.fusion",), qos=1, retain=True),
    Topic("navigation/aiding", AidingUpdate, "each measurement as the filter saw it",
          ("core.fusion",), ()),
    Topic("deadline/report", DeadlineReport, "age and rate of every topic and process",
          ("monitoring.health",), (), rate_hz=2.0, silent_after_s=5.0),
    Topic("outage/event", Outage, "what was lost, and for how long",
          ("monitoring.health",), (), qos=1),
    Topic("recording/state", RecordingState, "what is being recorded",
          ("monitoring.recorder",), (), rate_hz=1.0, silent_after_s=10.0, qos=1, retain=True, expiry_s=30),
    Topic("origin/state", Origin, "whether the data are live, simulated or replayed",
          ("sensors.gnss", "sensors.imu", "sensors.can", "sensors.simulator"), (),
          rate_hz=0.5, silent_after_s=10.0, qos=1, retain=True, expiry_s=10),
    Topic("truth/state", TruthState, "where the simulated vehicle really is",
          ("sensors.simulator",), (), rate_hz=10.0, silent_after_s=5.0),
    Topic("health/+", ProcessHealth, "birth, heartbeat, farewell and last will of a process",
          EVERYONE, (), rate_hz=2.0, silent_after_s=2.0, qos=1, retain=True),
    Topic("consumed/+", Consumed, "the order in which a process consumed its messages",
          EVERYONE, (), rate_hz=1.0, silent_after_s=10.0),
)  # fmt: skip
BY_NAME = {topic.name: topic for topic in TOPICS}
BY_MESSAGE = {topic.message: topic for topic in TOPICS}


def topic_of(name: str) -> Topic | None:
    """Find the row of a topic's name without prefix; None for a name that the contract does not hold."""
    return BY_NAME.get(name) or BY_NAME.get(name.rsplit("/", 1)[0] + "/+")


def subscriptions(process: str) -> tuple[Topic, ...]:
    """List what a process listens to."""
    everything = any(row.observes_all for row in PROCESSES if row.name == process)
    return tuple(t for t in TOPICS if everything or process in t.consumers)


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
