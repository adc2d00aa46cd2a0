"""Tracks the devices from which messages are received, and selects one of each kind."""

NS = 1_000_000_000
MAX_SOURCES = 16


class Sources:
    """The devices of one kind and the selected one.

    A device remains selected until no message has been received from it for `silent_s`; then the active device of
    the lowest rank is selected, and among equal ranks the one that was received first.
    """

    def __init__(self, silent_s: float) -> None:
        self._silent_ns = round(silent_s * NS)
        self._received_ns: dict[str, int] = {}
        self._rank: dict[str, int] = {}
        self.chosen: str | None = None

    def note_received(self, source: str, now_ns: int, rank: int = 0) -> bool:
        """Record a message of a device; True if the device is new or was silent. Lower ranks are preferred."""
        before = self._received_ns.get(source)
        if before is None and len(self._received_ns) >= MAX_SOURCES:
            return False
        self._received_ns[source] = now_ns
        self._rank[source] = rank
        return before is None or now_ns - before > self._silent_ns

    def choose(self, now_ns: int) -> str | None:
        """Select a device; None if none is active."""
        active = [source for source, at_ns in self._received_ns.items() if now_ns - at_ns <= self._silent_ns]
        best = min(active, key=lambda source: self._rank[source], default=None)
        if self.chosen not in active or (best and self._rank[best] < self._rank[self.chosen or best]):
            self.chosen = best
        return self.chosen

    def age_s(self, now_ns: int) -> float | None:
        """Time since the last message of any device of this kind."""
        return age_s(max(self._received_ns.values(), default=None), now_ns)


def age_s(at_ns: int | None, now_ns: int) -> float | None:
    """Time since an instant; None if there was none."""
    return None if at_ns is None else max(now_ns - at_ns, 0) / NS
