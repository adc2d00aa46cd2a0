"""Faults are bounded: what one item of the input holds costs at most that item.

What bytes can say and a message cannot is foreseen: decoders reject it by name, and the message model by its ranges. It
is counted without limit, so that no sender can end a process. Any other error is a fault of the program. It costs the
item as well and is logged, but three within ten seconds end the process: a fault must not hide for ever.
"""

import logging
import struct
from collections import Counter, deque
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from types import TracebackType

from pydantic import ValidationError

from .errors import ObuError, TooManyFaults

log = logging.getLogger(__name__)

RANGE, FAULT = "range", "fault"  # rejects: a value that the message model refuses, and an error that nobody foresaw
MOST, WITHIN_NS = 3, 10_000_000_000
# What the decoders of others raise for bytes that they do not expect, beside their own errors: a plain reject.
FOREIGN = (
    ValueError, LookupError, ArithmeticError, TypeError, AttributeError, NotImplementedError, struct.error,
)  # fmt: skip


class Faults:
    """Counts in `rejects` what goes wrong with one item, and ends the process where that happens too often."""

    def __init__(self, rejects: Counter[str]) -> None:
        self.last: str | None = None
        self._rejects = rejects
        self._times_ns: deque[int] = deque(maxlen=MOST)

    @contextmanager
    def decoding(self, now_ns: int) -> Iterator[None]:
        """Decode one frame, sentence or row: a message that its model refuses is a reject, the rest as `handling`."""
        with self.handling(now_ns):
            try:
                yield
            except ValidationError:
                self._rejects[RANGE] += 1

    def handling(self, now_ns: int) -> AbstractContextManager[None, bool]:
        """Handle one message: an error is counted, and the third within ten seconds ends the process.

        `now_ns` is on the OBU time line.

        Raises
        ------
        TooManyFaults
            The third error within ten seconds.
        ObuError
            Errors that the unit raises itself pass.
        """
        return _Handling(self, now_ns)

    def count(self, error: Exception, now_ns: int) -> None:
        """Count a fault; raises `TooManyFaults`."""
        self._rejects[FAULT] += 1
        self.last = f"{type(error).__name__}: {error}"[:400]
        self._times_ns.append(now_ns)
        if len(self._times_ns) == MOST and abs(now_ns - self._times_ns[0]) <= WITHIN_NS:
            raise TooManyFaults(f"{MOST} faults within {WITHIN_NS // 10**9} s, the last {self.last}") from error
        log.warning("a fault cost one item: %s", self.last, exc_info=error)


class _Handling(AbstractContextManager[None, bool]):
    """As a generator with `contextmanager` would be, at a fifth of its cost: there is one for each message."""

    __slots__ = ("_faults", "_now_ns")

    def __init__(self, faults: Faults, now_ns: int) -> None:
        self._faults, self._now_ns = faults, now_ns

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        if not isinstance(error, Exception) or isinstance(error, ObuError):
            return False
        self._faults.count(error, self._now_ns)
        return True
