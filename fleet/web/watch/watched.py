"""One vehicle that is watched: the state that the unit's page shows, fed with what the unit passes on."""

import json
import logging
import time
from collections import Counter
from collections.abc import Mapping

from nats.aio.msg import Msg

from services.monitoring.status.page import SILENCE_TIMEOUT_NS, RemotePage
from shared.bus import codec
from shared.bus.envelope import Envelope
from shared.errors import BadPayload
from shared.faults import Faults
from shared.fleet.batch import VERDICTS
from shared.fleet.topics import WATCHABLE
from shared.page.pages import Pages
from shared.topics import BY_NAME

from ..access.guard import STYLE
from ..database import Row
from .time_line import TimeLine

log = logging.getLogger(__name__)

Json = dict[str, object]

PAGES_OF_ONE = 20  # browsers that watch the same vehicle
MAX_PER_SECOND = 400  # messages; 17 topics at 5 Hz, and every monitor by itself, are some 200
ALLOWED = frozenset(WATCHABLE)
NO_ANSWER = (
    "The vehicle sends nothing: it is offline, or its tracking mode does not allow to be watched. The page Vehicle "
    "shows what it has reported."
)


class WatchedVehicle:
    """The state of one vehicle, and the application that shows it."""

    def __init__(self, vehicle: str, last: Row | None, pages: Pages, map_file: str | None) -> None:
        """`last` is the row of `vehicle_now`, if there is one."""
        self.vehicle, self.begun_s = vehicle, time.monotonic()
        self.rejects: Counter[str] = Counter()
        self._last = last
        self._line = TimeLine()
        self._heard_ns: int | None = None  # newest message, on the time line of the unit
        self._second, self._taken = 0, 0
        self._faults = Faults(self.rejects)
        self.page = RemotePage(vehicle, self.now_ns, PAGES_OF_ONE, self._with_watch)
        self.app = self.page.app(pages, STYLE, map_file)

    def now_ns(self) -> int:
        """Read the unit's time line."""
        return time.time_ns() + self._line.offset_ns

    def tick(self) -> None:
        """Let time pass; raises `TooManyFaults`."""
        with self.page.lock, self._faults.handling(self.now_ns()):
            self.page.state.tick(self.now_ns(), broker=True)

    def take(self, message: Msg) -> None:
        """Take a message that the unit passes on; raises `TooManyFaults`."""
        name = message.subject.split(".live.", 1)[-1].replace(".", "/")
        if name not in ALLOWED or not self._has_room():
            self.rejects["topic" if name not in ALLOWED else "rate"] += 1
            return
        topic = BY_NAME.get(name)
        stamp_ns = codec.stamp_ns(topic, message.data) if topic is not None else None
        with self.page.lock, self._faults.handling(self.now_ns()):
            newest = stamp_ns is not None and topic is not None and not topic.retain  # what is kept may be of long ago
            if newest and self._line.take(name, stamp_ns or 0, time.time_ns()):
                self.page.state.clear(self.now_ns())
            try:
                self.page.state.receive(Envelope.of(name, message.data, self.now_ns()))
                self._heard_ns = self.now_ns()
            except BadPayload:
                self.rejects["payload"] += 1

    def shown(self) -> Json:
        """What the page says of the watch; stamps on the unit's time line, `last` on the centre's."""
        last = None
        if self._last is not None:
            last = {"utc_ms": self._last["utc_ms"], "verdict": VERDICTS[self._last["verdict"]].value}
        silent = self._heard_ns is None or self.now_ns() - self._heard_ns >= SILENCE_TIMEOUT_NS
        return {"heard_ns": self._heard_ns, "silent": silent, "last": last, "pages": self.page.watchers}

    def _has_room(self) -> bool:
        second = int(time.monotonic())
        if second != self._second:
            self._second, self._taken = second, 0
        self._taken += 1
        return self._taken <= MAX_PER_SECOND

    def _with_watch(self, shown: Mapping[str, object]) -> Json:
        """What the unit's page is sent, with what is to be said of the watch."""
        watch, banner = self.shown(), _object(shown["banner"])
        if watch["silent"]:
            sentence = {"state": "disconnected", "word": "NO CONNECTION", "sentence": NO_ANSWER, "action": None}
            banner |= {**sentence, "since_ns": watch["heard_ns"]}
        return {**shown, "banner": banner, "watch": watch, "simulation": None}  # attacks are started at the unit alone


def watch_request(watchers: int, for_s: int) -> bytes:
    """What the centre publishes on `uplink/watch`."""
    return json.dumps({"topics": WATCHABLE, "for_s": for_s, "watchers": watchers}).encode()


def _object(value: object) -> Json:
    return dict(value) if isinstance(value, dict) else {}
