"""Counts of what was refused or lost; one log line a second at most for each kind."""

import logging
import time
from collections import Counter

log = logging.getLogger(__name__)
LOG_PERIOD_S = 1.0


class Counters:
    """Counts by kind."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._logged_s: dict[str, float] = {}

    def note(self, kind: str, detail: str) -> None:
        """Count one event."""
        self.counts[kind] += 1
        now_s = time.monotonic()
        if now_s - self._logged_s.get(kind, -LOG_PERIOD_S) >= LOG_PERIOD_S:
            self._logged_s[kind] = now_s
            log.warning("%s: %s (%d so far)", kind, detail, self.counts[kind])
