"""Any numeric field over the last hour: as one answer, and live for those who look at it."""

import asyncio
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Annotated

from fastapi import FastAPI, HTTPException, Path, Query, WebSocket
from pydantic_core import to_json
from typing_extensions import TypedDict

from shared.errors import BadPayload
from shared.page.answers import answer, refusals
from shared.page.stream.clients import Client, Clients, Frame
from shared.page.stream.connection import read_until_closed, run_first_of, write_frames

from ..flow import TopicFlow
from ..series import fields
from ..series.rings import FINE_CELLS, FINE_NS, SECOND_NS
from ..series.store import HOUR_NS, LabelledColumns, SeriesFull, labelled
from ..state import State
from ..views import gnss as views
from ..views.models.gnss import Receivers, Tracks
from .looking import look_at

FIELDS_ASKED = 16  # in one question; more would take megabytes
FIELDS_FOLLOWED = 96  # over one WebSocket
FIELDS_IN_FRAME = 8  # of the past
FRAME_S = 0.5  # between two frames at least: a page draws a dozen charts with each
FIELDS_LISTED = 400  # of one topic
QUESTION_LENGTH = 6000
FINE_S = FINE_CELLS * FINE_NS / SECOND_NS


@answer()
class FieldShown(TypedDict):
    """A numeric field of a topic."""

    name: str
    """as /api/series takes it"""
    path: str
    value: float | int | None
    unit: str
    axis: str


@answer({
    "topic": "gnss/fix",
    "fields": [{"name": "gnss/fix:hdop", "path": "hdop", "value": 0.8, "unit": "", "axis": ""}],
})  # fmt: skip
class Fields(TypedDict):
    """Numeric fields of the newest message of a topic."""

    topic: str
    fields: list[FieldShown]
    """name, path, value, unit and axis of each"""


class SeriesApi:
    """Answers with columns on a common time grid, and continues them over a WebSocket."""

    def __init__(
        self, state: State, lock: AbstractContextManager[object], now_ns: Callable[[], int], clients_maximum: int
    ) -> None:
        self._state, self._lock, self._now_ns = state, lock, now_ns
        self._clients = Clients(clients_maximum)

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        refused = refusals({422: "No such field, or too many", 503: "No further field can be kept"})
        unknown = refusals({404: "There is no such topic"})
        app.add_api_route(
            "/api/series", self.series, tags=["unit"], response_description="Columns of values", responses=refused
        )
        app.add_api_route(
            "/api/fields/{name:path}", self.fields, tags=["unit"], response_description="Numeric fields",
            responses=unknown,
        )  # fmt: skip
        app.add_api_route("/api/gnss", self.gnss, tags=["position"], response_description="GNSS receivers")
        app.add_api_route("/api/gnss/tracks", self.tracks, include_in_schema=False)
        app.add_api_websocket_route("/ws/series", self.serve)

    def series(
        self,
        fields: Annotated[str, Query(max_length=QUESTION_LENGTH)],
        seconds: Annotated[float, Query(gt=0, le=3600)] = 900.0,
    ) -> LabelledColumns:
        """Numeric fields of messages as columns: 5 Hz up to a minute, 1 Hz beyond, for the last hour at most.

        A field is written topic:path, such as gnss/fix:hdop, and navigation/aiding[odometer]:test_ratio where a topic
        carries several things; /api/fields/{topic} lists those of its newest message. A field that nobody has asked for
        before is kept from now on, and its past is read from the recording.
        """
        names = self._want(fields, FIELDS_ASKED)
        now_ns = self._now_ns()
        return self._answer(names, now_ns - round(seconds * SECOND_NS), now_ns, fine=seconds <= FINE_S)

    def fields(self, name: Annotated[str, Path(max_length=80)]) -> Fields:
        """Numeric fields of the newest message of a topic, with value and unit."""
        look_at(self._state, self._lock, self._now_ns, (name,))
        with self._lock:
            flow = self._state.topics.get(name)
            if flow is None:
                raise HTTPException(404, f"there is no topic {name}; /api/state lists them")
            listed = fields_of(flow)
        return {"topic": name, "fields": listed}

    def gnss(self) -> Receivers:
        """Each GNSS receiver: fix, satellites with the reason why one is not used, signals, configuration, bands."""
        with self._lock:
            return views.gnss(self._state, self._now_ns())

    def tracks(self) -> Tracks:
        """Tracks of the satellites in the sky over the last hour."""
        with self._lock:
            return views.tracks(self._state)

    async def serve(self, socket: WebSocket) -> None:
        """Send the past of the fields that are asked for in the address, then what is added, until the page leaves."""
        try:
            names = self._want(socket.query_params.get("fields", "")[:QUESTION_LENGTH])
            seconds = min(max(float(socket.query_params.get("seconds", "900")), 1.0), 3600.0)
        except (HTTPException, ValueError) as error:
            await _refuse(socket, error.detail if isinstance(error, HTTPException) else str(error))
            return
        client = self._clients.enter()
        if client is None:
            await _refuse(socket, "too many pages of charts are open; close one and load this page again")
            return
        try:
            await socket.accept()
            sending = self._send(client, names, seconds)
            await run_first_of(sending, write_frames(socket, client), read_until_closed(socket))
        finally:
            self._clients.leave(client)

    async def _send(self, client: Client, names: list[str], seconds: float) -> None:
        """Queue the past, then each period the cells that are complete; ends with a client that does not keep up."""
        fine = seconds <= FINE_S
        period_ns = FINE_NS if fine else SECOND_NS
        from_ns = self._now_ns() - round(seconds * SECOND_NS)
        kind, kept_up, fillings = "past", True, self._state.series.fillings
        while kept_up:
            if fillings != self._state.series.fillings:  # what lies before has been read from a recording
                fillings = self._state.series.fillings
                kind, from_ns = "past", self._now_ns() - round(seconds * SECOND_NS)
            to_ns = self._now_ns() - 2 * period_ns  # what comes later than that belongs to the past already
            if to_ns // period_ns >= from_ns // period_ns:
                for part in _parts(names) if kind == "past" else [names]:
                    columns = await asyncio.to_thread(self._answer, part, from_ns, to_ns, fine=fine)
                    kept_up = kept_up and client.put(Frame(to_json({"kind": kind, **columns})))
                    kind = "part"
                kind, from_ns = "more", (to_ns // period_ns + 1) * period_ns
            await asyncio.sleep(max(period_ns / SECOND_NS, FRAME_S))

    def _want(self, text: str, maximum: int = FIELDS_FOLLOWED) -> list[str]:
        names = list(dict.fromkeys(name for name in text.split(",") if name))
        if not names:
            raise HTTPException(422, "name the fields, such as fields=gnss/fix:hdop,navigation/solution:roll_rad")
        if len(names) > maximum:
            raise HTTPException(422, f"at most {maximum} fields at once")
        try:
            with self._lock:
                self._state.series.want(names, self._now_ns())
        except ValueError as error:
            raise HTTPException(422, str(error)) from error
        except SeriesFull as error:
            raise HTTPException(503, str(error)) from error
        return names

    def _answer(self, names: list[str], from_ns: int, to_ns: int, *, fine: bool) -> LabelledColumns:
        oldest_ns = to_ns - (round(FINE_S * SECOND_NS) if fine else HOUR_NS)
        with self._lock:
            series = self._state.series
            series.want(names, to_ns)  # nothing that is looked at gives way
            columns = series.columns(names, max(from_ns, oldest_ns), to_ns, fine=fine)
        return labelled(names, columns)


async def _refuse(socket: WebSocket, reason: str) -> None:
    """Say why nothing is sent, and close."""
    await socket.accept()
    await socket.send_text(to_json({"kind": "refused", "reason": reason}).decode())
    await socket.close()


def _parts(names: list[str]) -> list[list[str]]:
    return [names[start : start + FIELDS_IN_FRAME] for start in range(0, len(names), FIELDS_IN_FRAME)]


def fields_of(flow: TopicFlow) -> list[FieldShown]:
    """List the numeric fields of the newest message of a topic; none of one that cannot be read."""
    try:
        message = flow.decoded()
    except BadPayload:
        return []
    selector = fields.selector_of(message)
    head = f"{flow.name}[{selector}]" if selector else flow.name
    latency = [(fields.LATENCY, flow.latencies_s[-1])] if flow.latencies_s else []
    listed: list[FieldShown] = []
    for path, value in (*fields.numbers(message), *latency):
        try:
            field = fields.parse(f"{head}:{path}")
        except ValueError:  # a name or a selector with other characters
            continue
        listed.append({"name": field.name, "path": path, "value": value,
                       "unit": fields.unit_of(field), "axis": fields.axis_of(field)})  # fmt: skip
        if len(listed) == FIELDS_LISTED:
            break
    return listed
