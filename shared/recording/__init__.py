"""Recordings of the bus: MCAP files that any MCAP tool opens, and a reader that also reads truncated ones."""

from .reader import Recording as Recording
from .writer import RecordingWriter as RecordingWriter
