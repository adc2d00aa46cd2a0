"""Recordings of the bus: MCAP files that any MCAP tool opens, and a reader that survives a cut."""

from .reader import Recording as Recording
from .writer import RecordingWriter as RecordingWriter
