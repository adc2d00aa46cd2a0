"""What an export reads of a recording: messages of one topic, recorded or decoded from a receiver's bytes."""

from collections.abc import Iterator
from dataclasses import dataclass

from rich.console import Console

from shared.errors import BadPayload, BadRecording, UserError
from shared.messages.base import Message
from shared.recording import Recording
from shared.recording.index import RecordingIndex, chosen
from shared.runtime.config import VehicleFile
from shared.runtime.offline import OfflineUnit
from shared.topics import topic_of

from ..progress import progress_on
from ..utc import UtcLine

STEP = 500  # messages between two looks at the progress
RECEIVER = "gnss/raw"


@dataclass
class Source:
    """The messages of a recording by topic; `topics` is what it holds."""

    recording: Recording
    vehicle: VehicleFile
    topics: frozenset[str]
    console: Console

    def has(self, topic: str) -> bool:
        """Whether the recording holds a topic, or bytes of the receiver from which it is decoded."""
        return topic in self.topics or (topic.startswith("gnss/") and RECEIVER in self.topics)

    def messages(self, topic: str) -> Iterator[Message]:
        """Yield the messages of a topic in the order of their arrival, with progress."""
        if topic in self.topics:
            yield from self._recorded(topic)
            return
        unit = OfflineUnit(self.vehicle, ["parsers.gnss"])
        wanted = type_of(topic)
        yield from (message for message in unit.run(self._recorded(RECEIVER)) if isinstance(message, wanted))

    def _recorded(self, topic: str) -> Iterator[Message]:
        span = self._span_ns()
        with progress_on(self.console) as progress:
            task = progress.add_task(f"reading {topic}", total=span[1] - span[0] if span else None)
            for count, envelope in enumerate(chosen(self.recording, (topic,))):
                try:
                    yield envelope.decode()
                except BadPayload:
                    continue  # as every consumer would
                if span and count % STEP == 0:
                    progress.update(task, completed=envelope.received_ns - span[0])

    def _span_ns(self) -> tuple[int, int] | None:
        try:
            index = RecordingIndex(self.recording)
        except BadRecording:
            return None
        return index.begin_ns, index.end_ns

    def utc(self) -> UtcLine:
        """UTC of the unit's time line, by the fixes."""
        return UtcLine(self.messages("gnss/fix") if self.has("gnss/fix") else ())


def type_of(topic: str) -> type[Message]:
    """Find the message type of a topic."""
    row = topic_of(topic)
    if row is None:
        raise UserError(f"{topic} is no topic of the contract; `obu topics` lists them")
    return row.message
