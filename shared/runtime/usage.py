"""Memory use of this process."""

import os
import time
from pathlib import Path

PAGES = Path("/proc/self/statm")
ROLLUP = Path("/proc/self/smaps_rollup")
PSS_PERIOD_S = 10.0
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


def resident_bytes() -> int:
    """Resident set size [bytes]; its maximum on systems other than Linux."""
    try:
        return int(PAGES.read_bytes().split()[1]) * PAGE_BYTES
    except OSError:
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


class ProportionalSize:
    """Proportional set size of this process [bytes]; 0 where the kernel does not state it."""

    def __init__(self) -> None:
        self._bytes, self._due = 0, 0.0

    def read(self) -> int:
        """Give the newest value; the kernel is asked every ten seconds, for it takes half a millisecond."""
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + PSS_PERIOD_S
            try:
                fields = (line.split() for line in ROLLUP.read_bytes().splitlines())
                self._bytes = next((int(words[1]) * 1024 for words in fields if words[0] == b"Pss:"), 0)
            except OSError:
                self._bytes = 0
        return self._bytes
