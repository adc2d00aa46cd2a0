"""One vehicle that is watched: the state that the unit's page shows, fed with what the unit passes on."""

import json
import logging
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager

from fastapi import FastAPI, Response
from nats.aio.msg import Msg
from prometheus_client import CollectorRegistry

from services.monitoring.status.judgement import BROKER_SILENT_NS
from services.monitoring.status.state import State
from services.monitoring.status.views.snapshot import Json
from services.monitoring.status.web.body import json_response
from services.monitoring.status.web.map.map import MapApi
from services.monitoring.status.web.pages import Pages
from services.monitoring.status.web.replay import ReplayApi
from services.monitoring.status.web.routes import Api, Watching
from services.monitoring.status.web.series import SeriesApi
from services.monitoring.status.web.stream.events import Events
from services.monitoring.status.web.stream.websocket import Stream
from services.monitoring.status.web.told import tell_browsers
from shared.bus import codec
from shared.bus.envelope import Envelope
from shared.errors import BadPayload
from shared.faults import Faults
from shared.fleet.batch import VERDICTS
from shared.fleet.topics import WATCHABLE
from shared.topics import BY_NAME

from ..access.guard import STYLE
from ..database import Row
from .time_line import TimeLine

log = logging.getLogger(__name__)

HISTORY_S = 900.0
PAGES_OF_ONE = 20  # browsers that watch the same vehicle
SILENT_NS = BROKER_SILENT_NS  # what is silence of the broker on the unit's own page is that of the vehicle here
MOST_A_SECOND = 400  # messages; 17 topics at 5 Hz, and every monitor by itself, are some 200
ALLOWED = frozenset(WATCHABLE)
NO_ANSWER = (
    "The vehicle sends nothing: it is offline, or its tracking mode does not allow to be watched. The page Vehicle "
    "shows what it has reported."
)


class Watched:
    """The state of one vehicle, and the application that shows it."""

    def __init__(self, vehicle: str, last: Row | None, pages: Pages, map_file: str | None) -> None:
        """`last` is the row of `vehicle_now`, if there is one."""
        self.vehicle, self.begun_s = vehicle, time.monotonic()
        self.rejects: Counter[str] = Counter()
        self._last = last
        self._line, self._lock = TimeLine(), threading.Lock()
        self._heard_ns: int | None = None  # newest message, on the time line of the unit
        self._second, self._taken = 0, 0
        self._faults = Faults(self.rejects)
        self.state = State(vehicle, (), self.now_ns(), HISTORY_S)
        self.stream = WatchStream(self.state, self._lock, self.now_ns, ReplayApi(None, self._lock, self.now_ns))
        self.stream.shown, self.stream.version = self.shown, pages.version
        self.events = Events(self.state, self._lock, self.now_ns, PAGES_OF_ONE)
        self.app = self._make_app(pages, map_file)

    def now_ns(self) -> int:
        """Read the unit's time line."""
        return time.time_ns() + self._line.offset_ns

    def tick(self) -> None:
        """Let time pass; raises `TooManyFaults`."""
        with self._lock, self._faults.handling(self.now_ns()):
            self.state.tick(self.now_ns(), broker=True)

    def take(self, message: Msg) -> None:
        """Take a message that the unit passes on; raises `TooManyFaults`."""
        name = message.subject.split(".live.", 1)[-1].replace(".", "/")
        if name not in ALLOWED or not self._has_room():
            self.rejects["topic" if name not in ALLOWED else "rate"] += 1
            return
        topic = BY_NAME.get(name)
        stamp_ns = codec.stamp_ns(topic, message.data) if topic is not None else None
        with self._lock, self._faults.handling(self.now_ns()):
            newest = stamp_ns is not None and topic is not None and not topic.retain  # what is kept may be of long ago
            if newest and self._line.take(name, stamp_ns or 0, time.time_ns()):
                self.state.clear(self.now_ns())
            try:
                self.state.receive(Envelope.of(name, message.data, self.now_ns()))
                self._heard_ns = self.now_ns()
            except BadPayload:
                self.rejects["payload"] += 1

    def shown(self) -> Json:
        """What the page says of the watch; stamps on the unit's time line, `last` on the centre's."""
        last = None
        if self._last is not None:
            last = {"utc_ms": self._last["utc_ms"], "verdict": VERDICTS[self._last["verdict"]].value}
        silent = self._heard_ns is None or self.now_ns() - self._heard_ns >= SILENT_NS
        return {"heard_ns": self._heard_ns, "silent": silent, "last": last, "pages": self.watchers}

    @property
    def watchers(self) -> int:
        """Open pages, and programs that read the stream of events."""
        return len(self.stream.clients) + len(self.events.clients)

    def _has_room(self) -> bool:
        second = int(time.monotonic())
        if second != self._second:
            self._second, self._taken = second, 0
        self._taken += 1
        return self._taken <= MOST_A_SECOND

    def _make_app(self, pages: Pages, map_file: str | None) -> FastAPI:
        """The unit's application without what only the unit can do: no commands, recordings, tokens."""
        app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
        state, lock, now_ns = self.state, self._lock, self.now_ns
        Api(state, lock, now_ns, CollectorRegistry(), HISTORY_S).add_to(app)
        SeriesApi(state, lock, now_ns, PAGES_OF_ONE).add_to(app)
        MapApi(state, lock, now_ns, map_file).add_to(app)
        Watching(self.stream, self.events).add_to(app)
        app.add_api_route("/api/session", _no_session)
        app.include_router(pages.router())
        tell_browsers(app, STYLE)
        return app


class WatchStream(Stream):
    """The stream of the unit's page, with what is to be said of the watch."""

    shown: Callable[[], Json]

    def __init__(
        self, state: State, lock: AbstractContextManager[object], now_ns: Callable[[], int], replay: ReplayApi
    ) -> None:
        super().__init__(state, lock, now_ns, PAGES_OF_ONE, replay)

    def _view(self) -> Json:
        view, watch = super()._view(), self.shown()
        if watch["silent"]:
            sentence = {"state": "disconnected", "word": "NO CONNECTION", "sentence": NO_ANSWER, "action": None}
            view["banner"] = {**_object(view["banner"]), **sentence, "since_ns": watch["heard_ns"]}
        return {**view, "watch": watch, "simulation": None}  # attacks are started at the unit alone


def watch_request(watchers: int, for_s: int) -> bytes:
    """What the centre publishes on `uplink/watch`."""
    return json.dumps({"topics": WATCHABLE, "for_s": for_s, "watchers": watchers}).encode()


def _no_session() -> Response:
    """The login is that of the centre: nothing can be changed from here."""
    return json_response({"name": None, "role": "view", "session": False, "csrf": None})


def _object(value: object) -> Json:
    return value if isinstance(value, dict) else {}
