"""Selects the inputs of a solution from a recording: the messages of the devices, not those derived from them."""

from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field

from shared.bus.bus import Envelope
from shared.errors import BadPayload
from shared.messages.base import Message
from shared.messages.gnss import GnssFix
from shared.messages.navigation import TruthState
from shared.messages.trust import LearnedGrade, LearnedScale
from shared.runtime.config import VehicleFile
from shared.runtime.live import arrival_ns
from shared.runtime.mounting import RecordedAxes
from shared.runtime.offline import OfflineUnit
from shared.topics import BY_NAME, measurements

from ..recordings.device_data import inputs_among

RECEIVER = ("gnss/raw", "gnss/fix")
TRUTH = "truth/state"
LEARNED_TOPICS = ("trust/grade", "trust/inertial_scale")  # what earlier drives had taught when this one began
CONSUMED = tuple(topic.name for topic in measurements() if topic.consumers)


@dataclass
class Inputs:
    """The inputs of a solution in the order of arrival, encoded (one hour of decoded messages takes 1 GB)."""

    envelopes: list[Envelope] = field(default_factory=list)
    truth: list[TruthState] = field(default_factory=list)
    topics: Counter[str] = field(default_factory=Counter)  # of the whole recording
    undecodable: set[int] = field(default_factory=set)  # indices of envelopes that cannot be decoded
    newer: str = ""  # what to add to an error: `Recording.newer`

    def __len__(self) -> int:
        return len(self.envelopes)

    def messages(
        self, vehicle: VehicleFile, topics: Iterable[str] = (*CONSUMED, TRUTH, *LEARNED_TOPICS)
    ) -> Iterator[Message]:
        """Decode the messages of the given topics one by one, inertial samples in the axes of a vehicle's file."""
        chosen, axes = frozenset(topics), RecordedAxes(vehicle)
        for place, envelope in enumerate(self.envelopes):
            if envelope.topic in chosen:
                try:
                    yield axes.apply(envelope.decode())
                except BadPayload:
                    self.undecodable.add(place)


def inputs_of(envelopes: Iterable[Envelope]) -> Inputs:
    """Select the inputs from all recorded messages.

    Parameters
    ----------
    envelopes : iterable of Envelope
        All messages of a recording.

    Returns
    -------
    Inputs
        Raw bytes if recorded, otherwise the typed messages of the same sensors; the outputs of layers 2 to 4 at the
        time of recording are not used, but for what earlier drives had taught.
    """
    found = Inputs()
    kept: dict[str, list[Envelope]] = {topic: [] for topic in (*CONSUMED, TRUTH, *LEARNED_TOPICS)}
    for envelope in envelopes:
        found.topics[envelope.topic] += 1
        if envelope.topic in kept:
            kept[envelope.topic].append(envelope)
    played = inputs_among(found.topics)
    for topic in CONSUMED:
        if topic in played:
            found.envelopes += kept[topic]
    found.envelopes.sort(key=arrival_of)
    learned = [envelope for topic in LEARNED_TOPICS for envelope in learned_before(kept[topic], found.envelopes)]
    found.envelopes = learned + found.envelopes
    for envelope in kept[TRUTH]:
        with suppress(BadPayload):
            state = envelope.decode()
            if isinstance(state, TruthState):
                found.truth.append(state)
    return found


def learned_before(learned: list[Envelope], inputs: list[Envelope]) -> list[Envelope]:
    """The newest lesson of a topic that was known when a drive began; what this drive has taught is for the next."""
    first_ns = next((arrival_of(envelope) for envelope in inputs), 0)
    earlier = []
    for envelope in learned:
        with suppress(BadPayload):
            message = envelope.decode()
            if isinstance(message, LearnedGrade | LearnedScale) and message.sampled_ns <= first_ns:
                earlier.append(envelope)
    return earlier[-1:]


def arrival_of(envelope: Envelope) -> int:
    """Arrival time [ns] of a device's bytes at the driver, or of a typed message at the recorder."""
    if BY_NAME[envelope.topic].is_raw:
        with suppress(BadPayload):
            return arrival_ns(envelope.decode()) or envelope.received_ns
    return envelope.received_ns


def all_fixes(inputs: Inputs, vehicle: VehicleFile) -> list[GnssFix]:
    """All fixes with a position, recorded as such or decoded from the receiver's bytes."""
    unit = OfflineUnit(vehicle, ["parsers.gnss"])
    made = unit.run(inputs.messages(vehicle, RECEIVER))
    return [message for message in made if isinstance(message, GnssFix) and message.latitude_deg is not None]
