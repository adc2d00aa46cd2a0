"""Which devices have been heard, and which of each kind is used."""

NS = 1_000_000_000
MAX_SOURCES = 16


class Sources:
    """The devices of one kind, and the choice among them.

    The choice stays with a device until it has been silent for `silent_s`; then it falls on the best that is heard,
    and among equals on the one that was heard first.
    """

    def __init__(self, silent_s: float) -> None:
        self._silent_ns = round(silent_s * NS)
        self._heard_ns: dict[str, int] = {}
        self._rank: dict[str, int] = {}
        self.chosen: str | None = None

    def hear(self, source: str, now_ns: int, rank: int = 0) -> bool:
        """Note that a device spoke; True if it is new, or speaks again after it was silent. Lower ranks are better."""
        before = self._heard_ns.get(source)
        if before is None and len(self._heard_ns) >= MAX_SOURCES:
            return False
        self._heard_ns[source] = now_ns
        self._rank[source] = rank
        return before is None or now_ns - before > self._silent_ns

    def choose(self, now_ns: int) -> str | None:
        """Choose again where that is needed; None if no device is heard."""
        heard = [source for source, at_ns in self._heard_ns.items() if now_ns - at_ns <= self._silent_ns]
        best = min(heard, key=lambda source: self._rank[source], default=None)
        if self.chosen not in heard or (best and self._rank[best] < self._rank[self.chosen or best]):
            self.chosen = best
        return self.chosen

    def age_s(self, now_ns: int) -> float | None:
        """Time since any device of this kind spoke."""
        return age_s(max(self._heard_ns.values(), default=None), now_ns)


def age_s(at_ns: int | None, now_ns: int) -> float | None:
    """Time since an instant; None if there was none."""
    return None if at_ns is None else max(now_ns - at_ns, 0) / NS
