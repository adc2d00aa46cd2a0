"""Which messages of a recording a unit is fed with: what the devices said, and nothing that was made of it."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from shared.bus.bus import Envelope
from shared.errors import BadPayload
from shared.messages.base import Message
from shared.messages.gnss import GnssFix
from shared.messages.navigation import TruthState
from shared.runtime.config import VehicleFile
from shared.runtime.offline import OfflineUnit
from shared.topics import measurements

from ..recordings.replaying import inputs_among

RECEIVER = ("gnss/raw", "gnss/fix")
TRUTH = "truth/state"
CONSUMED = tuple(topic.name for topic in measurements() if topic.consumers)


@dataclass
class Inputs:
    """What a solution starts from, in the order of arrival; encoded, because an hour of it decoded is a gigabyte."""

    envelopes: list[Envelope] = field(default_factory=list)
    truth: list[TruthState] = field(default_factory=list)
    topics: Counter[str] = field(default_factory=Counter)  # of the whole recording
    undecodable: set[int] = field(default_factory=set)  # places of envelopes that hold no message

    def __len__(self) -> int:
        return len(self.envelopes)

    def messages(self, topics: Iterable[str] = (*CONSUMED, TRUTH)) -> Iterator[Message]:
        """Decode one message after the other."""
        chosen = frozenset(topics)
        for place, envelope in enumerate(self.envelopes):
            if envelope.topic in chosen:
                try:
                    yield envelope.decode()
                except BadPayload:
                    self.undecodable.add(place)


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
    kept: dict[str, list[Envelope]] = {topic: [] for topic in (*CONSUMED, TRUTH)}
    for envelope in envelopes:
        found.topics[envelope.topic] += 1
        if envelope.topic in kept:
            kept[envelope.topic].append(envelope)
    played = inputs_among(found.topics)
    for topic in CONSUMED:
        if topic in played:
            found.envelopes += kept[topic]
    found.envelopes.sort(key=arrival_of)
    states = Inputs(kept[TRUTH]).messages()
    found.truth = [state for state in states if isinstance(state, TruthState)]
    return found


def arrival_of(envelope: Envelope) -> int:
    """When the bytes of a device arrived at the driver, or a typed message at the recorder."""
    stamp = envelope.properties.get("received_ns", "")
    return int(stamp) if stamp.isascii() and stamp.isdecimal() else envelope.received_ns


def all_fixes(inputs: Inputs, vehicle: VehicleFile) -> list[GnssFix]:
    """List every fix with a position, whether it was recorded as such or is still in the receiver's bytes."""
    unit = OfflineUnit(vehicle, ["parsers.gnss"])
    made = unit.run(inputs.messages(RECEIVER))
    return [message for message in made if isinstance(message, GnssFix) and message.latitude_deg is not None]
