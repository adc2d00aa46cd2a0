"""The routes of the page Map: the track, its files for download, and the tiles of the map that is installed."""

import gzip
import re
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from typing import Annotated, Any, Literal

from fastapi import FastAPI, Query, Request, Response
from pydantic_core import to_json
from typing_extensions import TypedDict

from shared.page.answers import Stamp, answer, file_of
from shared.page.map.installed import InstalledMap
from shared.track_files import Segment, gpx_lines, kml_lines

from ..history.track import TrackColumns, columns, length_m, segments
from ..state import State

Source = Literal["fused", "gnss", "truth"]
GZIP_FROM_BYTES = 2000


@answer()
class TrackRows(TypedDict):
    """The track of this drive, thinned to a bounded number of rows."""

    generation: int
    """changes when rows were removed"""
    complete: bool
    """all rows, not only those after `after_ns`"""
    spacing_m: float
    """distance between rows"""
    length_m: float
    """distance driven, without the spans in which there was no position"""
    started_ns: Stamp | None
    now_ns: Stamp
    columns: TrackColumns


class MapApi:
    """What the page Map asks for."""

    def __init__(
        self, state: State, lock: AbstractContextManager[object], now_ns: Callable[[], int], map_file: str | None
    ) -> None:
        self._state, self._lock, self._now_ns = state, lock, now_ns
        self._installed = InstalledMap(map_file)

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        app.add_api_route(
            "/api/track", self.track, response_model=TrackRows, tags=["position"],
            response_description="Columns of the track",
        )  # fmt: skip
        files: dict[str, tuple[Callable[..., Response], dict[str, Any]]] = {
            "/api/track.gpx": (self.gpx, file_of("application/gpx+xml", "GPX 1.1")),
            "/api/track.kml": (self.kml, file_of("application/vnd.google-earth.kml+xml", "Timed KML")),
        }
        for path, (make, shown) in files.items():
            app.add_api_route(path, make, response_class=Response, tags=["position"], responses={200: shown})
        self._installed.add_to(app)

    def track(
        self,
        request: Request,
        after_ns: Annotated[int, Query(ge=0, lt=2**63, description="only rows later than this")] = 0,
        generation: Annotated[int, Query(ge=-1, description="of the answer that rows are to be added to")] = -1,
    ) -> Response:
        """The track of this drive as columns, thinned to a bounded number of rows; null where a source was silent.

        The rows later than `after_ns` if `generation` is that of the answer before, else all rows. `aided`: GNSS was
        part of the solution within the last 3 s. `level_m`: horizontal protection level.
        """
        with self._lock:
            track = self._state.track
            complete = generation != track.generation
            rows = list(track.rows) if complete else track.after(after_ns)
            shown: TrackRows = {
                "generation": track.generation,
                "complete": complete,
                "spacing_m": track.spacing_m,
                "length_m": round(length_m(track.rows), 1),
                "started_ns": track.rows[0].time_ns if track.rows else None,
                "now_ns": self._now_ns(),
                "columns": columns(rows),
            }
        return _packed(request, to_json(shown))

    def gpx(self, source: Source = "fused") -> Response:
        """The track of this drive as GPX 1.1, one segment for each unbroken part."""
        return self._download(gpx_lines, source, "application/gpx+xml", "gpx")

    def kml(self, source: Source = "fused") -> Response:
        """The track of this drive as KML with a time for each point."""
        return self._download(kml_lines, source, "application/vnd.google-earth.kml+xml", "kml")

    def _download(
        self,
        lines: Callable[[str, Iterable[Segment], float | None], Iterable[str]],
        source: Source,
        media_type: str,
        suffix: str,
    ) -> Response:
        with self._lock:
            rows, vehicle = list(self._state.track.rows), self._state.vehicle
            correction_m = self._state.geoid_correction_m
        text = "".join(lines(f"{vehicle}, {source}", segments(rows, source), correction_m))
        name = f"{re.sub(r'[^A-Za-z0-9_-]+', '-', vehicle)[:40]}-{source}.{suffix}"
        headers = {"Cache-Control": "no-store", "Content-Disposition": f'attachment; filename="{name}"'}
        return Response(text, 200, headers, media_type)


def _packed(request: Request, data: bytes) -> Response:
    headers = {"Cache-Control": "no-store", "Vary": "Accept-Encoding"}
    if len(data) >= GZIP_FROM_BYTES and "gzip" in request.headers.get("accept-encoding", ""):
        return Response(gzip.compress(data, 1), 200, {**headers, "Content-Encoding": "gzip"}, "application/json")
    return Response(data, 200, headers, "application/json")
