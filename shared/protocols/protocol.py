"""What a wire protocol is to the unit: how its frames are found, which ports read it, and why messages are rejected."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from .framing.framing import Framing


@dataclass(frozen=True)
class Reason:
    """Why something was rejected, and what to do about it."""

    meaning: str
    remedy: str


@dataclass(frozen=True)
class Question:
    """Bytes that make a device of a protocol answer, and bytes that make it go on as before."""

    ask: bytes
    then: bytes = b""


@dataclass(frozen=True)
class Protocol:
    """One row of the registry."""

    framing: Framing
    title: str  # with its maker, as in a sentence
    read_at: frozenset[str] = frozenset()  # kinds of port at which it is read: gnss, imu, corrections, can
    remedy: str = ""  # where it is not decoded: what to switch on in its place
    questions: Mapping[str, Question] = field(default_factory=dict)  # by kind of port
    reasons: Mapping[str, Reason] = field(default_factory=dict)  # of rejects, by their names

    @property
    def name(self) -> str:
        """Short name."""
        return self.framing.protocol
