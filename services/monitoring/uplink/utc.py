"""UTC for reports: the OBU time line and an offset, which GNSS or a synchronised host clock gives."""

from typing import NamedTuple

from shared.maths.dates import is_plausible
from shared.messages.gnss import GnssFix
from shared.messages.operation import HostClock

NS = 1_000_000_000
NS_PER_MS = 1_000_000
JUMP_NS = 10 * NS
HOST_SILENT_NS = 120 * NS  # after which a host clock counts as no longer held
AGREE_NS = 10 * NS  # of GNSS with the host's clock


class Jump(NamedTuple):
    """The clock changed at once; times before it are wrong, or those after it."""

    before_ms: int  # UTC of the moment by the old offset
    after_ms: int
    source: str


class Utc:
    """Offset of UTC from the OBU time line; none is known at the start of the process.

    GNSS is used while it is not excluded. Where a host clock that NTP holds contradicts it, the host's is used.
    """

    def __init__(self) -> None:
        self.offset_ns: int | None = None  # None: not known
        self._host: tuple[int, int] | None = None  # offset, and when it was stated
        self.jumps: list[Jump] = []

    def add_clock(self, clock: HostClock) -> None:
        """Take the host's clock: it is used if something holds it, and GNSS has not stated UTC."""
        offset_ns = clock.utc_ns - clock.sampled_ns
        if not clock.synchronised or not is_plausible(clock.utc_ns):
            self._host = None
            return
        self._host = offset_ns, clock.sampled_ns
        if self.offset_ns is None or abs(self.offset_ns - offset_ns) > AGREE_NS:
            self._use(offset_ns, clock.sampled_ns, "host")

    def add_fix(self, fix: GnssFix, *, excluded: bool) -> None:
        """Take the UTC of a receiver's epoch, unless GNSS is excluded."""
        if fix.utc_ns is None or excluded or not is_plausible(fix.utc_ns):
            return
        offset_ns = fix.utc_ns - fix.sampled_ns
        host_ns, stated_ns = self._host or (offset_ns, fix.sampled_ns)
        if fix.sampled_ns - stated_ns <= HOST_SILENT_NS and abs(offset_ns - host_ns) > AGREE_NS:
            return
        self._use(offset_ns, fix.sampled_ns, "gnss")

    def ns(self, time_ns: int) -> int | None:
        """UTC of a time of the OBU time line; None while it is not known."""
        return None if self.offset_ns is None else time_ns + self.offset_ns

    def _use(self, offset_ns: int, time_ns: int, source: str) -> None:
        if self.offset_ns is not None and abs(offset_ns - self.offset_ns) > JUMP_NS:
            before, after = (time_ns + self.offset_ns) // NS_PER_MS, (time_ns + offset_ns) // NS_PER_MS
            self.jumps.append(Jump(before, after, source))
        self.offset_ns = offset_ns
