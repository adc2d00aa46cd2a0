"""Writes corrections to the receiver without letting a slow port delay what the receiver sends."""

import time
from collections import deque

from shared.bus.bus import Bus
from shared.devices.driver import Link
from shared.messages.corrections import GnssCorrection

MAX_BYTES = 16_384  # waiting: at 115,200 baud 1.4 s of the port, and several seconds of corrections
PORTION_BYTES = 1024  # in one turn: at 115,200 baud 0.09 s, less than the buffer of a serial port
PAUSE_S = 1.0  # after the port did not accept bytes, which takes 0.1 s of reading each time


class CorrectionWriter:
    """A bounded queue of corrections; `bus.rejects` counts as `correction_lost` the messages that found no room.

    When the port does not accept bytes, what waits is dropped: a correction of some seconds ago is of no use, and the
    frames that follow must not begin in the middle of another.
    """

    def __init__(self) -> None:
        self._waiting: deque[bytes] = deque()
        self._bytes = 0
        self._resume_s = 0.0

    def take(self, bus: Bus, message: GnssCorrection) -> None:
        """Append whole frames; the oldest messages make room for them."""
        self._waiting.append(message.data)
        self._bytes += len(message.data)
        while self._bytes > MAX_BYTES:
            self._bytes -= len(self._waiting.popleft())
            bus.rejects["correction_lost"] += 1

    def write(self, bus: Bus, link: Link) -> None:
        """Write one portion, if there is something and the port accepts bytes."""
        if not self._waiting or time.monotonic() < self._resume_s:
            return
        first = self._waiting[0]
        portion, rest = first[:PORTION_BYTES], first[PORTION_BYTES:]
        if not link.write(bus, portion):
            bus.rejects["correction_lost"] += len(self._waiting)
            self._waiting.clear()
            self._bytes, self._resume_s = 0, time.monotonic() + PAUSE_S
            return
        self._bytes -= len(portion)
        if rest:
            self._waiting[0] = rest
        else:
            self._waiting.popleft()
