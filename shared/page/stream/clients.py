"""Clients that stay connected: every one is sent the same frame; one that does not keep up is disconnected."""

import asyncio
import zlib
from dataclasses import dataclass, field
from functools import cached_property

QUEUE_FRAMES = 15  # three seconds at 5 Hz


@dataclass(frozen=True)
class Frame:
    """One message to all clients: encoded once, and compressed once if anybody wants it so."""

    plain: bytes

    @cached_property
    def packed(self) -> bytes:
        """The frame in zlib's format, complete in itself: no client needs a compressor of its own."""
        return zlib.compress(self.plain, 6)


@dataclass(eq=False)
class Client:
    """One client's queue of frames; None ends it."""

    packed: bool = False  # takes frames in zlib's format
    frames: asyncio.Queue[Frame | None] = field(default_factory=lambda: asyncio.Queue(QUEUE_FRAMES))

    def put(self, frame: Frame) -> bool:
        """Queue a frame; False if the client is too slow."""
        if self.frames.full():
            return False
        self.frames.put_nowait(frame)
        return True


class Clients:
    """A bounded set of clients."""

    def __init__(self, maximum: int) -> None:
        self.maximum = maximum
        self._clients: set[Client] = set()

    def __len__(self) -> int:
        return len(self._clients)

    def enter(self, *, packed: bool = False) -> Client | None:
        """Admit a client, or None if there are as many as allowed."""
        if len(self._clients) >= self.maximum:
            return None
        client = Client(packed)
        self._clients.add(client)
        return client

    def leave(self, client: Client) -> None:
        """Forget a client."""
        self._clients.discard(client)

    def broadcast(self, frame: Frame) -> None:
        """Queue one frame for everyone, and disconnect who has not read the last ones."""
        for client in [client for client in self._clients if not client.put(frame)]:
            self._end(client)

    def end(self) -> None:
        """Disconnect everyone: nothing more comes."""
        for client in list(self._clients):
            self._end(client)

    def _end(self, client: Client) -> None:
        self.leave(client)
        if client.frames.full():
            client.frames.get_nowait()  # make room for the end
        client.frames.put_nowait(None)
