"""The WebSocket: a snapshot on opening, then what changed, five times a second, one encoded frame for everyone.

`/ws` sends JSON as text; `/ws?packed=1` sends the same JSON in zlib's format as binary messages. Each frame is
compressed once for all; permessage-deflate would need a compressor with 256 kB for every client.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager

from fastapi import WebSocket
from pydantic_core import to_json

from shared.page.stream.clients import Clients, Frame
from shared.page.stream.connection import TRY_AGAIN_LATER, read_until_closed, run_first_of, write_frames

from ...state import State
from ...views import snapshot
from ...views.models.dashboard import Dashboard
from ..replay import ReplayApi, ReplayShown
from .patch import Json, difference

PERIOD_S, SLOWED_PERIOD_S = 0.2, 1.0
PLOTTED = ("latitude_deg", "longitude_deg", "speed_fused_m_s", "speed_gnss_m_s", "speed_odometer_m_s")


class PageState(Dashboard):
    """What a page is sent as `state`."""

    replay: ReplayShown | None


class Stream:
    """Compares the state with what clients were sent, and sends them the difference."""

    def __init__(
        self,
        state: State,
        lock: AbstractContextManager[object],
        now_ns: Callable[[], int],
        clients_maximum: int,
        replay: ReplayApi,
    ) -> None:
        self._replay = replay
        self._state, self._lock, self._now_ns = state, lock, now_ns
        self.clients = Clients(clients_maximum)
        self._sent: Json = {}
        self._sequence = 0
        self.version = ""

    async def run(self) -> None:
        """Send a frame each period while somebody watches."""
        while True:
            await self._replay.pause(SLOWED_PERIOD_S if self._state.is_slowed else PERIOD_S)
            if len(self.clients):
                self.clients.broadcast(self.difference())

    def difference(self) -> Frame:
        """Encode what changed since the last frame."""
        before, self._sent = self._sent, self._view()
        self._sequence += 1
        change = difference(before, self._sent)
        frame = {"kind": "difference", "sequence": self._sequence, "state": change.changed, "removed": change.removed}
        return Frame(to_json(frame))

    def snapshot(self) -> Frame:
        """Encode everything: what was sent to the others last, what never changes, and the last minute."""
        if len(self.clients) <= 1:
            self._sent = self._view()
        with self._lock:
            now_ns = self._now_ns()
            history = self._state.history.columns(now_ns, 60.0, PLOTTED)
        frame = {
            "kind": "snapshot",
            "version": self.version,
            "sequence": self._sequence,
            "contract": snapshot.contract(),
            "history": history,
            "state": self._sent,
        }
        return Frame(to_json(frame))

    async def serve(self, socket: WebSocket) -> None:
        """Serve one browser until it leaves or falls behind."""
        client = self.clients.enter(packed=socket.query_params.get("packed") == "1")
        if client is None:
            await socket.accept()
            await socket.close(TRY_AGAIN_LATER, f"too many viewers: {len(self.clients)} are connected; try again")
            return
        try:
            await socket.accept()
            client.put(self.snapshot())
            await run_first_of(write_frames(socket, client), read_until_closed(socket))
        finally:
            self.clients.leave(client)

    def _view(self) -> Json:
        with self._lock:
            shown: PageState = {**snapshot.dashboard(self._state, self._now_ns()), "replay": self._replay.view()}
        return shown
