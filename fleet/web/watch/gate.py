"""Begins, repeats and ends watch sessions, and leads a browser to the page of the vehicle that it watches."""

import asyncio
import logging
import time
from dataclasses import dataclass, field

import nats
from fastapi import FastAPI, HTTPException, Request
from fastapi.responses import RedirectResponse
from nats.aio.client import Client
from nats.aio.msg import Msg
from nats.aio.subscription import Subscription
from starlette.routing import Mount

from services.monitoring.status.page import DASHBOARD
from shared.errors import TooManyFaults
from shared.fleet.topics import LIVE, VEHICLE, WATCH, subject
from shared.page.access.requests import Receive, Scope, Send, headers_of, refusal_of
from shared.page.pages import read_pages
from shared.page.told import readable

from ..access.guard import STYLE, VISITOR
from ..access.rights import Visitor
from ..audit import note
from ..database import Database, Row
from .watched import WatchedVehicle, watch_request

log = logging.getLogger(__name__)

REPEAT_S, FOR_S = 10.0, 30  # the unit ends a session that is not repeated
LINGER_S = 15.0  # after the last browser has gone
TICK_S = 0.1
MOST, MOST_OF_TENANT = 16, 8  # vehicles that are watched at once
MAX_PENDING = 2000  # messages of one vehicle that wait
KNOWN = """
SELECT vehicle.vehicle, utc_ms, verdict FROM vehicle LEFT JOIN vehicle_now USING (vehicle) WHERE vehicle.vehicle = %s
"""
FULL = f"{MOST} vehicles are watched already; end one, or try again later"
SHARE = f"{MOST_OF_TENANT} vehicles of this tenant are watched already, which is its share; end one, or try again later"
FAULTY = "what the vehicle sends cannot be shown; its page Vehicle shows its reports"


@dataclass(eq=False)
class Session:
    """One vehicle that is watched, and who watches it."""

    tenant_id: int
    watched: WatchedVehicle
    subscription: Subscription | None = None
    tasks: list[asyncio.Task[None]] = field(default_factory=list)
    who: set[str] = field(default_factory=set)
    seen_s: float = field(default_factory=time.monotonic)  # when a browser was there last
    said_s: float = -1e9  # when the vehicle was told last

    @property
    def vehicle(self) -> str:
        """Name of the vehicle."""
        return self.watched.vehicle


class WatchGate:
    """Serves the unit's page of each vehicle below a path of its own."""

    def __init__(self, database: Database, client: Client, map_file: str | None) -> None:
        self._database, self._nats, self._map_file = database, client, map_file
        self._pages = read_pages(DASHBOARD)
        self._sessions: dict[str, Session] = {}
        self._opening = asyncio.Lock()

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        app.add_api_route("/vehicles/{vehicle}", _to_vehicle)
        app.add_api_route("/vehicles/{vehicle}/", _to_vehicle)
        app.add_api_route("/vehicles/{vehicle}/live", _with_slash)
        app.router.routes.append(Mount("/vehicles/{vehicle}/live", app=self))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on to the page of its vehicle; begins to watch it."""
        visitor: Visitor = scope[VISITOR]
        try:
            session = await self._session(visitor, scope["path_params"]["vehicle"])
        except HTTPException as error:
            refusal = refusal_of(error.status_code, str(error.detail), error.headers)
            await readable(refusal, scope, headers_of(scope), STYLE)(scope, receive, send)
            return
        session.seen_s = time.monotonic()
        await self._note_visitor(session, visitor)
        await session.watched.app(scope, receive, send)
        session.seen_s = time.monotonic()

    async def run(self) -> None:
        """Repeat the requests to vehicles, and end what nobody watches any more; all when cancelled."""
        try:
            while True:
                await asyncio.sleep(1.0)
                for session in list(self._sessions.values()):
                    await self._look_after(session)
        finally:
            for session in list(self._sessions.values()):
                await self._end(session)

    async def _look_after(self, session: Session) -> None:
        now_s, pages = time.monotonic(), session.watched.page.watchers
        if pages:
            session.seen_s = now_s
        if now_s - session.seen_s >= LINGER_S or any(task.done() for task in session.tasks):
            await self._end(session)
        elif now_s - session.said_s >= REPEAT_S:
            await self._tell(session, max(pages, 1))

    async def _session(self, visitor: Visitor, vehicle: str) -> Session:
        """The session of a vehicle of the visitor's tenant; raises `HTTPException`."""
        session = self._sessions.get(vehicle)
        if session is not None and session.tenant_id == visitor.tenant_id:
            return session
        async with self._opening:
            session = self._sessions.get(vehicle)
            if session is None or session.tenant_id != visitor.tenant_id:
                last = await self._last_known(visitor, vehicle)
                session = await self._open(visitor, vehicle, last)
        return session

    async def _last_known(self, visitor: Visitor, vehicle: str) -> Row | None:
        if not VEHICLE.fullmatch(vehicle):
            raise HTTPException(404, "there is no such vehicle")
        async with self._database.tenant(visitor.tenant_id) as cursor:
            row = await (await cursor.execute(KNOWN, (vehicle,))).fetchone()
        if row is None:
            raise HTTPException(404, f"there is no vehicle {vehicle} here; the page Map lists them")
        return row if row["utc_ms"] is not None else None

    async def _open(self, visitor: Visitor, vehicle: str, last: Row | None) -> Session:
        of_tenant = sum(session.tenant_id == visitor.tenant_id for session in self._sessions.values())
        if of_tenant >= MOST_OF_TENANT or len(self._sessions) >= MOST:
            raise HTTPException(503, SHARE if of_tenant >= MOST_OF_TENANT else FULL, {"Retry-After": "30"})
        watched = WatchedVehicle(vehicle, last, self._pages, self._map_file)
        session = Session(visitor.tenant_id, watched)

        async def take(message: Msg) -> None:
            try:
                watched.take(message)
            except TooManyFaults as error:
                log.error("%s is not watched any more: %s", vehicle, error)
                session.seen_s = -1e9  # ended at the next look

        name = f"{subject(vehicle, LIVE)}.>"
        session.subscription = await self._nats.subscribe(name, cb=take, pending_msgs_limit=MAX_PENDING)
        works = watched.page.stream.run(), watched.page.events.run(), _tick(watched)
        session.tasks = [asyncio.create_task(work) for work in works]
        self._sessions[vehicle] = session
        await self._tell(session, 1)
        return session

    async def _note_visitor(self, session: Session, visitor: Visitor) -> None:
        if visitor.name in session.who:
            return
        session.who.add(visitor.name)
        async with self._database.tenant(visitor.tenant_id) as cursor:
            await note(cursor, visitor.tenant_id, visitor.name, "began to watch", session.vehicle)

    async def _end(self, session: Session) -> None:
        await self._tell(session, 0)
        self._drop(session)
        detail = {"seconds": round(time.monotonic() - session.watched.begun_s), "rejected": session.watched.rejects}
        try:
            async with self._database.tenant(session.tenant_id) as cursor:
                who = ", ".join(sorted(session.who))
                await note(cursor, session.tenant_id, who, "ended to watch", session.vehicle, detail)
        except HTTPException as error:
            log.warning("the end of watching %s is not in the audit: %s", session.vehicle, error.detail)

    def _drop(self, session: Session) -> None:
        self._sessions.pop(session.vehicle, None)
        for task in session.tasks:
            task.cancel()
        for clients in (session.watched.page.stream.clients, session.watched.page.events.clients):
            clients.end()

    async def _tell(self, session: Session, watchers: int) -> None:
        """Tell the vehicle that it is watched, or not any more."""
        session.said_s = time.monotonic()
        try:
            if not watchers and session.subscription is not None:
                await session.subscription.unsubscribe()
                session.subscription = None
            await self._nats.publish(subject(session.vehicle, WATCH), watch_request(watchers, FOR_S if watchers else 0))
        except nats.errors.Error as error:
            log.warning("%s is not told that it is watched: %s", session.vehicle, error)


async def _tick(watched: WatchedVehicle) -> None:
    while True:
        await asyncio.sleep(TICK_S)
        watched.tick()


def _with_slash() -> RedirectResponse:
    return RedirectResponse("live/")


def _to_vehicle(vehicle: str, request: Request) -> RedirectResponse:
    """The page of a vehicle is one of the centre's page."""
    if not VEHICLE.fullmatch(vehicle):
        raise HTTPException(404, "there is no such vehicle")
    up = "../" * (request.url.path.count("/") - 1)
    return RedirectResponse(f"{up}#/vehicles/{vehicle}")
