"""Which of several devices that measure the same quantity is used: one rule for all processes."""

SILENT_NS = 5_000_000_000  # silence of the device in use after which another one is used


class ChosenSource:
    """The device in use: of those that are heard, the one whose name is first in alphabetical order.

    The choice does not depend on which device was heard first, and is the same in every process. Two control units
    that tell different speeds (a tractor and its trailer, say) are never mixed.
    """

    def __init__(self) -> None:
        self._source: str | None = None
        self._heard_ns = 0

    def takes(self, source: str, received_ns: int) -> bool:
        """Note a message of a device; True if it is the one in use."""
        if self._source is not None and source > self._source and not self._is_silent(received_ns):
            return False
        self._source, self._heard_ns = source, received_ns
        return True

    def current(self, now_ns: int) -> str | None:
        """The device in use; None while it is silent."""
        return None if self._is_silent(now_ns) else self._source

    def _is_silent(self, now_ns: int) -> bool:
        return not 0 <= now_ns - self._heard_ns <= SILENT_NS
