"""Finds frames in a byte stream that may hold anything, at a constant cost for each byte.

Where a header could begin is a candidate. Candidates overlap: noise may hold one every three bytes, each of them
kilobytes long. Therefore no checksum is computed over a candidate. Running sums over the stream are, once for each
byte, and the checksum of a candidate follows from the sums at its two ends.
"""

import re
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from heapq import heappop, heappush
from typing import Generic, TypeVar

F = TypeVar("F")
Sums = tuple[int, ...]  # the running sums at one place of the stream
TAIL = 5  # [bytes] at the end of the stream whose sums may be needed again: a header without its last byte, a checksum
Candidate = tuple[int, int, Sums]  # start and end (offsets in the stream), sums at its start


class FrameFinder(ABC, Generic[F]):
    """Splits a stream into the frames of a protocol; bytes between frames are counted as `garbage_bytes`.

    After an invalid candidate the search continues at its second byte, and a complete frame inside an incomplete one
    takes precedence: a corrupted length neither suppresses nor delays the frames that follow. What is invalid counts
    when it turns out not to be part of a frame. `judged` is the number of candidates that were checked, `summed` that
    of the bytes that were added to the sums.
    """

    starts: re.Pattern[bytes]  # a complete header that is possible, or the beginning of one at the end of the data
    malformed: re.Pattern[bytes]  # the beginning of a header that is impossible, where `starts` does not match
    kinds: Mapping[bytes, str]  # of reject, by what `malformed` matches
    most_bytes: int  # of a frame
    cut: str  # kind of reject of an incomplete frame that holds a complete one
    tail: int = TAIL

    def __init__(self, rejects: Counter[str] | None = None) -> None:
        self.rejects: Counter[str] = Counter() if rejects is None else rejects
        self.judged = self.summed = 0
        self._buffer = bytearray()
        # Offsets in the stream: of the buffer, of the first byte that is neither framed nor counted (as the buffer's
        # after each call), of the first one not searched for candidates, and of the first one whose sums are needed.
        self._base = self._position = self._scan = self._summed_from = 0
        self._waiting: dict[int, list[Candidate]] = {}  # by the offset up to which data must arrive to judge them
        self._valid: dict[int, F] = {}  # by their start: frames that wait until no other is open around them
        self._open: deque[tuple[int, int]] = deque()  # start and end of the incomplete candidates, by start
        self._longest_end = self._end = 0  # of any incomplete candidate, and of the data
        self._faults: list[tuple[int, str]] = []  # a heap of offset and kind of what may be inside a frame

    def feed(self, data: bytes) -> list[F]:
        """Process the next bytes; return the completed frames."""
        found: list[F] = []
        for start in range(0, len(data), self.most_bytes):
            found += self._feed(data[start : start + self.most_bytes])
        return found

    def _feed(self, data: bytes) -> list[F]:
        self._buffer += data
        before, end = self._end, self._base + len(self._buffer)
        self._end = end
        new = bytes(self._buffer[self._summed_from - self._base :])
        self.summed += len(new)
        self._sum(new)
        found = [*self._ripe(before, end), *self._search(end)]
        front = min(self._scan, self._first_open())
        self._pass_over(front)
        keep = max(front, end - self.tail)
        self._carry(keep - self._summed_from)
        del self._buffer[: front - self._base]
        self._base, self._summed_from = front, keep
        return found

    def _ripe(self, before: int, end: int) -> Iterator[F]:
        """Judge the candidates whose last byte has arrived, in their order."""
        waiting = self._waiting
        ripe = [pair for at in range(before + 1, end + 1) for pair in waiting.pop(at, ())] if waiting else []
        for start, stop, sums in sorted(ripe):
            if (frame := self._judge(start, stop, sums)) is not None:
                yield frame
        self._scan = max(self._scan, self._position)

    def _search(self, end: int) -> Iterator[F]:
        buffer, base, search = self._buffer, self._base, self.starts.search
        scan = self._scan
        while scan < end:
            match = search(buffer, scan - base)
            start = end if match is None else match.start() + base
            if start > scan:
                self._count_skipped(scan - base, start - base)
                scan = start
            if match is None or (size := self._size(start - base, match)) is None:
                break
            scan = start + 1
            stop = start + size
            if stop > end:
                self._wait(stop, (start, stop, self._sums(start - self._summed_from)))
                self._open.append((start, stop))
                self._longest_end = max(self._longest_end, stop)
            elif size and (frame := self._judge(start, stop, None)) is not None:
                scan = stop
                yield frame
        self._scan = scan

    def _wait(self, until: int, candidate: Candidate) -> None:
        if until in self._waiting:
            self._waiting[until].append(candidate)
        else:
            self._waiting[until] = [candidate]

    def _judge(self, start: int, stop: int, sums: Sums | None) -> F | None:
        """The frame of a complete candidate, None if it is invalid, inside another frame, or to be judged later."""
        frame = self._valid.pop(start, None)
        if start < self._position:
            return None
        if frame is None:
            self.judged += 1
            frame = self._frame(start - self._base, stop - self._base, sums)
        if frame is None:
            return None
        if self._first_open() < start:
            if not self._sure(start - self._base, stop - self._base):
                self._valid[start] = frame  # the sums at its ends are not kept so long
                self._wait(self._longest_end, (start, stop, ()))  # then no other is open around it
                return None
            self.rejects[self.cut] += 1
        self._pass_over(start)
        while self._faults and self._faults[0][0] < stop:
            heappop(self._faults)
        self._position = stop
        return frame

    def _first_open(self) -> int:
        """Start of the first candidate that is still incomplete; far away without one."""
        while self._open and (self._open[0][1] <= self._end or self._open[0][0] < self._position):
            self._open.popleft()
        return self._open[0][0] if self._open else 1 << 62

    def _pass_over(self, to: int) -> None:
        if to > self._position:
            self.rejects["garbage_bytes"] += to - self._position
            self._position = to
        while self._faults and self._faults[0][0] < to:
            self.rejects[heappop(self._faults)[1]] += 1

    def _reject(self, start: int, kind: str) -> None:
        """Count what is invalid at an index of the buffer, at once or when it is known to be outside of a frame."""
        if self._first_open() < start + self._base:
            heappush(self._faults, (start + self._base, kind))
        else:
            self.rejects[kind] += 1

    def _count_skipped(self, start: int, stop: int) -> None:
        """Count the impossible headers between two indices of the buffer, which hold no candidate."""
        found = self.malformed.findall(self._buffer, start, stop)
        if found and self._first_open() < start + self._base:
            for match in self.malformed.finditer(self._buffer, start, stop):
                self._reject(match.start(), self.kinds[match[0]])
        elif found:
            for sync, number in Counter(found).items():
                self.rejects[self.kinds[sync]] += number

    @abstractmethod
    def _sum(self, data: bytes) -> None:
        """Compute the running sums at each byte of `data`, which begins where `_carry` was told."""

    @abstractmethod
    def _sums(self, index: int) -> Sums:
        """The sums before a byte of the data of `_sum`."""

    @abstractmethod
    def _carry(self, index: int) -> None:
        """Keep only the sums before a byte of the data of `_sum`: the next data begin with it."""

    @abstractmethod
    def _size(self, start: int, match: re.Match[bytes]) -> int | None:
        """Length of a candidate at an index of the buffer; None: its header is incomplete, 0: counted as invalid."""

    @abstractmethod
    def _frame(self, start: int, stop: int, sums: Sums | None) -> F | None:
        """The frame between two indices of the buffer if it is valid, otherwise None, and counted.

        `sums` are those before its first byte, None if they are among the present ones.
        """

    def _sure(self, start: int, stop: int) -> bool:
        """Whether a valid frame inside an incomplete one is none by chance."""
        return True
