"""Packages that are installed beside the unit, and what they bring by their entry points."""

from collections.abc import Iterator
from importlib.metadata import entry_points

AID_STATES, AIDS = "obu.aid_states", "obu.aids"  # groups: states of the navigation filter, and its measurements


def brought(group: str) -> Iterator[object]:
    """Load what installed packages offer in a group of entry points, in the order of their names."""
    for point in sorted(entry_points(group=group), key=lambda point: point.name):
        yield point.load()


def offered(group: str) -> list[str]:
    """Name what is offered in a group, and where, without loading it."""
    return sorted(f"{point.name} {point.value}" for point in entry_points(group=group))
