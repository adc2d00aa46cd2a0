"""Typed reference of what a monitor accuses by name."""

from ..messages.explanation import Reference, ReferenceKind

GNSS, ODOMETER, IMU = "gnss", "odometer", "imu"  # accused by name; satellites and neighbours by their IDs
NEIGHBOUR = "neighbour"  # begins the name of one


def reference(accused: str) -> Reference:
    """Typed reference of a name in the list of those that a monitor accuses, or that a solution leaves out."""
    if accused in (GNSS, ODOMETER, IMU):
        return Reference(kind=ReferenceKind.SOURCE, name=accused)
    if accused.startswith(NEIGHBOUR):
        return Reference(kind=ReferenceKind.NEIGHBOUR, name=accused.removeprefix(NEIGHBOUR).strip())
    return Reference(kind=ReferenceKind.SATELLITE, name=accused)
