"""The HTTP door: routes that read the state, and what every answer carries."""

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, MutableMapping
from contextlib import AbstractContextManager, asynccontextmanager
from typing import Annotated, Any

import uvicorn
from fastapi import FastAPI, HTTPException, Path, Query, Response
from prometheus_client import CollectorRegistry
from pydantic_core import to_json

from shared.bus.contract import asyncapi

from ..history import FIELDS
from ..state import State
from ..views import prometheus, reports
from . import assets, hosts
from .pages import Pages
from .replay import ReplayApi
from .simulation import SimulationApi
from .websocket import Stream

log = logging.getLogger(__name__)

Scope = MutableMapping[str, Any]
Send = Callable[[Scope], Any]


class Api:
    """The questions that a program may ask; each is answered with JSON."""

    def __init__(
        self,
        state: State,
        lock: AbstractContextManager[object],
        now_ns: Callable[[], int],
        registry: CollectorRegistry,
        history_s: float,
    ) -> None:
        self._state, self._lock, self._now_ns, self._registry = state, lock, now_ns, registry
        self._history_s = history_s

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        app.add_api_route("/api/state", self.state, response_class=Response)
        app.add_api_route("/api/health", self.health, response_class=Response)
        app.add_api_route("/api/topics/{name:path}", self.topic, response_class=Response)
        app.add_api_route("/api/history", self.history, response_class=Response)
        app.add_api_route("/api/trust", self.trust, response_class=Response)
        app.add_api_route("/api/outages", self.outages, response_class=Response)
        app.add_api_route("/metrics", self.metrics, response_class=Response)

    def state(self) -> Response:
        """Everything at once: banner, solution, processes, and the newest message of every topic."""
        return self._answer(lambda now_ns: reports.snapshot(self._state, now_ns))

    def health(self) -> Response:
        """Every topic and process against its deadline; 503 only if the broker is lost."""
        with self._lock:
            report = reports.health(self._state, self._now_ns())
        return _json(report, 503 if report["state"] == "failed" else 200)

    def topic(self, name: Annotated[str, Path(max_length=80)]) -> Response:
        """Newest message of one topic with its rate, jitter, size and age."""
        flow = self._state.topics.get(name)
        if flow is None:
            raise HTTPException(404, f"there is no topic {name}; /api/state lists them")
        return self._answer(lambda now_ns: reports.topic(flow, now_ns))

    def history(
        self,
        seconds: Annotated[float, Query(gt=0, le=86_400)] = 60.0,
        fields: Annotated[str, Query(max_length=400)] = ",".join(FIELDS),
    ) -> Response:
        """The last seconds as columns: 5 Hz up to a minute, 1 Hz beyond, as far back as `history_s`."""
        wanted = tuple(dict.fromkeys(name for name in fields.split(",") if name))
        if unknown := [name for name in wanted if name not in FIELDS]:
            raise HTTPException(404, f"there is no field {unknown[0]}; there are {', '.join(FIELDS)}")
        span_s = min(seconds, self._history_s)
        return self._answer(lambda now_ns: self._state.history.columns(now_ns, span_s, wanted))

    def trust(self, seconds: Annotated[float, Query(gt=0, le=86_400)] = 900.0) -> Response:
        """The verdict with its reasons and every monitor; their history at 1 Hz, as far back as `history_s`."""
        span_s = min(seconds, self._history_s)
        return self._answer(lambda now_ns: reports.trust(self._state, now_ns, span_s))

    def outages(self) -> Response:
        """What is lost now, and what was lost and for how long."""
        return self._answer(lambda _: reports.outages(self._state))

    def metrics(self) -> Response:
        """The state for Prometheus."""
        return Response(prometheus.text(self._registry), media_type="text/plain; version=0.0.4; charset=utf-8")

    def _answer(self, ask: Callable[[int], object]) -> Response:
        with self._lock:
            answer = ask(self._now_ns())
        return _json(answer, 200)


class Guard:
    """Refuses strangers' host names, and gives every answer the headers that keep a browser safe."""

    def __init__(self, app: Callable[..., Any], allowed_hosts: tuple[str, ...]) -> None:
        self._app, self._allowed = app, allowed_hosts

    async def __call__(self, scope: Scope, receive: Callable[[], Any], send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        host = next((value.decode("latin-1") for name, value in scope["headers"] if name == b"host"), None)
        if hosts.host_allowed(host, self._allowed):
            await self._app(scope, receive, _with_headers(send))
            return
        text = "this unit does not answer to that name; add it to allowed_hosts in [monitoring.status]\n"
        await Response(text, 421)(scope, receive, _with_headers(send))


def make_app(
    api: Api,
    commands: tuple[SimulationApi, ReplayApi],
    pages: Pages,
    stream: Stream,
    allowed_hosts: tuple[str, ...],
) -> FastAPI:
    """Put the routes together."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        task = asyncio.create_task(stream.run())
        task.add_done_callback(lambda done: _end_with(done, app.state.server))
        yield
        task.cancel()

    app = FastAPI(title="On-board unit", docs_url=None, redoc_url=None, lifespan=lifespan)
    stream.version = pages.version
    api.add_to(app)
    for command in commands:
        command.add_to(app)
    app.add_api_route("/asyncapi.json", lambda: _json(asyncapi(), 200), include_in_schema=False)
    app.add_api_websocket_route("/ws", stream.serve)
    app.include_router(pages.router())
    app.add_middleware(Guard, allowed_hosts=allowed_hosts)
    return app


def make_server(app: FastAPI, connections_maximum: int) -> uvicorn.Server:
    """Make the server, which the app may end; no compression of frames, which would double its work."""
    config = uvicorn.Config(
        app,
        http="h11",
        ws="websockets-sansio",
        ws_per_message_deflate=False,
        ws_max_size=4096,
        limit_concurrency=connections_maximum,
        timeout_graceful_shutdown=1,
        server_header=False,
        access_log=False,
        log_config=None,
        log_level="warning",
    )
    server = uvicorn.Server(config)
    app.state.server = server
    return server


def _end_with(task: asyncio.Task[None], server: uvicorn.Server) -> None:
    """End the server with a task that failed: better no pages, and a new life, than pages that stand still."""
    if not task.cancelled():
        log.error("the stream to the pages has failed", exc_info=task.exception())
        server.should_exit = True


def _json(content: object, status: int) -> Response:
    return Response(to_json(content), status, {"Cache-Control": "no-store"}, "application/json")


def _with_headers(send: Send) -> Send:
    async def send_guarded(message: Scope) -> None:
        if message["type"] == "http.response.start":
            present = {name for name, _ in message["headers"]}
            extra = {"Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'", **assets.HEADERS}
            rest = [(n.lower().encode(), v.encode()) for n, v in extra.items() if n.lower().encode() not in present]
            message["headers"] = [*message["headers"], *rest]
        await send(message)

    return send_guarded
