"""Puts the routes of the centre's pages together."""

import asyncio
import logging
from collections.abc import AsyncIterator, Iterable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Protocol

import uvicorn
from fastapi import FastAPI, Response

from services.monitoring.status.page import DASHBOARD
from shared.page import assets
from shared.page.access.limits import quiet_accept
from shared.page.answers import NOT_KEPT
from shared.page.body import json_response
from shared.page.pages import Pages
from shared.page.told import tell_browsers

from .access.guard import STYLE, Guard
from .access.sessions import Sessions
from .database import Database

log = logging.getLogger(__name__)

PAGE = Path(__file__).parent / "page"
UNIT = "unit"  # folder under which the files of the unit's page are served


class Routes(Protocol):
    """A group of routes in a file of its own."""

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""


class Worker(Protocol):
    """What runs beside the routes, and ends the process when it fails."""

    async def run(self) -> None:
        """Work until cancelled."""


def make_app(
    database: Database,
    sessions: Sessions,
    routes: Iterable[Routes],
    workers: Iterable[Worker],
    names: tuple[str, ...] = (),
) -> FastAPI:
    """Make the application; `names` are further names by which the centre is reached."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        asyncio.get_running_loop().set_exception_handler(quiet_accept)
        tasks = [asyncio.create_task(worker.run()) for worker in workers]
        for task in tasks:
            task.add_done_callback(lambda done: _end_with(done, app.state.server))
        yield
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def alive() -> Response:
        async with database.nobody() as cursor:
            await cursor.execute("SELECT 1")
        return json_response({"alive": True})

    app = FastAPI(title="Control centre", docs_url=None, redoc_url=None, openapi_url=None, lifespan=lifespan,
                  dependencies=NOT_KEPT)  # fmt: skip
    app.add_api_route("/api/alive", alive)
    for part in routes:
        part.add_to(app)
    app.include_router(read_pages(PAGE).router())
    tell_browsers(app, STYLE)
    app.add_middleware(Guard, sessions=sessions, names=names)
    return app


def read_pages(folder: Path) -> Pages:
    """Read the files of the centre's page, those of the unit's page that it shares, and the libraries."""
    libraries = DASHBOARD / "node_modules"
    wanted: Mapping[str, Path] = {
        **assets.own_files(folder),
        **{f"{UNIT}/{name}": path for name, path in assets.own_files(DASHBOARD).items() if path.suffix != ".html"},
        **{f"lib/{name}": libraries / path for name, path in assets.LIBRARIES.items()},
    }
    files = {name: path.read_bytes() for name, path in wanted.items() if path.is_file()}
    of_map = {name: libraries / path for name, path in assets.MAP_LIBRARIES.items() if (libraries / path).is_file()}
    return Pages(files, {}, of_map)


def _end_with(task: asyncio.Task[None], server: uvicorn.Server) -> None:
    """End the process if a part of it fails, so that it is started again."""
    if not task.cancelled():
        log.error("a part of the pages has failed", exc_info=task.exception())
        server.should_exit = True
