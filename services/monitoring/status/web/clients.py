"""The browsers that watch: every one is given the same frame, and one that does not keep up is let go."""

import asyncio

QUEUE_FRAMES = 15  # three seconds at 5 Hz


class Client:
    """One browser's queue of frames; None ends it."""

    def __init__(self) -> None:
        self.frames: asyncio.Queue[bytes | None] = asyncio.Queue(QUEUE_FRAMES)

    def put(self, frame: bytes) -> bool:
        """Queue a frame; False if the browser is too slow."""
        if self.frames.full():
            return False
        self.frames.put_nowait(frame)
        return True


class Clients:
    """A bounded set of clients."""

    def __init__(self, maximum: int) -> None:
        self._maximum = maximum
        self._clients: set[Client] = set()

    def __len__(self) -> int:
        return len(self._clients)

    def enter(self) -> Client | None:
        """Admit a client, or None if the house is full."""
        if len(self._clients) >= self._maximum:
            return None
        client = Client()
        self._clients.add(client)
        return client

    def leave(self, client: Client) -> None:
        """Forget a client."""
        self._clients.discard(client)

    def broadcast(self, frame: bytes) -> None:
        """Queue one frame for everyone, and let go who has not read the last ones."""
        for client in [client for client in self._clients if not client.put(frame)]:
            self.leave(client)
            client.frames.get_nowait()  # make room for the end
            client.frames.put_nowait(None)
