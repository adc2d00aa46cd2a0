"""What the configuration dialogues of all generations of u-blox receivers have in common."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

TIMEOUT_TICKS = 3  # seconds without a response
NO_RESPONSE = "no response from the receiver: check that its RX line is connected"
DYNAMIC_MODELS = {
    0: "portable", 2: "stationary", 3: "pedestrian", 4: "automotive", 5: "sea", 6: "airborne below 1 g",
    7: "airborne below 2 g", 8: "airborne below 4 g", 9: "wrist", 10: "bike", 11: "mower", 12: "scooter",
}  # fmt: skip


@dataclass(frozen=True)
class Result:
    """What a receiver took of a request; `fault` is None if it is all that was required.

    `note` says what was not asked for, and why.
    """

    fault: str | None
    note: str | None = None
    navigation_period_s: float | None = None
    messages: tuple[str, ...] = ()
    dynamic_model: str | None = None
    elevation_mask_rad: float | None = None


class Exchange(ABC):
    """One request to a receiver whose generation is known."""

    @abstractmethod
    def begin(self) -> Iterator[bytes | Result]:
        """Yield the first messages."""

    @abstractmethod
    def take(self, kind: str, payload: bytes) -> Iterator[bytes | Result]:
        """Process an answer."""

    @abstractmethod
    def tick(self) -> Iterator[bytes | Result]:
        """A second has passed."""
