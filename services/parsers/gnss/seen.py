"""What a receiver sends, by its bytes: which kinds of messages, and how many bytes that are none."""

from functools import cache

from pyubx2.ubxtypes_core import UBX_MSGIDS

from shared.messages.gnss import GnssReceiver

from .framer import Frame, Protocol

MAX_KINDS = 40
PERIOD_NS = 2_000_000_000
FORGOTTEN_NS = 10_000_000_000  # after which a kind that does not come any more is not listed


class Seen:
    """The kinds of messages of the last ten seconds, and what has come since the last statement."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._kinds: dict[str, int] = {}  # newest arrival of each [ns]
        self._received = self._in_frames = 0  # [bytes]
        self._due_ns = 0
        self._said: frozenset[str] = frozenset()

    def note(self, size: int, frames: list[Frame], received_ns: int) -> None:
        """Take a chunk of bytes and the frames that it completed."""
        self._received += size
        for frame in frames:
            self._in_frames += len(frame.data)
            kind = kind_of(frame)
            if kind in self._kinds or len(self._kinds) < MAX_KINDS:
                self._kinds[kind] = received_ns

    def statement(self, now_ns: int) -> GnssReceiver | None:
        """Say what came: with the first messages of a protocol, and every two seconds in which bytes came."""
        protocols = frozenset(kind.split(" ")[0] for kind in self._kinds)
        if not self._received or (now_ns < self._due_ns and protocols <= self._said):
            return None
        self._kinds = {kind: ns for kind, ns in self._kinds.items() if now_ns - ns <= FORGOTTEN_NS}
        other = max(self._received - self._in_frames, 0)
        said = GnssReceiver(
            received_ns=now_ns, source=self._source, messages=tuple(sorted(self._kinds)), received_bytes=self._received,
            other_bytes=other,
        )  # fmt: skip
        self._due_ns, self._said = now_ns + PERIOD_NS, protocols
        self._received = self._in_frames = 0
        return said


def kind_of(frame: Frame) -> str:
    """Name the kind of a message: protocol and message, such as `UBX NAV-PVT`, `NMEA GGA` or `RTCM 1005`."""
    data = frame.data
    if frame.protocol is Protocol.UBX:
        return f"UBX {_ubx_name(data[2], data[3])}"
    if frame.protocol is Protocol.RTCM:
        return f"RTCM {data[3] << 4 | data[4] >> 4}"
    head = data[1:].split(b",")[0].decode("ascii", "replace")
    return f"NMEA {head if head.startswith('P') else head[-3:]}"[:40]


@cache
def _ubx_name(kind: int, number: int) -> str:
    return UBX_MSGIDS.get(bytes((kind, number)), f"{kind:02X}-{number:02X}")
