"""Limits how often one address may be refused: each refusal costs a signature to verify, and a row of the database."""

import time
from collections import OrderedDict
from collections.abc import Callable

FREE = 30  # refusals in a period; vehicles of a whole fleet may share an address
PERIOD_S = 600.0
KEPT = 4096  # addresses


class Refusals:
    """Refusals by address; what is granted costs nothing."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._counts: OrderedDict[str, tuple[int, float]] = OrderedDict()  # refusals, since [s]

    def wait_s(self, address: str) -> float:
        """Seconds until this address is answered again; 0: now."""
        count, since_s = self._counts.get(address, (0, 0.0))
        return max(0.0, since_s + PERIOD_S - self._now_s()) if count >= FREE else 0.0

    def add(self, address: str) -> None:
        """Count a refusal."""
        now_s = self._now_s()
        count, since_s = self._counts.pop(address, (0, now_s))
        self._counts[address] = (1, now_s) if now_s - since_s >= PERIOD_S else (count + 1, since_s)
        while len(self._counts) > KEPT:
            self._counts.popitem(last=False)
