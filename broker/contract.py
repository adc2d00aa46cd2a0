"""Bounds of a topic for the simulated broker: Mosquitto has one for all."""

from dataclasses import dataclass
from functools import lru_cache

from shared.topics import topic_of

REMEMBERED = 1_000  # topics


@dataclass(frozen=True)
class Bounds:
    """What may be published on a topic."""

    payload_bytes: int
    retain: bool


@lru_cache(REMEMBERED)
def bounds_of(topic: str) -> Bounds | None:
    """Bounds of a topic as it is on the bus, obu/VEHICLE/NAME; None of one that is not in the contract."""
    prefix, _, rest = topic.partition("/")
    row = topic_of(rest.partition("/")[2]) if prefix == "obu" else None
    return None if row is None else Bounds(row.most_bytes, row.retain)
