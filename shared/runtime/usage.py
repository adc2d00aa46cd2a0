"""What this process uses of the machine."""

import os
from pathlib import Path

PAGES = Path("/proc/self/statm")
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


def resident_bytes() -> int:
    """Measure the memory of this process that is in RAM; elsewhere than on Linux, the most that it ever was."""
    try:
        return int(PAGES.read_bytes().split()[1]) * PAGE_BYTES
    except OSError:
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
