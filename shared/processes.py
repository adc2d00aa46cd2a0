"""The processes of the on-board unit, in the order in which data flow: one row a process."""

from dataclasses import dataclass

LAYERS = ("sensors", "parsers", "controller", "core", "monitoring")


@dataclass(frozen=True)
class ProcessRow:
    """One process: its name is also its package, client id, logger, config section and container."""

    name: str
    purpose: str
    observes_all: bool = False  # subscribes to every topic
    extra: bool = False  # only runs where the vehicle's file asks for it

    @property
    def layer(self) -> int:
        """Number of the layer, 1 to 5."""
        return LAYERS.index(self.name.split(".")[0]) + 1


PROCESSES = (
    ProcessRow("sensors.gnss", "reads the GNSS receiver and writes what it is told", extra=True),
    ProcessRow("sensors.imu", "reads the inertial measurement unit", extra=True),
    ProcessRow("sensors.can", "reads the vehicle's CAN bus and asks for OBD-II speed", extra=True),
    ProcessRow("sensors.simulator", "drives a simulated vehicle and sends the bytes its devices would", extra=True),
    ProcessRow("parsers.gnss", "turns UBX and NMEA bytes into fixes and satellites, and commands into UBX"),
    ProcessRow("parsers.imu", "turns Xbus bytes into inertial samples in body axes"),
    ProcessRow("parsers.can", "turns CAN frames into vehicle and wheel speeds"),
    ProcessRow("controller.mode", "decides what the unit should be doing now"),
    ProcessRow("core.fusion", "says where the vehicle is and how well that is known"),
    ProcessRow("monitoring.recorder", "writes every message to disk", observes_all=True),
    ProcessRow("monitoring.health", "holds every topic and process against its deadline", observes_all=True),
    ProcessRow("monitoring.status", "serves state, history, metrics and the dashboard", observes_all=True),
)
BY_NAME = {row.name: row for row in PROCESSES}
