"""Topics between a unit and a centre; the same names are subjects of NATS, with dots for slashes."""

import re

BATCH, RECEIPT, WATCH, LIVE = "uplink/batch", "uplink/receipt", "uplink/watch", "live"
VEHICLE = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,47}")  # a command line takes what begins with - for an option
RULE = "letters, digits, _ and -, at most 48 and not - first"
CHANGED, ALARM, REVOKED = "centre.now", "centre.alarm", "centre.revoked"  # subjects within a centre
MAX_WATCH_S = 60
# What a watch session may ask for: what the pages Now, Map, Trust and GNSS of a unit show.
WATCHABLE = (
    "gnss/fix", "gnss/satellites", "imu/sample", "vehicle/speed", "navigation/solution", "navigation/state",
    "navigation/aiding", "navigation/set_up", "mode/state", "trust/state", "trust/monitor", "trust/event",
    "trust/hypotheses", "origin/state", "uplink/state", "outage/event", "deadline/report",
)  # fmt: skip


def topic(vehicle: str, noun: str) -> str:
    """Give the MQTT topic of a vehicle."""
    return f"obu/{vehicle}/{noun}"


def subject(vehicle: str, noun: str) -> str:
    """Give the subject of NATS of a vehicle; `vehicle` may be its wildcard."""
    return f"obu.{vehicle}.{noun.replace('/', '.')}"


def vehicle_of(name: str) -> str | None:
    """Name of the vehicle in a subject of NATS; None if there is none."""
    parts = name.split(".", 2)
    return parts[1] if len(parts) == 3 and parts[0] == "obu" and VEHICLE.fullmatch(parts[1]) else None
