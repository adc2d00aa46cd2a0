"""The controls of a replay over the web, and what a page shows of it."""

import asyncio
from collections.abc import Callable
from contextlib import AbstractContextManager
from queue import Full, Queue

from fastapi import FastAPI, HTTPException, Request
from pydantic import ValidationError
from typing_extensions import TypedDict

from shared.messages.replay import ReplayCommand, ReplayControl
from shared.page import body
from shared.page.answers import AcceptedRequest, Object, Stamp, answer, reference_to, refusals

from ..replay import ReplayFeed

MAX_PENDING = 32  # commands that are not yet published
POLL_PERIOD_S = 0.02  # between two looks for a jump that is complete
BODY = {"content": {"application/json": {"schema": reference_to(ReplayControl)}}, "required": True}


@answer()
class ReplayShown(TypedDict):
    """A replay."""

    name: str
    position_ns: Stamp
    begin_ns: Stamp
    end_ns: Stamp
    speed: float
    playing: bool
    epoch: int
    """counts the jumps"""
    lost: bool
    """nothing comes from sensors.replay"""
    trust: list[Object]
    """changes of the verdict"""
    outages: list[Object]


@answer()
class Replay(TypedDict):
    """Position, extent, speed and events of a replay; null where none runs."""

    replay: ReplayShown | None


class ReplayApi:
    """Checks commands and queues them for the bus; without a replay it refuses them."""

    def __init__(
        self, feed: ReplayFeed | None, lock: AbstractContextManager[object], host_ns: Callable[[], int]
    ) -> None:
        self._feed, self._lock, self._host_ns = feed, lock, host_ns
        self.commands: Queue[ReplayControl] = Queue(MAX_PENDING)
        self._connected = False

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        refused = refusals({403: "A page from elsewhere", 409: "No replay", 413: "Too long", 422: "Not a command",
                            503: "Full"})  # fmt: skip
        app.add_api_route("/api/replay", self.replay, tags=["replay"], response_description="The replay, or null")
        app.add_api_route(
            "/api/replay", self.control, methods=["POST"], status_code=202, response_description="Published",
            tags=["replay"], responses=refused, openapi_extra={"requestBody": BODY},
        )  # fmt: skip

    def refresh(self, *, connected: bool) -> None:
        """Ask for the present position when the connection to the bus begins."""
        if connected and not self._connected and not self.commands.full():
            self.commands.put_nowait(ReplayControl(command=ReplayCommand.REFRESH))
        self._connected = connected

    def replay(self) -> Replay:
        """Position, extent, speed and events of the replay; null if this is none."""
        with self._lock:
            return {"replay": self.view()}

    async def control(self, request: Request) -> AcceptedRequest:
        """Play, pause, seek, or set the speed; 202, and the position follows in the state."""
        if self._feed is None:
            raise HTTPException(409, "this unit shows no recording; run obu replay FILE")
        try:
            command = ReplayControl.model_validate_json(await body.read(request))
        except ValidationError as error:
            raise body.invalid(error) from error
        try:
            self.commands.put_nowait(command)
        except Full as error:
            raise HTTPException(503, "the bus does not take the commands before this one; try again") from error
        return {}

    async def pause(self, period_s: float) -> None:
        """Wait for a period, or until a jump of the replay is complete."""
        if self._feed is None:
            await asyncio.sleep(period_s)
            return
        for _ in range(round(period_s / POLL_PERIOD_S)):
            await asyncio.sleep(POLL_PERIOD_S)
            if self._feed.fresh:
                break
        self._feed.fresh = False

    def view(self) -> ReplayShown | None:
        """Show the replay; the caller holds the lock."""
        feed = self._feed
        if feed is None or feed.newest is None:
            return None
        newest = feed.newest
        return {
            "name": newest.name,
            "position_ns": feed.now_ns(self._host_ns()),
            "begin_ns": newest.begin_ns,
            "end_ns": newest.end_ns,
            "speed": newest.speed,
            "playing": newest.playing,
            "epoch": newest.epoch,
            "lost": feed.lost(self._host_ns()),
            "trust": [change.model_dump() for change in feed.events.trust],
            "outages": [outage.model_dump() for outage in feed.events.outages],
        }
