"""The map file that is installed, and its routes."""

from pathlib import Path
from typing import Annotated, Literal, cast

from fastapi import FastAPI, HTTPException, Response
from fastapi import Path as PathParameter
from fastapi.responses import FileResponse
from typing_extensions import TypedDict

from ..answers import answer
from . import tiles

ZOOM_MAXIMUM = 24


@answer()
class MapFile(TypedDict):
    """The map that is installed."""

    container: Literal["pmtiles", "mbtiles"]
    tiles: Literal["mvt", "png", "jpg", "webp"]
    zoom_minimum: int
    zoom_maximum: int
    bounds_deg: tuple[float, float, float, float]
    """west, south, east, north"""
    attribution: str
    layers: list[str]
    """of vector tiles"""


@answer()
class MapAnswer(TypedDict):
    """The map file, or why there is none."""

    map: MapFile | None
    problem: str | None
    """why the file that is named cannot be used"""


class InstalledMap:
    """The map file that is installed, and its tiles."""

    def __init__(self, map_file: str | None) -> None:
        self._path = Path(map_file).expanduser() if map_file else None

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        shown = "The installed map, or why there is none"
        app.add_api_route("/api/map", self.map, tags=["unit"], response_description=shown)
        app.add_api_route("/map/tiles.pmtiles", self.archive, include_in_schema=False)
        app.add_api_route("/map/tiles/{zoom}/{x}/{y}", self.tile, include_in_schema=False)

    def map(self) -> MapAnswer:
        """The installed map: container, format, zoom levels, bounds, layers; `problem` says why there is none."""
        if self._path is None:
            return {"map": None, "problem": None}
        try:
            return {"map": cast("MapFile", dict(vars(tiles.describe(self._path)))), "problem": None}
        except tiles.BadMap as error:
            return {"map": None, "problem": str(error)}

    def archive(self) -> Response:
        """The PMTiles file, in the ranges that are asked for."""
        if self._path is None or self._path.suffix != ".pmtiles" or not self._path.is_file():
            raise HTTPException(404, "no PMTiles file is installed; /api/map says why")
        return FileResponse(self._path, media_type="application/octet-stream")

    def tile(
        self,
        zoom: Annotated[int, PathParameter(ge=0, le=ZOOM_MAXIMUM)],
        x: Annotated[int, PathParameter(ge=0, lt=2**ZOOM_MAXIMUM)],
        y: Annotated[int, PathParameter(ge=0, lt=2**ZOOM_MAXIMUM)],
    ) -> Response:
        """One tile of an MBTiles file; 204 where the map has none."""
        if self._path is None or self._path.suffix != ".mbtiles":
            raise HTTPException(404, "no MBTiles file is installed; /api/map says why")
        try:
            description, data = tiles.describe(self._path), tiles.read_tile(self._path, zoom, x, y)
        except tiles.BadMap as error:
            raise HTTPException(404, str(error)) from error
        if data is None:
            return Response(status_code=204)
        headers = {"Content-Encoding": "gzip"} if data[:2] == b"\x1f\x8b" else {}
        return Response(data, 200, headers, tiles.CONTENT_TYPES[description.tiles])
