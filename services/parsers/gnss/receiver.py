"""Decoding state of one GNSS receiver."""

from collections.abc import Iterator

from shared.kinds import Kinds
from shared.messages.gnss import GnssConfiguration, GnssConfigure, GnssRaw, GnssStart, GnssWrite
from shared.messages.operation import MessageUse
from shared.protocols.framing.framer import Frame, Framer

from .dialect import ContentError, Dialogue, Output, Stream
from .protocols import FRAMINGS, PROTOCOLS
from .seen import MessageKinds


class Receiver:
    """Decodes the bytes of one receiver to fixes, satellites, signals and configuration results."""

    def __init__(self, stream: Stream, kinds: Kinds) -> None:
        self.rate_baud: int | None = None  # of its port
        rejects = stream.rejects
        self._rejects, self._kinds, self._stream = rejects, kinds, stream
        self._framer, self._faults = Framer(FRAMINGS, rejects), stream.faults
        self._dialects = {row.framing.protocol: row.dialect(self._stream) for row in PROTOCOLS}
        positions = (
            frozenset(f"{dialect.name} {kind}" for kind in kinds)
            for dialect in self._dialects.values()
            for kinds in dialect.positions
        )
        self.seen = MessageKinds(stream.source, tuple(positions))

    def take(self, raw: GnssRaw) -> Iterator[Output | GnssWrite]:
        """Process the next bytes; yield the completed messages."""
        self._stream.dates.host_ns = None if raw.recorded else raw.received_ns
        frames = self._framer.feed(raw.data)
        self.seen.note(raw.data, sum(len(frame.data) for frame in frames), raw.received_ns)
        for frame in frames:
            with self._faults.decoding(raw.received_ns):
                yield from self._take_frame(frame, raw.received_ns)

    def configure(self, wanted: GnssConfigure, now_ns: int) -> Iterator[GnssWrite | GnssConfiguration]:
        """Begin to configure the receiver, by the first protocol that can, even before it has said anything."""
        for dialogue in self._dialogues():
            yield from self._written(dialogue.request(wanted, self.rate_baud), now_ns)
            return

    def restart(self, start: GnssStart, now_ns: int) -> Iterator[GnssWrite | GnssConfiguration]:
        """Let the receiver start anew."""
        for dialogue in self._dialogues():
            yield from self._written(iter((dialogue.restart(start),)), now_ns)

    def tick(self, now_ns: int) -> Iterator[GnssWrite | GnssConfiguration]:
        """A second has passed."""
        for dialogue in self._dialogues():
            yield from self._written(dialogue.tick(), now_ns)

    def _dialogues(self) -> list[Dialogue]:
        return [dialect.dialogue for dialect in self._dialects.values() if dialect.dialogue is not None]

    def _take_frame(self, frame: Frame, received_ns: int) -> Iterator[Output | GnssWrite]:
        dialect = self._dialects[frame.protocol]
        kind = dialect.kind(frame.data)
        use, name = dialect.use(kind), f"{dialect.name} {kind}"
        self._kinds.count(name, use)
        self.seen.note_kind(name, received_ns)
        before = dict(self._rejects)
        try:
            if use is MessageUse.USED:
                yield from dialect.take(frame.data, received_ns)
            if dialect.dialogue is not None:
                yield from self._written(dialect.dialogue.take(kind, dialect.payload(frame.data)), received_ns)
        except ContentError as fault:
            self._rejects[str(fault)] += 1
        for reason in [kind for kind, count in self._rejects.items() if count > before.get(kind, 0)][-1:]:
            self._kinds.reject(name, reason)

    def _written(
        self, said: Iterator[bytes | GnssConfiguration], now_ns: int
    ) -> Iterator[GnssWrite | GnssConfiguration]:
        for gnss_configuration in said:
            yield (
                GnssWrite(received_ns=now_ns, source=self._stream.source, data=gnss_configuration)
                if isinstance(gnss_configuration, bytes)
                else gnss_configuration
            )
