"""The simulated broker in a thread of this process."""

import asyncio
import threading
from types import TracebackType
from typing import Self

from ..passwords import Passwords
from .access_list import Acl
from .broker import Broker
from .server import Server
from .session import Limits

MAX_WAIT_S = 5.0


class Handle:
    """A running broker; leaving its `with` block stops it."""

    def __init__(self, acl: Acl | None, limits: Limits | None, passwords: Passwords | None) -> None:
        self.host = "127.0.0.1"
        self.port = 0
        self.broker = Broker(acl, limits, passwords=passwords)
        self._ready = threading.Event()
        self._error: OSError | None = None

    def open(self, port: int) -> None:
        """Start the thread; raises OSError where the port is taken."""
        self._thread = threading.Thread(target=lambda: asyncio.run(self._main(port)), name="broker", daemon=True)
        self._thread.start()
        self._ready.wait(MAX_WAIT_S)
        if self._error is not None:
            raise self._error

    async def _main(self, port: int) -> None:
        self._loop, self._server = asyncio.get_running_loop(), Server(self.broker)
        try:
            await self._server.listen(self.host, port)
        except OSError as error:
            self._error = error
            return
        finally:
            self.port = self._server.port
            self._ready.set()
        await self._server.serve()

    def stop(self) -> None:
        """End the broker and wait for its thread; may be called again."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._server.stop)
            self._thread.join(MAX_WAIT_S)
        if self._thread.is_alive():
            raise RuntimeError(f"the broker on port {self.port} did not stop within {MAX_WAIT_S} s")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.stop()


def start(
    port: int = 0, *, acl: Acl | None = None, limits: Limits | None = None, passwords: Passwords | None = None
) -> Handle:
    """Start a broker on 127.0.0.1; with port 0 the system chooses a free one. Raises OSError where it is taken."""
    handle = Handle(acl, limits, passwords)
    handle.open(port)
    return handle
