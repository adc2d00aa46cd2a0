"""Chooses the source whose corrections go to the receiver."""

from collections.abc import Sequence

from .stream import Stream


class Choice:
    """The first source in the order of preference that delivers; a better one must deliver for a while before.

    A receiver starts its ambiguities anew when the base changes, so that a source that comes and goes must not be
    taken at each time. Without any source in use the first frame decides.

    Parameters
    ----------
    settle_ns : int
        [ns] Time for which a preferred source must deliver without a gap until it replaces the present one.
    """

    def __init__(self, settle_ns: int) -> None:
        self.active: Stream | None = None
        self.since_ns = 0
        self._settle_ns = settle_ns

    def update(self, order: Sequence[Stream], now_ns: int) -> None:
        """Choose among the sources in the order of preference."""
        present = self.active if self.active is not None and self.active.delivers(now_ns) else None
        chosen = next((stream for stream in order if self._ready(stream, present, now_ns)), None)
        if chosen is not self.active:
            self.active, self.since_ns = chosen, now_ns

    def _ready(self, stream: Stream, present: Stream | None, now_ns: int) -> bool:
        delivered_ns = stream.delivered_ns(now_ns)
        if delivered_ns is None:
            return False
        return present is None or stream is present or delivered_ns >= self._settle_ns
