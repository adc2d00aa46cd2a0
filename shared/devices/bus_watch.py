"""What a CAN interface or a log has given so far, in a sentence: a silent bus, a disturbed one, the end of a file."""

import time
from collections.abc import Callable

from ..messages.operation import DeviceFound

SILENCE_TIMEOUT_S = 5.0  # without a frame, as of the topic can/raw
RECENT_WINDOW_S = 5.0  # in which error frames count as now


class BusWatch:
    """Judges a bus by the arrival of its frames.

    Parameters
    ----------
    name : str
        Of the interface.
    start_s : float
        [s] Time at which it was opened, on the monotonic clock.
    clock_s : callable
        The monotonic clock.
    """

    rate_baud = None

    def __init__(self, name: str, start_s: float, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._name, self._start_s, self._clock_s = name, start_s, clock_s
        self._frame_s: float | None = None
        self._error_s: float | None = None
        self._errors = 0

    def take(self, is_error: bool, now_s: float) -> None:
        """Note a frame or an error frame."""
        if is_error:
            self._error_s = now_s
            self._errors += 1
        else:
            self._frame_s = now_s

    @property
    def found(self) -> DeviceFound:
        """Working, silent, or nothing but error frames; searching in the first seconds."""
        now_s = self._clock_s()
        if self._frame_s is not None and now_s - self._frame_s < SILENCE_TIMEOUT_S:
            return DeviceFound.WORKING
        if self._error_s is not None and now_s - self._error_s < RECENT_WINDOW_S:
            return DeviceFound.NOISE
        return DeviceFound.SEARCHING if now_s - self._start_s < SILENCE_TIMEOUT_S else DeviceFound.SILENT

    @property
    def protocols(self) -> tuple[str, ...]:
        """CAN, where a frame has come."""
        return ("CAN",) if self._frame_s is not None else ()

    def sentence(self) -> str:
        """What was found, and what to do about it."""
        match self.found:
            case DeviceFound.WORKING:
                disturbed = self._error_s is not None and self._clock_s() - self._error_s < RECENT_WINDOW_S
                more = f"; {self._errors} error frames so far: check the termination and the ground of the bus"
                return f"CAN frames{more * disturbed}"
            case DeviceFound.NOISE:
                return (
                    f"nothing but error frames on {self._name}: its bitrate is probably not that of the bus (500000 is "
                    "usual, 250000 on trucks), or H and L are exchanged"
                )
            case DeviceFound.SEARCHING:
                return "listening: no frame so far"
            case _:
                return (
                    f"no frame on {self._name} for {SILENCE_TIMEOUT_S:g} s: the bus sleeps (switch the ignition on), "
                    "its "
                    "bitrate differs, H or L is open, or a gateway lets nothing through unasked (set obd_period_s)"
                )


class LogWatch:
    """Counts the lines of a log that is replayed."""

    found = DeviceFound.WORKING
    protocols = ("candump",)
    rate_baud = None

    def __init__(self) -> None:
        self.frames = 0
        self.unusable = 0
        self.ended = False

    def count_line(self, line: str) -> None:
        """Count a line that is none of candump; blank ones are nothing."""
        if line.strip():
            self.unusable += 1

    @property
    def rejects(self) -> dict[str, int]:
        """Lines that were left out."""
        return {"line": self.unusable} if self.unusable else {}

    def sentence(self) -> str:
        """How much of the log was read."""
        left_out = f", {self.unusable} lines that are none of candump" if self.unusable else ""
        return f"a log, {'read to its end' if self.ended else 'in progress'}: {self.frames} frames{left_out}"
