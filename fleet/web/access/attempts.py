"""Limits how often a password may be tried: for an account from an address, from an address, and for an account.

An account has so many free that nobody locks another person out from one address. Within a session it counts apart.
"""

import time
from collections import OrderedDict
from collections.abc import Callable, Iterable
from enum import IntEnum
from typing import NamedTuple

from services.monitoring.status.web.access.peer import place_of

FIRST_WAIT_S, MOST_WAIT_S = 2.0, 900.0
FORGOTTEN_S = 3600.0
KEPT = 4096


class Free(IntEnum):
    """Failures that cost nothing."""

    ONE = 5  # of one person: an account from an address, or a session
    ADDRESS = 30  # which many may share
    ACCOUNT = 100  # from all addresses


class Origin(NamedTuple):
    """Whose failures are counted together."""

    name: str
    free: Free


def origins(account: str, host: str) -> tuple[Origin, Origin, Origin]:
    """What a login is counted by: the person, the place, the account."""
    place = place_of(host)
    return (
        Origin(f"login of {account} from {place}", Free.ONE),
        Origin(f"address {place}", Free.ADDRESS),
        Origin(f"account {account}", Free.ACCOUNT),
    )


class Attempts:
    """Failures by origin; after the free ones each doubles the time until the next attempt is taken."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._failures: OrderedDict[Origin, tuple[int, float]] = OrderedDict()

    def wait_s(self, origins: Iterable[Origin]) -> float:
        """Seconds until the next attempt is taken; 0 if it may be made now."""
        return max(map(self._wait_s, origins), default=0.0)

    def failed(self, origins: Iterable[Origin]) -> None:
        """Count a failure."""
        now_s = self._now_s()
        for origin in origins:
            count, last_s = self._failures.pop(origin, (0, now_s))
            self._failures[origin] = (1 if now_s - last_s > FORGOTTEN_S else count + 1), now_s
        while len(self._failures) > KEPT:
            self._failures.popitem(last=False)

    def succeeded(self, origins: Iterable[Origin]) -> None:
        """Forget the failures of a person, and take back the one that was counted at once of what others share."""
        for origin in origins:
            count, last_s = self._failures.pop(origin, (0, 0.0))
            if origin.free is not Free.ONE and count > 1:
                self._failures[origin] = count - 1, last_s

    def _wait_s(self, origin: Origin) -> float:
        count, last_s = self._failures.get(origin, (0, 0.0))
        if count < origin.free:
            return 0.0
        pause_s = min(FIRST_WAIT_S * 2.0 ** min(count - origin.free, 20), MOST_WAIT_S)
        return max(0.0, last_s + pause_s - self._now_s())
