"""HTTP routes that read the state, and the headers of every response."""

import asyncio
import logging
import pathlib
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import AbstractContextManager, asynccontextmanager
from threading import Lock
from typing import Annotated, Any, Literal, Protocol, TypeVar

import uvicorn
from fastapi import FastAPI, HTTPException, Path, Query, Request, Response
from fastapi.responses import StreamingResponse
from prometheus_client import CollectorRegistry

from shared.bus.contract import asyncapi
from shared.library.library import Library
from shared.messages.operation import ModeCommand
from shared.messages.replay import ReplayControl
from shared.messages.settings import SettingsCommand
from shared.messages.simulation import SimulationAttack
from shared.page.access.limits import quiet_accept
from shared.page.answers import NOT_KEPT, Refusal, Responses, described, reference_to, refusals, schemas
from shared.page.body import json_response
from shared.page.page_error import PageError
from shared.page.pages import Pages
from shared.page.told import tell_browsers
from shared.topics import BY_NAME

from ..history.columns import FIELDS, HistoryColumns
from ..state import State
from ..views import position, prometheus, reports
from ..views.models.dashboard import DashboardState
from ..views.models.position import Feature, Solution
from ..views.models.trust import HypothesesReport, TrustReport
from ..views.models.unit import Health, Liveness, Outages, Topic, Viewers
from . import page_errors
from .access import login
from .access.access import Access, Rules
from .access.guard import STYLE, Guard
from .access.login import LoginApi, LoginRequest
from .access.manage import AddToken, RevokeToken, TokensApi
from .access.tokens import Tokens
from .command import CommandApi
from .draft import DraftApi
from .looking import look_at
from .made_file import MadeFiles
from .map import MapApi
from .page_errors import PageErrorsApi
from .recordings import Command, Job, RecordingsApi
from .replay import ReplayApi
from .series import SeriesApi
from .set_up import SetUpApi, SetUpCommand
from .settings import SettingsApi
from .simulation import SimulationApi
from .stream.events import Events
from .stream.websocket import Stream
from .support import SupportApi

log = logging.getLogger(__name__)

API_VERSION = "1.0"
DESCRIPTION = (
    "State of the on-board unit, for programs. Stamps are nanoseconds on the unit's time line, which is UTC; what is "
    "not known is null. The messages themselves are described in /asyncapi.json."
)
TAGS = {
    "login": "Who may look and act; see the table of roles in access.md",
    "position": "Where the vehicle is, and how well that is known",
    "integrity": "Whether the position can be used, and why",
    "unit": "Processes, topics, outages",
    "streams": "Connections that stay open",
    "simulation": "Attacks on a simulated vehicle",
    "command": "Commands of the operator",
    "settings": "Settings of the unit: see, check, change, take back",
    "replay": "Controls of a replay",
    "recordings": "Recorded drives: list, download, keep, delete, replay, solve",
}
GEOJSON = "application/geo+json"
LIMITED_LOGS = (login.__name__, page_errors.__name__)  # of what visitors cause
BODIES = (
    SimulationAttack, ReplayControl, Command, ModeCommand, SettingsCommand, SetUpCommand, LoginRequest, AddToken,
    RevokeToken, PageError,
)  # fmt: skip
T = TypeVar("T")


class Routes(Protocol):
    """A group of routes in a file of its own."""

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""


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
        unknown = refusals({404: "There is no such name"})
        lost: Responses = {503: described(Health, "The broker is lost")}
        dead: Responses = {503: described(Liveness, "The broker is lost")}
        feature: Responses = {200: {"content": {GEOJSON: {"schema": reference_to(Feature)}}}}
        app.add_api_route("/api/solution", self.solution, response_model=Solution, tags=["position"],
                          response_description="The newest solution", responses=feature)  # fmt: skip
        about = "What may be wrong, and the positions that follow"
        for path, answer, tag, description, responses in (
            ("/api/history", self.history, "position", "Columns of values", unknown),
            ("/api/trust", self.trust, "integrity", "The verdict and its monitors", None),
            ("/api/hypotheses", self.hypotheses, "integrity", about, None),
            ("/api/health", self.health, "unit", "State of the unit", lost),
            ("/api/alive", self.alive, "unit", "It works", dead),
            ("/api/outages", self.outages, "unit", "Outages by root cause", None),
            ("/api/state", self.state, "unit", "DashboardState at once", None),
            ("/api/topics/{name:path}", self.topic, "unit", "One topic", unknown),
        ):
            app.add_api_route(path, answer, tags=[tag], response_description=description, responses=responses)
        text = {"text/plain": {"schema": {"type": "string"}, "example": 'obu_process_up{process="core.fusion"} 1.0\n'}}
        app.add_api_route("/metrics", self.metrics, response_class=Response, tags=["unit"],
                          responses={200: {"description": "Metrics for Prometheus", "content": text}})  # fmt: skip

    def solution(
        self,
        request: Request,
        form: Annotated[Literal["json", "geojson"] | None, Query(alias="format")] = None,
    ) -> Solution | Response:
        """The newest position with uncertainty, protection levels and verdict: JSON, or GeoJSON if asked for.

        `format` decides, or else the header `Accept: application/geo+json`. Look at `verdict_known` and `live`: an old
        solution stays here with its age.
        """
        if form == "geojson" or (form is None and GEOJSON in request.headers.get("accept", "")):
            return json_response(self._ask(position.feature), 200, GEOJSON)
        return self._ask(position.solution)

    def state(self) -> DashboardState:
        """Everything at once: banner, solution, processes, and the newest message of every topic."""
        look_at(self._state, self._lock, self._now_ns, tuple(BY_NAME))
        return self._ask(reports.snapshot)

    def health(self, response: Response) -> Health:
        """Every topic and process against its deadline; 503 only if the broker is lost."""
        report = self._ask(reports.health)
        response.status_code = 503 if report["state"] == "failed" else 200
        return report

    def alive(self, response: Response) -> Liveness:
        """Whether this process responds and the broker is connected; 503 if it is not. It needs no login."""
        alive = self._ask(reports.health)["state"] != "failed"
        response.status_code = 200 if alive else 503
        return {"alive": alive}

    def topic(self, name: Annotated[str, Path(max_length=80)]) -> Topic:
        """Newest message of one topic with its rate, jitter, size and age; a fast one is followed for 5 s from now."""
        flow = self._state.topics.get(name)
        if flow is None:
            raise HTTPException(404, f"there is no topic {name}; /api/state lists them")
        look_at(self._state, self._lock, self._now_ns, (name,))
        return self._ask(lambda _, now_ns: reports.topic(flow, now_ns))

    def history(
        self,
        seconds: Annotated[float, Query(gt=0, le=86_400)] = 60.0,
        fields: Annotated[str, Query(max_length=400)] = ",".join(FIELDS),
    ) -> HistoryColumns:
        """The last seconds as columns: 5 Hz up to a minute, 1 Hz beyond, as far back as `history_s`."""
        wanted = tuple(dict.fromkeys(name for name in fields.split(",") if name))
        if unknown := [name for name in wanted if name not in FIELDS]:
            raise HTTPException(404, f"there is no field {unknown[0]}; there are {', '.join(FIELDS)}")
        span_s = min(seconds, self._history_s)
        return self._ask(lambda state, now_ns: state.history.columns(now_ns, span_s, wanted))

    def trust(self, seconds: Annotated[float, Query(gt=0, le=86_400)] = 900.0) -> TrustReport:
        """The verdict with its reasons and every monitor; their history at 1 Hz, as far back as `history_s`."""
        span_s = min(seconds, self._history_s)
        return self._ask(lambda state, now_ns: reports.trust(state, now_ns, span_s))

    def hypotheses(self) -> HypothesesReport:
        """What may be wrong: probabilities, and the position under each hypothesis over the last two minutes."""
        return self._ask(reports.hypotheses)

    def outages(self) -> Outages:
        """What is lost now, and what was lost and for how long."""
        return self._ask(lambda state, _: reports.outages(state))

    def metrics(self) -> Response:
        """The state for Prometheus."""
        return Response(prometheus.text(self._registry), media_type="text/plain; version=0.0.4; charset=utf-8")

    def _ask(self, view: Callable[[State, int], T]) -> T:
        with self._lock:
            return view(self._state, self._now_ns())


class DocumentedApp(FastAPI):
    """An app whose description has the schemas of bodies, which are read here and not by FastAPI."""

    def openapi(self) -> dict[str, Any]:
        """Describe the routes, with the schemas that they refer to."""
        if self.openapi_schema is None:
            found = super().openapi()
            found.setdefault("components", {})["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
            found["security"] = [{}, {"token": []}]  # a simulated unit needs none from its own machine
            found["components"].setdefault("schemas", {}).update(schemas(Feature, Refusal, *BODIES))
        return super().openapi()


class ClientStreams:
    """The streams to clients that stay connected: `/ws` and `/api/events`."""

    def __init__(self, stream: Stream, events: Events) -> None:
        self.stream, self.events = stream, events

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        example = 'event: solution\ndata: {"state": "safe", "latitude_deg": 48.135124}\n\n'
        content = {"text/event-stream": {"schema": {"type": "string"}, "example": example}}
        answers: Responses = {
            200: {"description": "verdict, solution, outage; comments as heartbeats", "content": content},
            **refusals({503: "Too many readers"}),
        }
        app.add_api_route(
            "/api/events", self.read, response_class=StreamingResponse, tags=["streams"], responses=answers
        )
        limit = "Clients and their limit"
        app.add_api_route("/api/viewers", self.viewers, tags=["streams"], response_description=limit)
        app.add_api_websocket_route("/ws", self.stream.serve)

    async def read(self) -> StreamingResponse:
        """Server-sent events: the verdict when it changes, the solution once a second, outages."""
        return self.events.stream()

    def viewers(self) -> Viewers:
        """How many clients are connected, and how many may be."""
        connected, events = len(self.stream.clients), len(self.events.clients)
        return {"connected": connected, "events": events, "maximum": self.stream.clients.maximum}


def make_app(
    api: Api,
    further: Iterable[Routes],
    pages: Pages,
    watching: ClientStreams,
    access: Access,
) -> FastAPI:
    """Put the routes together."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        asyncio.get_running_loop().set_exception_handler(quiet_accept)
        tasks = [asyncio.create_task(part.run()) for part in (watching.stream, watching.events)]
        for task in tasks:
            task.add_done_callback(lambda done: _end_with(done, app.state.server))
        yield
        for task in tasks:
            task.cancel()

    app = DocumentedApp(
        title="On-board unit",
        description=DESCRIPTION,
        version=API_VERSION,
        openapi_tags=[{"name": name, "description": text} for name, text in TAGS.items()],
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan,
        dependencies=NOT_KEPT,
    )
    watching.stream.version = pages.version
    api.add_to(app)
    for routes in further:
        routes.add_to(app)
    watching.add_to(app)
    LoginApi(access).add_to(app)
    TokensApi(access.tokens).add_to(app)
    app.add_api_route("/asyncapi.json", lambda: json_response(asyncapi(), 200), include_in_schema=False)
    app.include_router(pages.router())
    tell_browsers(app, STYLE)
    app.add_middleware(Guard, access=access)
    return app


def openapi() -> dict[str, Any]:
    """Describe the API without a unit, as it is printed in docs/reference."""
    return app_without_unit().openapi()


def app_without_unit() -> FastAPI:
    """Make the application with all its routes, for its description."""
    state, lock = State("", (), 0, 900.0), Lock()

    def now_ns() -> int:
        return 0

    api = Api(state, lock, now_ns, CollectorRegistry(), 900.0)
    replay = ReplayApi(None, lock, now_ns)
    watching = ClientStreams(Stream(state, lock, now_ns, 1, replay), Events(state, lock, now_ns, 1))
    recordings = RecordingsApi(Library(pathlib.Path()), Job(pathlib.Path()), frozenset(), lambda: None)
    simulation, maps = SimulationApi(state, lock, now_ns), MapApi(state, lock, now_ns, None)
    commands = CommandApi(state, lock, now_ns)
    series = SeriesApi(state, lock, now_ns, 1)
    unit_settings = SettingsApi(state, lock, now_ns)
    files = MadeFiles(pathlib.Path())
    set_up = SetUpApi(state, lock, now_ns, pathlib.Path(), Library(pathlib.Path()), lambda: None, files)
    support = SupportApi(files, Tokens(pathlib.Path()))
    more = (set_up, maps, PageErrorsApi(), support, DraftApi())
    apis = (series, simulation, replay, recordings, commands, unit_settings, *more)
    return make_app(api, apis, Pages({}, {}), watching, Access(Rules(), Tokens(pathlib.Path())))


def _end_with(task: asyncio.Task[None], server: uvicorn.Server) -> None:
    """End the server if a task fails, so that the process is restarted instead of showing old data."""
    if not task.cancelled():
        log.error("the stream to the pages has failed", exc_info=task.exception())
        server.should_exit = True
