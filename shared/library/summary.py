"""Summaries of recordings: their form, where they are kept, and who computes them."""

import subprocess
import sys
from pathlib import Path

from pydantic import Field

from ..bounded import read_bytes
from ..messages.base import Count, Latitude, Longitude, Message, Name, Nanoseconds
from ..messages.operation import Outage
from ..messages.replay import TrustChange

RECORDING_SUFFIX, KEEP_SUFFIX, SUFFIX = ".mcap", ".keep", ".summary.json"
VERSION = 1  # of what is computed: another one is computed anew
SUMMARY_BYTES = 20_000_000
MAX_LENGTH = 500  # changes and outages that are kept
NICE = 15  # beside the processes of a vehicle, which come first

Point = tuple[Latitude, Longitude]


class RecordingSummary(Message):
    """A recording at a glance."""

    version: Count = VERSION
    size_bytes: int
    vehicle: str = ""
    origin: Name | None = None  # live, simulated or replay
    begin_ns: Nanoseconds
    end_ns: Nanoseconds
    distance_m: float | None = None  # None without a position
    track: tuple[Point, ...] = ()  # evenly spaced along the way
    trust: tuple[TrustChange, ...] = Field(default=(), max_length=MAX_LENGTH)
    outages: tuple[Outage, ...] = Field(default=(), max_length=MAX_LENGTH)
    solved: bool = False  # it holds solutions, and not only measurements


def read_summary(path: Path, size_bytes: int) -> RecordingSummary | None:
    """Read a summary that was computed before; None if there is none, or it is of another state of the recording."""
    try:
        summary = RecordingSummary.model_validate_json(read_bytes(path, SUMMARY_BYTES))
    except (OSError, ValueError):
        return None
    return summary if (summary.version, summary.size_bytes) == (VERSION, size_bytes) else None


class SummaryWorker:
    """Computes the summary of one recording in a process of low priority (`nice`), and keeps it in a folder.

    A summary that lies beside the recording is taken instead.
    """

    def __init__(self, recording: Path, folder: Path, *, nice: int = NICE) -> None:
        self._size = recording.stat().st_size
        beside = recording.with_name(recording.name + SUFFIX)
        self._output = beside if read_summary(beside, self._size) else folder / beside.name
        self._child: subprocess.Popen[bytes] | None = None
        if read_summary(self._output, self._size) is None:
            command = [sys.executable, "-m", "shared.recording.summary", str(recording), str(self._output), str(nice)]
            self._child = subprocess.Popen(command, stdin=subprocess.DEVNULL)

    @property
    def running(self) -> bool:
        """Whether the summary is still being computed."""
        return self._child is not None and self._child.poll() is None

    def result(self) -> RecordingSummary | None:
        """Give the summary; None while it is being computed, or if it cannot be."""
        return None if self.running else read_summary(self._output, self._size)

    def wait(self, timeout_s: float) -> None:
        """Wait for the end of the computation."""
        if self._child is not None:
            self._child.wait(timeout_s)

    def stop(self) -> None:
        """End the computation."""
        if self._child is not None and self.running:
            self._child.terminate()
            self._child.wait()
