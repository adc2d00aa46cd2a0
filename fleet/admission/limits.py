"""Limits how often requests may be refused: each costs a signature to verify, and a row of the database.

They are counted by address, and by the token or vehicle that a request proves to have. What proves to have one is
looked at whatever its address has sent: others behind the same address, or who know a certificate, block nobody.
"""

import time
from collections import OrderedDict
from collections.abc import Callable

FREE = 30  # refusals in a period; vehicles of a whole fleet may share an address
PERIOD_S = 600.0
MAX_NAMES = 4096  # names


class Refusals:
    """Refusals by address, or by token or vehicle; what is granted costs nothing."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._counts: OrderedDict[str, tuple[int, float]] = OrderedDict()  # refusals, since [s]

    def begin(self, name: str) -> float:
        """Count a request as refused before it is looked at; or give the time [s] until the next is counted.

        Requests beside each other pass no more often than requests in turn.
        """
        now_s = self._now_s()
        count, since_s = self._counts.pop(name, (0, now_s))
        if now_s - since_s >= PERIOD_S:
            count, since_s = 0, now_s
        is_full = count >= FREE
        self._counts[name] = (count, since_s) if is_full else (count + 1, since_s)
        while len(self._counts) > MAX_NAMES:
            self._counts.popitem(last=False)
        return since_s + PERIOD_S - now_s if is_full else 0.0

    def take_back(self, name: str) -> None:
        """Take back a request that was granted, or not decided."""
        if name in self._counts:
            count, since_s = self._counts[name]
            self._counts[name] = max(count - 1, 0), since_s
