"""What a receiver sends, by its bytes: which kinds of messages, and how many bytes that are none."""

from shared.messages.gnss import GnssReceiver
from shared.protocols.recognition import recognise

MAX_KINDS = 40
PERIOD_NS = 2_000_000_000
RETENTION_NS = 10_000_000_000  # after which a kind that does not come any more is not listed
SAMPLE_BYTES = 2048  # that are looked at where little of what comes is a message


class MessageKinds:
    """The kinds of messages of the last ten seconds, and what has come since the last statement."""

    def __init__(self, source: str, positions: tuple[frozenset[str], ...]) -> None:
        self._source, self._positions = source, positions
        self._kinds: dict[str, int] = {}  # newest arrival of each [ns]
        self._received = self._in_frames = 0  # [bytes]
        self._sample = b""
        self._due_ns = 0
        self._said: frozenset[str] = frozenset()

    def note(self, data: bytes, in_frames: int, received_ns: int) -> None:
        """Take a chunk of bytes, and how many were in the frames that it completed."""
        self._received += len(data)
        self._in_frames += in_frames
        if not in_frames:
            self._sample = (self._sample + data)[-SAMPLE_BYTES:]

    def note_kind(self, kind: str, received_ns: int) -> None:
        """Note a message."""
        if kind in self._kinds or len(self._kinds) < MAX_KINDS:
            self._kinds[kind] = received_ns

    def statement(self, now_ns: int) -> GnssReceiver | None:
        """Say what came: with the first messages of a protocol, and every two seconds in which bytes came."""
        protocols = frozenset(kind.split(" ")[0] for kind in self._kinds)
        if not self._received or (now_ns < self._due_ns and protocols <= self._said):
            return None
        self._kinds = {kind: ns for kind, ns in self._kinds.items() if now_ns - ns <= RETENTION_NS}
        other = max(self._received - self._in_frames, 0)
        found = recognise(self._sample).names if 2 * other > self._received else ()
        said = GnssReceiver(
            received_ns=now_ns, source=self._source, messages=tuple(sorted(self._kinds)), received_bytes=self._received,
            other_bytes=other, gives_position=any(wanted <= self._kinds.keys() for wanted in self._positions),
            other_protocols=tuple(name for name in found if name not in protocols)[:8],
        )  # fmt: skip
        self._due_ns, self._said = now_ns + PERIOD_NS, protocols
        self._received = self._in_frames = 0
        self._sample = b""
        return said
