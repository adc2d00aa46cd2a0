"""Changes that the processes of the centre tell over NATS, sent to the pages of their tenant four times a second."""

import asyncio
import json
import logging
import time
from collections import OrderedDict, defaultdict
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from fastapi import FastAPI, WebSocket
from nats.aio.client import Client as Nats
from nats.aio.msg import Msg
from pydantic_core import to_json

from shared.fleet.topics import ALARM, CHANGED
from shared.page.stream.clients import Clients, Frame
from shared.page.stream.connection import (
    TRY_AGAIN_LATER,
    read_until_closed,
    run_first_of,
    write_frames,
)

from .access.guard import VISITOR
from .access.rights import Visitor

log = logging.getLogger(__name__)

PERIOD_S = 0.25
MOST_PAGES, MOST_OF_TENANT = 200, 100  # of all tenants, and of one
MAX_CHANGES = 300  # vehicles of a frame; of more the page asks for the list
REMEMBERED = 200_000  # vehicles whose last verdict is known
Changes = dict[str, dict[str, Any]]


class LatestReport(NamedTuple):
    """The newest report of a vehicle that was heard of."""

    epoch: int
    sequence: int
    utc_ms: int
    verdict: int

    def is_after(self, other: "LatestReport") -> bool:
        """Order as that of `vehicle_now`: by number within an epoch, else by stamp; a clock may be set back."""
        if self.epoch == other.epoch:
            return self.sequence > other.sequence
        return self.utc_ms > other.utc_ms


class VerdictNotifier:
    """Notices changes of verdicts, and tells them and alarms to the pages."""

    def __init__(self, nats: Nats, clock_ms: Callable[[], int] = lambda: time.time_ns() // 1_000_000) -> None:
        self._nats = nats
        self._begun_ms = clock_ms()
        self._clients: dict[int, Clients] = {}
        self._newest: OrderedDict[str, LatestReport] = OrderedDict()
        self._changes: defaultdict[int, Changes] = defaultdict(dict)
        self._alarms: defaultdict[int, list[object]] = defaultdict(list)
        self._reports: defaultdict[int, int] = defaultdict(int)
        self._sent_s: dict[int, float] = {}  # time of the last frame
        self._connected = False

    def add_to(self, app: FastAPI) -> None:
        """Add the route."""
        app.add_api_websocket_route("/ws", self.serve)

    async def run(self) -> None:
        """Subscribe, and send what came until cancelled."""
        await self._nats.subscribe(CHANGED, cb=self._take_changed)
        await self._nats.subscribe(ALARM, cb=self._take_alarm)
        while True:
            await asyncio.sleep(PERIOD_S)
            self._tell()

    async def serve(self, socket: WebSocket) -> None:
        """Serve one page until it leaves or falls behind."""
        visitor: Visitor = socket.scope[VISITOR]
        clients = self._clients.setdefault(visitor.tenant_id, Clients(MOST_OF_TENANT))
        pages = sum(map(len, self._clients.values()))
        client = clients.enter() if pages < MOST_PAGES else None
        await socket.accept()
        if client is None:
            whose = "of this tenant" if len(clients) >= MOST_OF_TENANT else "of all tenants"
            await socket.close(TRY_AGAIN_LATER, f"too many pages {whose} are open; close one, or try again later")
            return
        try:
            client.put(self._frame(visitor.tenant_id, {}, []))
            await run_first_of(write_frames(socket, client), read_until_closed(socket))
        finally:
            clients.leave(client)

    def add_alarm(self, tenant_id: int, row: Mapping[str, Any]) -> None:
        """Tell a changed row of `alarm` to the pages of its tenant."""
        if self._watched(tenant_id) and len(self._alarms[tenant_id]) < MAX_CHANGES:
            self._alarms[tenant_id].append(dict(row))

    async def _take_changed(self, message: Msg) -> None:
        for row in _rows_of(message.data):
            match row:
                case {
                    "vehicle": str() as vehicle, "tenant_id": int() as tenant_id, "verdict": int() as verdict,
                    "epoch": int() as epoch, "sequence": int() as sequence, "utc_ms": int() as utc_ms,
                    "verdict_since_ms": int() as since_ms,
                }:  # fmt: skip
                    self._reports[tenant_id] += 1
                    changed = self._is_change(vehicle, LatestReport(epoch, sequence, utc_ms, verdict), since_ms)
                    if changed and self._watched(tenant_id):
                        self._changes[tenant_id][vehicle] = dict(row)
        while len(self._newest) > REMEMBERED:
            self._newest.popitem(last=False)

    def _is_change(self, vehicle: str, newest: LatestReport, since_ms: int) -> bool:
        """Remember a report, unless a newer one came before it; whether its verdict is another than before.

        Of the first report that is heard of a vehicle: whether its verdict began while this process was there.
        """
        before = self._newest.get(vehicle)
        if before is not None and not newest.is_after(before):
            return False
        self._newest[vehicle] = newest
        self._newest.move_to_end(vehicle)
        return since_ms >= self._begun_ms if before is None else newest.verdict != before.verdict

    async def _take_alarm(self, message: Msg) -> None:
        for row in _rows_of(message.data):
            tenant_id = row.get("tenant_id")
            if isinstance(tenant_id, int):
                self.add_alarm(tenant_id, row)

    def _watched(self, tenant_id: int) -> bool:
        return bool(self._clients.get(tenant_id))

    def _tell(self) -> None:
        link = self._nats.is_connected
        for tenant_id, clients in list(self._clients.items()):
            if not len(clients):
                del self._clients[tenant_id]
                continue
            changes, alarms = self._changes.pop(tenant_id, {}), self._alarms.pop(tenant_id, [])
            # Without changes a frame a second says that the connection and the centre's bus work.
            if changes or alarms or link != self._connected or self._beat(tenant_id):
                clients.broadcast(self._frame(tenant_id, changes, alarms))
        self._connected = link
        self._changes.clear()
        self._alarms.clear()

    def _beat(self, tenant_id: int) -> bool:
        now_s = asyncio.get_running_loop().time()
        return now_s - self._sent_s.get(tenant_id, 0.0) >= 1.0

    def _frame(self, tenant_id: int, changes: Changes, alarms: list[object]) -> Frame:
        self._sent_s[tenant_id] = asyncio.get_running_loop().time()
        many = len(changes) > MAX_CHANGES
        return Frame(to_json({
            "bus": self._nats.is_connected, "reports": self._reports.pop(tenant_id, 0), "many": many,
            "changes": [] if many else list(changes.values()), "alarms": alarms,
        }))  # fmt: skip


def _rows_of(data: bytes) -> "list[Mapping[str, Any]]":
    """Rows of a message of a process of the centre; what is no list of objects is left out."""
    try:
        content = json.loads(data)
    except ValueError:
        log.warning("a message of the centre's bus is no JSON")
        return []
    rows = content if isinstance(content, list) else [content]
    return [row for row in rows if isinstance(row, dict)]
