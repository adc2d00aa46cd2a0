"""Memory use of this process."""

import os
from pathlib import Path

PAGES = Path("/proc/self/statm")
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


def resident_bytes() -> int:
    """Resident set size [bytes]; its maximum on systems other than Linux."""
    try:
        return int(PAGES.read_bytes().split()[1]) * PAGE_BYTES
    except OSError:
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
