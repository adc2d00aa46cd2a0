"""What was lost, since when, and for how long: our own observations beside those of `monitoring.health`."""

from collections import deque
from collections.abc import Mapping

from shared.messages.operation import Outage

SAME_EVENT_NS = 15_000_000_000  # two observers of one loss agree to better than this
LENGTH = 200


class OutageBook:
    """A bounded list of outages, open ones included."""

    def __init__(self) -> None:
        self._own: dict[str, Outage] = {}
        self._reported: dict[str, Outage] = {}
        self._closed: deque[Outage] = deque(maxlen=LENGTH)

    def observe(self, now_ns: int, found: Mapping[str, tuple[int, str]], lost: Mapping[str, str]) -> None:
        """Compare what is lost now with what was lost before.

        `found` are new losses at their root (what: since, cause); `lost` is everything that is lost now
        (what: cause). An outage ends only when what it is about is back, and its cause may become clearer.
        """
        for what in [what for what in self._own if what not in lost]:
            self._close(self._own.pop(what).model_copy(update={"until_ns": now_ns}))
        for what, outage in self._own.items():
            self._own[what] = outage.model_copy(update={"cause": lost[what]})
        for what, (since_ns, cause) in found.items():
            self._own.setdefault(what, Outage(what=what, since_ns=since_ns, until_ns=None, cause=cause))

    def report(self, outage: Outage) -> None:
        """Take what `monitoring.health` says; it wins over our own view of the same event."""
        if outage.until_ns is None:
            self._reported[outage.what] = outage
        else:
            self._reported.pop(outage.what, None)
            self._closed = deque((o for o in self._closed if not _same(o, outage)), maxlen=LENGTH)
            self._closed.append(outage)

    def open(self) -> list[Outage]:
        """List what is lost now, oldest first."""
        # Only what we see ourselves: a reporter that died cannot leave an outage open for ever, nor begin this one.
        reported = ((own, self._reported.get(what, own)) for what, own in self._own.items())
        return sorted((r if _same(own, r) else own for own, r in reported), key=lambda o: o.since_ns)

    def closed(self) -> list[Outage]:
        """List what was lost and is back, newest first."""
        return sorted(self._closed, key=lambda o: o.since_ns, reverse=True)

    def _close(self, outage: Outage) -> None:
        if not any(_same(outage, other) for other in self._closed):
            self._closed.append(outage)


def _same(a: Outage, b: Outage) -> bool:
    return a.what == b.what and abs(a.since_ns - b.since_ns) < SAME_EVENT_NS
