"""Which messages of a recording a unit is fed with: what the devices said, and nothing that was made of it."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TypeVar

from shared.bus import Envelope
from shared.config import VehicleFile
from shared.errors import BadPayload
from shared.messages import GnssFix, GnssRaw, Message, TruthState
from shared.offline import OfflineUnit, arrival_ns

# Bytes of a device, and the topics that are made of them again.
MADE_OF = {"gnss/raw": ("gnss/fix",), "imu/raw": ("imu/sample",), "can/raw": ("vehicle/speed", "vehicle/wheel_speed")}
TRUTH = "truth/state"
WANTED = {TRUTH, *MADE_OF, *(topic for made in MADE_OF.values() for topic in made)}
M = TypeVar("M", bound=Message)


@dataclass
class Inputs:
    """The messages of a recording that a solution starts from, in the order of their arrival."""

    messages: list[Message] = field(default_factory=list)
    truth: list[TruthState] = field(default_factory=list)
    topics: Counter[str] = field(default_factory=Counter)  # of the whole recording
    undecodable: int = 0


def inputs_of(envelopes: Iterable[Envelope]) -> Inputs:
    """Pick the inputs out of everything that was recorded.

    Parameters
    ----------
    envelopes : iterable of Envelope
        All of a recording.

    Returns
    -------
    Inputs
        Raw bytes where there are some, and else the typed messages of the same sensors; never what layers 2
        to 4 said when it was recorded.
    """
    found = Inputs()
    kept: dict[str, list[Envelope]] = {topic: [] for topic in WANTED}
    for envelope in envelopes:
        found.topics[envelope.topic] += 1
        if envelope.topic in kept:
            kept[envelope.topic].append(envelope)
    for raw, made in MADE_OF.items():
        for topic in (raw,) if kept[raw] else made:
            found.messages += _decoded(kept[topic], Message, found)
    found.messages.sort(key=lambda message: arrival_ns(message) or 0)
    found.truth = _decoded(kept[TRUTH], TruthState, found)
    return found


def _decoded(envelopes: Iterable[Envelope], kind: type[M], found: Inputs) -> list[M]:
    messages = []
    for envelope in envelopes:
        try:
            message = envelope.decode()
        except BadPayload:
            found.undecodable += 1
            continue
        if isinstance(message, kind):
            messages.append(message)
    return messages


def all_fixes(messages: Iterable[Message], vehicle: VehicleFile) -> list[GnssFix]:
    """List every fix with a position, whether it was recorded as such or is still in the receiver's bytes."""
    receiver = (message for message in messages if isinstance(message, GnssFix | GnssRaw))
    unit = OfflineUnit(vehicle, ["parsers.gnss"])
    return [m for m in unit.run(receiver) if isinstance(m, GnssFix) and m.latitude_deg is not None]
