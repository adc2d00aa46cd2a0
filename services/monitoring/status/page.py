"""The page of a unit as a centre shows it: from messages that the unit passes on, without what only the unit can do."""

import threading
from collections.abc import Callable
from pathlib import Path

from fastapi import FastAPI
from prometheus_client import CollectorRegistry

from shared.page.answers import NOT_KEPT
from shared.page.pages import Pages
from shared.page.told import tell_browsers

from .judgement import BROKER_SILENT_NS
from .state import State
from .web.access.login import LoginState
from .web.access.rights import Right
from .web.map import MapApi
from .web.replay import ReplayApi
from .web.routes import Api, ClientStreams
from .web.series import SeriesApi
from .web.stream.events import Events
from .web.stream.patch import Json
from .web.stream.websocket import Stream

DASHBOARD = Path(__file__).parent / "dashboard"
SILENCE_TIMEOUT_NS = (
    BROKER_SILENT_NS  # what is silence of the broker on the unit's own page is that of the vehicle here
)
HISTORY_S = 900.0


class RemotePage:
    """State, streams and application of one unit; `lock` is held by who writes the state."""

    def __init__(
        self, vehicle: str, now_ns: Callable[[], int], clients_maximum: int, adapt: Callable[[Json], Json]
    ) -> None:
        """`adapt` changes each view before it is sent."""
        self.lock, self._now_ns, self._clients = threading.Lock(), now_ns, clients_maximum
        self.state = State(vehicle, (), now_ns(), HISTORY_S)
        self.stream = _AdaptedStream(self.state, self.lock, now_ns, clients_maximum, adapt)
        self.events = Events(self.state, self.lock, now_ns, clients_maximum)

    @property
    def watchers(self) -> int:
        """Open pages, and programs that read the stream of events."""
        return len(self.stream.clients) + len(self.events.clients)

    def app(self, pages: Pages, style: str, map_file: str | None) -> FastAPI:
        """Make the application: no commands, recordings, tokens; `style` is the address of the style of refusals."""
        app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None, dependencies=NOT_KEPT)
        self.stream.version = pages.version
        Api(self.state, self.lock, self._now_ns, CollectorRegistry(), HISTORY_S).add_to(app)
        SeriesApi(self.state, self.lock, self._now_ns, self._clients).add_to(app)
        MapApi(self.state, self.lock, self._now_ns, map_file).add_to(app)
        ClientStreams(self.stream, self.events).add_to(app)
        app.add_api_route("/api/session", _no_session)
        app.include_router(pages.router())
        tell_browsers(app, style)
        return app


class _AdaptedStream(Stream):
    """The stream of the unit's page, with each view adapted."""

    def __init__(
        self,
        state: State,
        lock: threading.Lock,
        now_ns: Callable[[], int],
        clients_maximum: int,
        adapt: Callable[[Json], Json],
    ) -> None:
        super().__init__(state, lock, now_ns, clients_maximum, ReplayApi(None, lock, now_ns))
        self._adapt = adapt

    def _view(self) -> Json:
        return self._adapt(super()._view())


def _no_session() -> LoginState:
    """The login is that of the centre: nothing can be changed from here."""
    return {"name": None, "role": Right.VIEW, "session": False, "csrf": None}
