"""The processes of the on-board unit, in the order in which data flow: one row a process."""

from dataclasses import dataclass
from enum import StrEnum

LAYERS = {
    "sensors": "devices -> raw bytes, stamped",
    "parsers": "bytes <-> typed messages in SI units",
    "controller": "what the unit should be doing now",
    "core": "where the vehicle is, and how well that is known",
    "monitoring": "watches, stores, shows, forwards",
}


class Kind(StrEnum):
    """Where a process runs: a standing one in every unit, the others where the vehicle's file has their section."""

    DEVICE_DRIVER = "device driver"  # reads a device that a vehicle may have
    SIMULATOR = "simulator"  # stands in for devices
    STANDING = "standing"
    ROLE = "role"  # belongs to a role that not every unit plays


@dataclass(frozen=True)
class ProcessRow:
    """One process: its name is also its package, client id, logger, config section and container.

    `consumes` and `produces` name rows of shared/topics.py. Topics that end in `/+` are produced by every process and
    are not listed; a process that observes all lists nothing that it consumes.
    """

    name: str
    kind: Kind
    purpose: str
    consumes: tuple[str, ...] = ()
    produces: tuple[str, ...] = ()
    observes_all: bool = False

    @property
    def layer(self) -> int:
        """Number of the layer, 1 to 5."""
        return list(LAYERS).index(self.name.split(".")[0]) + 1

    @property
    def short(self) -> str:
        """Name without the layer."""
        return self.name.split(".")[1]


PROCESSES = (
    ProcessRow(
        "sensors.gnss", Kind.DEVICE_DRIVER, "reads the GNSS receiver and writes what it is told",
        consumes=("gnss/write",),
        produces=("gnss/raw", "origin/state"),
    ),
    ProcessRow(
        "sensors.imu", Kind.DEVICE_DRIVER, "reads the inertial measurement unit",
        produces=("imu/raw", "origin/state"),
    ),
    ProcessRow(
        "sensors.can", Kind.DEVICE_DRIVER, "reads the vehicle's CAN bus and asks for OBD-II speed",
        produces=("can/raw", "origin/state"),
    ),
    ProcessRow(
        "sensors.simulator", Kind.SIMULATOR, "drives a simulated vehicle and sends the bytes its devices would",
        consumes=("gnss/write",),
        produces=("gnss/raw", "imu/raw", "can/raw", "origin/state", "truth/state"),
    ),
    ProcessRow(
        "parsers.gnss", Kind.STANDING, "turns UBX and NMEA bytes into fixes and satellites, and commands into UBX",
        consumes=("gnss/raw", "gnss/configure"),
        produces=(
            "gnss/write", "gnss/fix", "gnss/satellites", "gnss/raw_epoch", "gnss/navigation_bits", "gnss/configuration",
        ),
    ),
    ProcessRow(
        "parsers.imu", Kind.STANDING, "turns Xbus bytes into inertial samples in body axes",
        consumes=("imu/raw",),
        produces=("imu/sample",),
    ),
    ProcessRow(
        "parsers.can", Kind.STANDING, "turns CAN frames into vehicle and wheel speeds",
        consumes=("can/raw",),
        produces=("vehicle/speed", "vehicle/wheel_speed"),
    ),
    ProcessRow(
        "controller.mode", Kind.STANDING, "decides what the unit should be doing now",
        consumes=(
            "gnss/fix", "gnss/configuration", "imu/sample", "vehicle/speed", "navigation/solution", "navigation/state",
        ),
        produces=("gnss/configure", "mode/state", "navigation/last_position"),
    ),
    ProcessRow(
        "core.fusion", Kind.STANDING, "says where the vehicle is and how well that is known",
        consumes=(
            "gnss/fix", "imu/sample", "vehicle/speed", "vehicle/wheel_speed", "navigation/last_position",
            "navigation/filter_state", "trust/state",
        ),
        produces=("navigation/solution", "navigation/state", "navigation/filter_state", "navigation/aiding"),
    ),
    ProcessRow(
        "core.motion_conflict", Kind.STANDING, "compares the speeds of GNSS and odometer as the smart tachograph does",
        consumes=("gnss/fix", "vehicle/speed", "trust/state"),
        produces=("trust/monitor",),
    ),
    ProcessRow(
        "core.spoofing", Kind.STANDING, "compares GNSS with the inertial sensors over 5, 30 and 60 s",
        consumes=("imu/sample", "gnss/fix", "vehicle/speed", "navigation/solution"),
        produces=("trust/monitor",),
    ),
    ProcessRow(
        "core.cooperative", Kind.STANDING, "finds the satellite whose pseudorange contradicts the others",
        consumes=("gnss/raw_epoch", "gnss/navigation_bits", "gnss/fix"),
        produces=("trust/monitor",),
    ),
    ProcessRow(
        "core.trust", Kind.STANDING, "decides whether the position can be used, and why",
        consumes=("trust/monitor", "navigation/solution", "navigation/state"),
        produces=("trust/state", "trust/event"),
    ),
    ProcessRow(
        "monitoring.recorder", Kind.STANDING, "writes every message to disk",
        produces=("recording/state",), observes_all=True,
    ),
    ProcessRow(
        "monitoring.health", Kind.STANDING, "holds every topic and process against its deadline",
        produces=("deadline/report", "outage/event"), observes_all=True,
    ),
    ProcessRow(
        "monitoring.status", Kind.STANDING, "serves state, history, metrics and the dashboard", observes_all=True,
    ),
)  # fmt: skip
BY_NAME = {row.name: row for row in PROCESSES}
