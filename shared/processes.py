"""The processes of the on-board unit, in the order in which data flow: one row a process."""

from collections.abc import Collection
from dataclasses import dataclass
from enum import StrEnum

LAYERS = {
    "sensors": "devices -> raw bytes, stamped",
    "parsers": "bytes <-> typed messages in SI units",
    "controller": "what the unit should be doing now",
    "core": "where the vehicle is, and how well that is known",
    "monitoring": "watches, stores, shows, forwards",
}


class Role(StrEnum):
    """What a unit is: its file says which, and the role decides which processes run."""

    OBU = "obu"  # on-board unit of a vehicle
    RSU = "rsu"  # road-side unit of a toll plaza


BOTH = (Role.OBU, Role.RSU)


class Kind(StrEnum):
    """When a process runs in its roles: a standing one always, the others where the unit's file has their section."""

    DEVICE_DRIVER = "device driver"  # reads a device that a unit may have
    SIMULATOR = "simulator"  # stands in for devices
    STANDING = "standing"
    REPLAY = "replay"  # stands in for a whole unit: `obu replay` runs it, and no vehicle does
    OPTIONAL = "optional"  # belongs to a function that not every unit has


@dataclass(frozen=True)
class ProcessRow:
    """One process: its name is also its package, client id, logger, config section and container.

    `consumes` and `produces` name rows of shared/topics.py. Topics that end in `/+` are produced by every process and
    are not listed; a process that observes all lists nothing that it consumes. A process with a `pause_s` reads the bus
    no more often than that: most of the cost of a message at 100 Hz is to wake up for it. It may also read what
    is `on_request`, and subscribes to it while somebody asks for it.
    """

    name: str
    kind: Kind
    purpose: str
    consumes: tuple[str, ...] = ()
    produces: tuple[str, ...] = ()
    observes_all: bool = False
    roles: tuple[Role, ...] = (Role.OBU,)
    passes_on: tuple[str, ...] = ()  # of what it produces: data of another device that came through its own
    on_request: tuple[str, ...] = ()
    owns_loop: bool = False  # beside those of layers 1 and 5: it works with files
    pause_s: float = 0.0  # of a process of layers 2 to 4 whose output does not depend on such a delay
    container_user: int | None = (
        None  # owns the files of its container: never that of another process, also a former one
    )

    @property
    def layer(self) -> int:
        """Number of the layer, 1 to 5."""
        return list(LAYERS).index(self.name.split(".")[0]) + 1

    @property
    def is_function(self) -> bool:
        """Whether the process is a function of its messages, which the runtime feeds; others own their loop."""
        return self.layer not in (1, 5) and not self.owns_loop

    @property
    def short(self) -> str:
        """Name without the layer."""
        return self.name.split(".")[1]


PROCESSES = (
    ProcessRow(
        "sensors.gnss", Kind.DEVICE_DRIVER, "reads the GNSS receiver and writes the commands to it",
        container_user=10_100,
        consumes=("gnss/write", "gnss/correction"),
        produces=("gnss/raw", "host/clock", "origin/state", "device/state"),
        roles=BOTH,
    ),
    ProcessRow(
        "sensors.imu", Kind.DEVICE_DRIVER, "reads the inertial measurement unit",
        container_user=10_101,
        produces=("imu/raw", "origin/state", "device/state"),
    ),
    ProcessRow(
        "sensors.can", Kind.DEVICE_DRIVER, "reads the vehicle's CAN bus and asks for OBD-II speed",
        container_user=10_102,
        consumes=("gnss/fix",),
        produces=("can/raw", "origin/state", "device/state"),
    ),
    ProcessRow(
        "sensors.v2x", Kind.DEVICE_DRIVER, "receives and sends the frames of the V2X radio",
        container_user=10_103,
        consumes=("v2x/send",),
        produces=("v2x/raw",),
        roles=BOTH,
    ),
    ProcessRow(
        "sensors.corrections", Kind.DEVICE_DRIVER, "receives GNSS corrections over NTRIP, TCP, MQTT or a serial port",
        container_user=10_104,
        consumes=("gnss/fix", "trust/state", "corrections/state"),
        produces=("corrections/raw", "corrections/sources"),
    ),
    ProcessRow(
        "sensors.power", Kind.DEVICE_DRIVER, "reads the power supply, and switches the host off where that is wanted",
        container_user=10_105,
        consumes=("mode/state",),
        produces=("power/raw",),
    ),
    ProcessRow(
        "sensors.simulator", Kind.SIMULATOR, "drives a simulated vehicle and sends the bytes its devices would",
        container_user=10_106,
        consumes=("gnss/write", "simulation/attack"),
        produces=(
            "gnss/raw", "imu/raw", "can/raw", "v2x/neighbours", "host/clock", "origin/state", "truth/state",
            "simulation/state", "simulation/roads",
        ),
    ),
    ProcessRow(
        "sensors.traffic", Kind.SIMULATOR, "simulates a toll plaza: vehicles and their CAM, detectors, the operator",
        container_user=10_107,
        consumes=("toll/transaction",),
        produces=("gnss/raw", "origin/state", "toll/registration", "plaza/detector", "toll/paid_otherwise",
                  "toll/receipt", "plaza/truth"),
        roles=(Role.RSU,),
    ),
    ProcessRow(
        "sensors.plaza", Kind.DEVICE_DRIVER, "receives the pulses of a toll plaza's detectors, and directs its cameras",
        container_user=10_130,
        consumes=("plaza/picture_order",),
        produces=("plaza/detector", "plaza/pictures"),
        roles=(Role.RSU,),
    ),
    ProcessRow(
        "sensors.replay", Kind.REPLAY, "publishes the messages of a recording in place of every process",
        container_user=10_108,
        consumes=("replay/control",),
        produces=("replay/state", "replay/events", "origin/state"),
        roles=BOTH,
    ),
    ProcessRow(
        "parsers.gnss", Kind.STANDING, "turns UBX and NMEA bytes into fixes and satellites, and commands into UBX",
        container_user=10_109,
        consumes=("gnss/raw", "gnss/configure", "gnss/reset", "device/state", "corrections/state"),
        produces=(
            "gnss/write", "gnss/fix", "gnss/satellites", "gnss/signals", "gnss/raw_epoch", "gnss/navigation_bits",
            "gnss/signal_quality", "gnss/receiver", "gnss/configuration", "imu/raw", "vehicle/speed",
        ),
        passes_on=("imu/raw", "vehicle/speed"),
        roles=BOTH,
    ),
    ProcessRow(
        "parsers.imu", Kind.STANDING, "turns Xbus bytes into inertial samples in body axes",
        container_user=10_110,
        consumes=("imu/raw",),
        produces=("imu/sample",),
    ),
    ProcessRow(
        "parsers.can", Kind.STANDING, "turns CAN frames into vehicle and wheel speeds, and further signals",
        container_user=10_111,
        consumes=("can/raw",),
        produces=("vehicle/speed", "vehicle/wheel_speed", "vehicle/signal"),
    ),
    ProcessRow(
        "parsers.v2x", Kind.OPTIONAL, "turns V2X frames into Cooperative Awareness Messages (CAM) and back",
        container_user=10_112,
        consumes=("v2x/raw", "v2x/own_cam", "gnss/fix"),
        produces=("v2x/cam", "v2x/send", "v2x/neighbours"),
        roles=BOTH,
    ),
    ProcessRow(
        "parsers.corrections", Kind.OPTIONAL,
        "passes whole frames of corrections on to the receiver, from the best source that delivers",
        container_user=10_113,
        consumes=("corrections/raw", "corrections/sources"),
        produces=("gnss/correction", "corrections/state"),
    ),
    ProcessRow(
        "parsers.power", Kind.OPTIONAL, "turns readings of the supply into volts and share of charge, and judges them",
        container_user=10_114,
        consumes=("power/raw",),
        produces=("power/state", "power/event"),
    ),
    ProcessRow(
        "controller.mode", Kind.STANDING, "decides the operating mode of the unit",
        container_user=10_115,
        consumes=(
            "gnss/receiver", "gnss/fix", "gnss/configuration", "imu/sample", "vehicle/speed", "navigation/solution",
            "navigation/state", "mode/command", "mode/crossing", "power/state",
        ),
        produces=(
            "gnss/configure", "gnss/reset", "mode/state", "mode/answer", "mode/crossing", "navigation/last_position",
        ),
        pause_s=0.1,
    ),
    ProcessRow(
        "controller.settings", Kind.STANDING, "changes the settings of the unit, and takes a change back that harms it",
        container_user=10_131,
        consumes=("settings/command", "deadline/report"),
        produces=("settings/answer", "settings/state", "settings/catalogue"),
        on_request=("health/+",),
        roles=BOTH, owns_loop=True,
    ),
    ProcessRow(
        "controller.cam", Kind.OPTIONAL, "decides when the vehicle sends its own CAM, and what it states",
        container_user=10_116,
        consumes=("navigation/solution", "trust/state", "gnss/fix"),
        produces=("v2x/own_cam",),
    ),
    ProcessRow(
        "core.fusion", Kind.STANDING, "estimates position, velocity and attitude with their covariance",
        container_user=10_117,
        consumes=(
            "gnss/fix", "imu/sample", "vehicle/speed", "vehicle/wheel_speed", "navigation/last_position",
            "navigation/filter_state", "navigation/conflict_record", "trust/state", "gnss/fault_free_fix",
            "gnss/carrier_displacement", "mode/state", "mode/command", "health/load",
        ),
        produces=(
            "navigation/solution", "navigation/state", "navigation/filter_state", "navigation/conflict_record",
            "navigation/aiding", "navigation/set_up", "trust/hypotheses", "health/load",
        ),
    ),
    ProcessRow(
        "core.motion_conflict", Kind.STANDING,
        "compares the speeds of GNSS and odometer as the smart tachograph does, and both with the inertial sensors",
        container_user=10_118,
        consumes=(
            "imu/sample", "gnss/fix", "vehicle/speed", "trust/state", "trust/inertial_scale", "mode/state",
            "mode/crossing", "host/clock", "tachograph/records",
        ),
        produces=("trust/monitor", "trust/inertial_scale", "tachograph/event", "tachograph/records"),
        pause_s=0.1,
    ),
    ProcessRow(
        "core.spoofing", Kind.STANDING, "compares GNSS, inertial sensors and wheels over 5 s to 5 minutes",
        container_user=10_119,
        consumes=(
            "imu/sample", "gnss/fix", "vehicle/speed", "vehicle/wheel_speed", "navigation/solution",
            "navigation/aiding", "navigation/filter_state", "trust/grade", "trust/state", "mode/state", "health/load",
        ),
        produces=("trust/monitor", "trust/grade"),
        pause_s=0.1,
    ),
    ProcessRow(
        "core.cooperative", Kind.STANDING, "finds the satellite whose pseudorange contradicts the others",
        container_user=10_120,
        consumes=("gnss/raw_epoch", "gnss/navigation_bits", "gnss/fix", "v2x/neighbours", "mode/state"),
        produces=("trust/monitor", "gnss/fault_free_fix", "gnss/carrier_displacement", "trust/hypotheses"),
    ),
    ProcessRow(
        "core.evidence", Kind.STANDING, "evaluates the receiver's evidence: jamming and spoofing flags, signals, clock",
        container_user=10_121,
        consumes=(
            "gnss/signal_quality", "gnss/satellites", "gnss/fix", "gnss/carrier_displacement", "host/clock",
            "mode/state",
        ),
        produces=("trust/monitor",),
    ),
    ProcessRow(
        "core.trust", Kind.STANDING, "decides whether the position can be used, and why",
        container_user=10_122,
        consumes=(
            "trust/monitor", "trust/hypotheses", "navigation/solution", "navigation/state", "trust/state",
            "trust/record", "health/load",
        ),
        produces=("trust/state", "trust/record", "trust/event"),
    ),
    ProcessRow(
        "core.toll", Kind.STANDING, "tracks vehicles at a toll plaza, decides their lane and follows their passage",
        container_user=10_123,
        consumes=("v2x/cam", "gnss/fix", "toll/registration", "toll/open_passages", "toll/restored_cam", "toll/delta"),
        produces=("plaza/description", "toll/delta", "toll/tracks", "toll/passage", "toll/gate", "toll/used_cam",
                  "toll/alarm"),
        roles=(Role.RSU,),
    ),
    ProcessRow(
        "monitoring.ledger", Kind.STANDING, "charges each passage once, keeps its evidence, accounts for detections",
        container_user=10_124,
        consumes=("toll/registration", "toll/passage", "toll/used_cam", "plaza/detector", "toll/paid_otherwise",
                  "toll/receipt", "plaza/pictures", "origin/state"),
        produces=("toll/open_passages", "toll/restored_cam", "toll/transaction", "toll/review", "plaza/picture_order",
                  "toll/alarm", "toll/seal", "ledger/state"),
        roles=(Role.RSU,),
    ),
    ProcessRow(
        "monitoring.recorder", Kind.STANDING, "writes every message to disk",
        container_user=10_125,
        produces=("recording/state",), observes_all=True, roles=BOTH,
    ),
    ProcessRow(
        "monitoring.health", Kind.STANDING, "compares every topic and process with its deadline",
        container_user=10_126,
        produces=("deadline/report", "outage/event"), observes_all=True, roles=BOTH,
    ),
    ProcessRow(
        "monitoring.outputs", Kind.OPTIONAL, "gives the position to other programs, as gpsd and NMEA 0183",
        container_user=10_127,
        consumes=("gnss/fix", "gnss/satellites", "navigation/solution", "trust/state", "origin/state"),
    ),
    ProcessRow(
        "monitoring.status", Kind.STANDING, "serves state, history, metrics and the dashboard",
        container_user=10_128,
        produces=("simulation/attack", "replay/control", "mode/command", "settings/command"),
        observes_all=True, roles=BOTH,
    ),
    ProcessRow(
        "monitoring.uplink", Kind.OPTIONAL, "reports position, verdict and events to a control centre, each once",
        container_user=10_129,
        consumes=(
            "gnss/fix", "host/clock", "navigation/solution", "trust/state", "trust/event", "outage/event",
            "toll/transaction", "origin/state",
        ),
        produces=("uplink/state",),
        on_request=(
            "gnss/satellites", "imu/sample", "vehicle/speed", "navigation/state", "navigation/aiding",
            "navigation/set_up", "mode/state", "trust/monitor", "trust/hypotheses", "uplink/state", "deadline/report",
        ),
        roles=BOTH,
    ),
)  # fmt: skip
BY_NAME = {row.name: row for row in PROCESSES}


def switchable(role: Role) -> tuple[str, ...]:
    """Processes of a role that run where the unit's file has their section, and can so be switched on and off."""
    return tuple(
        row.name for row in PROCESSES if role in row.roles and row.kind not in (Kind.STANDING, Kind.REPLAY)
    )  # fmt: skip


def running(role: Role, sections: Collection[str] = ()) -> tuple[ProcessRow, ...]:
    """List the processes that run in a role: the standing ones, and the others that have a section."""
    return tuple(row for row in PROCESSES if role in row.roles and (row.kind is Kind.STANDING or row.name in sections))
