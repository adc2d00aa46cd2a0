"""Devices whose measurements are accepted, and how many values of each are used."""

from collections import Counter
from collections.abc import Callable

MAX_AGE_PERIODS = 100  # periods by which a value may be older than the newest; more is a clock that was set back
SILENCE_TIMEOUT_NS = 3_600_000_000_000  # silence after which a device is dropped
DEVICES = 32  # largest number of devices, which bounds memory


class Devices:
    """Devices whose messages are accepted: the first `DEVICES`; messages of others are counted in `rejects`.

    A device that is silent for an hour, on the clock of the inertial samples, is dropped.
    """

    def __init__(self, rejects: Counter[str], clock: Callable[[], int]) -> None:
        self._rejects, self._clock = rejects, clock
        self._last_ns: dict[str, int] = {}  # stamp of the last message of each
        self._used: dict[tuple[str, str], int] = {}  # period of the newest value, by device and quantity

    def __len__(self) -> int:
        return len(self._last_ns)

    def is_known(self, source: str) -> bool:
        """Whether messages of a device are accepted."""
        now_ns = self._clock()
        if source not in self._last_ns and len(self._last_ns) >= DEVICES:
            self._drop_silent(now_ns)
            if len(self._last_ns) >= DEVICES:
                self._rejects["too many devices"] += 1
                return False
        self._last_ns[source] = now_ns
        return True

    def _drop_silent(self, now_ns: int) -> None:
        self._last_ns = {name: at for name, at in self._last_ns.items() if abs(now_ns - at) <= SILENCE_TIMEOUT_NS}
        self._used = {key: period for key, period in self._used.items() if key[0] in self._last_ns}

    def is_due(self, source: str, quantity: str, time_ns: int, period_ns: int) -> bool:
        """Whether a value is the first of its period, by its stamp."""
        if not self.is_known(source):
            return False
        key, period = (source, quantity), time_ns // period_ns
        used = self._used.get(key)
        if used is not None and 0 <= used - period < MAX_AGE_PERIODS:
            return False
        self._used[key] = period
        return True
