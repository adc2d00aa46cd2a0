"""The newest retained message of each topic."""

from collections.abc import Iterator
from typing import NamedTuple

from shared.bus.mqtt.packets import Publish

from .topics import matches


class Kept(NamedTuple):
    """A retained message, when it expires, and the client that sent it."""

    message: Publish
    deadline_s: float | None
    client_id: str


class Retained:
    """Retained messages by topic, at most `limit` of them."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._kept: dict[str, Kept] = {}

    def __len__(self) -> int:
        return len(self._kept)

    def takes(self, topic: str) -> bool:
        """Whether there is room for a message on this topic."""
        return topic in self._kept or len(self._kept) < self.limit

    def keep(self, kept: Kept) -> None:
        """Keep a message in the place of its predecessor; an empty one only clears the place."""
        if kept.message.payload:
            self._kept[kept.message.topic] = kept
        else:
            self._kept.pop(kept.message.topic, None)

    def matching(self, pattern: str, now_s: float) -> Iterator[Kept]:
        """Give the messages that a filter takes and that have not expired."""
        for topic, kept in self._kept.items():
            if matches(pattern, topic) and (kept.deadline_s is None or kept.deadline_s > now_s):
                yield kept

    def sweep(self, now_s: float) -> None:
        """Forget what has expired."""
        expired = [t for t, kept in self._kept.items() if kept.deadline_s is not None and kept.deadline_s <= now_s]
        for topic in expired:
            del self._kept[topic]
