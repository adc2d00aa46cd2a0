"""The frames of one source of corrections, and since when they have come without a gap."""

from collections import Counter, deque

from shared.messages.corrections import CorrectionSource, CorrectionStream

from .frames import CorrectionFrame, CorrectionFramer

NS = 1_000_000_000
RATE_S = 10.0  # over which the rate is taken: base stations send their position and ephemerides that often
MAX_ENTRIES = 1024  # of arrivals within it


class Stream:
    """Finds the frames of one source.

    Parameters
    ----------
    source : str
        Name of the source.
    rejects : Counter
        Shared by all sources of the process.
    silent_ns : int
        [ns] Time without a frame after which the source is silent.
    """

    def __init__(self, source: str, rejects: Counter[str], silent_ns: int) -> None:
        self.source = source
        self.connection: CorrectionSource | None = None
        self._framer = CorrectionFramer(rejects)
        self._silent_ns = silent_ns
        self._received_bytes = self._frames = 0
        self._since_ns = self._last_ns = 0  # of the frames without a gap
        self._arrivals: deque[tuple[int, int]] = deque(maxlen=MAX_ENTRIES)

    def take(self, data: bytes, now_ns: int) -> list[CorrectionFrame]:
        """Process received bytes; return the frames that they complete."""
        self._received_bytes += len(data)
        frames = self._framer.feed(data)
        if frames:
            if not self.delivers(now_ns):
                self._since_ns = now_ns
            self._last_ns = now_ns
            self._frames += len(frames)
            self._arrivals.append((now_ns, sum(len(frame.data) for frame in frames)))
        return frames

    def delivers(self, now_ns: int) -> bool:
        """Whether a frame has come within the time after which the source is silent."""
        return self._frames > 0 and 0 <= now_ns - self._last_ns <= self._silent_ns

    def delivered_ns(self, now_ns: int) -> int | None:
        """Time from the first to the last of the frames without a gap; None while it is silent."""
        return self._last_ns - self._since_ns if self.delivers(now_ns) else None

    def age_s(self, now_ns: int) -> float | None:
        """Age of the last frame; None without one."""
        return max(now_ns - self._last_ns, 0) / NS if self._frames else None

    def statement(self, now_ns: int) -> CorrectionStream:
        """State connection and frames of the source."""
        while self._arrivals and now_ns - self._arrivals[0][0] > RATE_S * NS:
            self._arrivals.popleft()
        connection = self.connection
        return CorrectionStream(
            source=self.source,
            phase=connection.phase if connection else None,
            reason=self._reason(now_ns),
            received_bytes=self._received_bytes,
            frames=self._frames,
            frame_age_s=self.age_s(now_ns),
            rate_bytes_s=sum(size for _, size in self._arrivals) / RATE_S,
        )

    def _reason(self, now_ns: int) -> str:
        if self._received_bytes and not self._frames:
            return "sends bytes, but no frame of RTCM 3 or SPARTN: is this the right mount point, port or baud rate?"
        return self.connection.reason if self.connection else ""
