"""Vector tiles of the newest report of each vehicle: near ones are one cluster, with their number and worst verdict."""

import time
from asyncio import Lock
from collections import OrderedDict
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, FastAPI, HTTPException, Path, Query, Request, Response

from shared.fleet.times import MAX_AGE_S

from .access.guard import visitor_of
from .database import Database

MAX_ZOOM = 22
EXTENT = 4096  # units of a tile
CELLS = 12  # clusters beside each other in a tile of 512 pixels
SINGLE_ZOOM = 16  # from here on every vehicle is drawn
MOST_SINGLE = 2000  # vehicles of one cell or tile that are drawn beside each other
CACHED_S = 2.0
CACHED_TILES = 2000
MIN_SPEED_M_S = 0.5  # at which a course is shown
HALF_M = 20_037_508.342789244  # of the square of Web Mercator
# Conditions of the map and of the list: both show the same vehicles.
CHOSEN = f"""
    (%(find)s = '' OR position(lower(%(find)s) IN lower(vehicle)) > 0)
    AND (%(verdicts)s::smallint[] IS NULL OR verdict = ANY(%(verdicts)s))
    AND (%(age)s = 'any' OR (%(now)s - utc_ms > {MAX_AGE_S * 1000}) = (%(age)s = 'old'))
    AND (NOT %(alarm)s OR EXISTS (SELECT FROM alarm WHERE alarm.vehicle = vehicle_now.vehicle AND until_ms IS NULL))
"""
# No vehicle is in two tiles, so that no cluster counts it twice. The worst verdict of a cluster is that of the reports
# that are not old, where there are any. Every column that is gathered costs a millisecond for 10,000 vehicles: what is
# told of a single one is looked up.
FRESH = 16  # more than any verdict: put before those that are not old
TILE = f"""
WITH found AS (
    SELECT vehicle, CASE WHEN %(now)s - utc_ms > {MAX_AGE_S * 1000} THEN verdict ELSE verdict + {FRESH} END AS verdict,
        x_m - %(west)s AS x, y_m - %(south)s AS y
    FROM vehicle_now
    WHERE x_m >= %(west)s AND x_m < %(west)s + %(size)s AND y_m >= %(south)s AND y_m < %(south)s + %(size)s AND {CHOSEN}
), cluster AS (
    SELECT count(*)::int AS vehicles, min(vehicle) AS name, max(verdict) AS verdict,
        sum(CASE WHEN verdict < {FRESH} THEN 1 ELSE 0 END)::int AS old, sum(x) / count(*) AS x, sum(y) / count(*) AS y
    FROM found
    GROUP BY floor(x * {CELLS} / %(size)s), floor(y * {CELLS} / %(size)s),
        CASE WHEN %(zoom)s >= {SINGLE_ZOOM} THEN vehicle END
    LIMIT {MOST_SINGLE}
), feature AS (
    SELECT ST_MakePoint(x * {EXTENT} / %(size)s, {EXTENT} - y * {EXTENT} / %(size)s) AS geometry,
        vehicles, cluster.verdict %% {FRESH} AS verdict, old, one.vehicle AS name,
        ((%(now)s - one.utc_ms) / 1000)::int AS age_s,
        CASE WHEN one.north_m_s * one.north_m_s + one.east_m_s * one.east_m_s > {MIN_SPEED_M_S**2}
            THEN round(degrees(atan2(one.east_m_s, one.north_m_s)))::int END AS course_deg
    FROM cluster LEFT JOIN vehicle_now AS one ON vehicles = 1 AND one.vehicle = name
)
SELECT ST_AsMVT(feature, 'vehicles', {EXTENT}, 'geometry') AS tile FROM feature
"""


@dataclass(frozen=True)
class Filter:
    """Which vehicles are shown."""

    find: str = ""  # part of the name
    verdicts: tuple[int, ...] | None = None
    age: str = "any"  # any, fresh, old
    alarm: bool = False  # with an open alarm alone

    @property
    def values(self) -> dict[str, object]:
        """Parameters of `CHOSEN`; the ages are those of now."""
        verdicts = None if self.verdicts is None else list(self.verdicts)
        return {"find": self.find, "verdicts": verdicts, "age": self.age, "alarm": self.alarm, "now": now_ms()}


def filter_of(
    find: Annotated[str, Query(max_length=48)] = "",
    verdicts: Annotated[str, Query(pattern=r"^[0-5]?(,[0-5]){0,5}$")] = "",
    age: Annotated[str, Query(pattern=r"^(any|fresh|old)$")] = "any",
    alarm: bool = False,
) -> Filter:
    """Read the filter of a request."""
    chosen = tuple(sorted({int(code) for code in verdicts.split(",") if code})) or None
    return Filter(find.strip(), chosen, age, alarm)


def frame_of(zoom: int, x: int, y: int) -> dict[str, float]:
    """South-western corner and size of a tile [m, Web Mercator]."""
    size = 2.0 * HALF_M / (1 << zoom)
    return {"west": x * size - HALF_M, "south": HALF_M - (y + 1) * size, "size": size}


def now_ms() -> int:
    """Time of day [ms, UTC]."""
    return time.time_ns() // 1_000_000


Key = tuple[int, int, int, int, Filter]


class Tiles:
    """Tiles of the last two seconds; who asks for one that is being made waits for it."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._made: OrderedDict[Key, tuple[float, bytes]] = OrderedDict()
        self._making: dict[Key, Lock] = {}

    def add_to(self, app: FastAPI) -> None:
        """Add the route."""
        app.add_api_route("/tiles/{zoom}/{x}/{y}.mvt", self.tile)

    async def tile(
        self,
        request: Request,
        zoom: Annotated[int, Path(ge=0, le=MAX_ZOOM)],
        x: Annotated[int, Path(ge=0, lt=2**MAX_ZOOM)],
        y: Annotated[int, Path(ge=0, lt=2**MAX_ZOOM)],
        chosen: Annotated[Filter, Depends(filter_of)],
    ) -> Response:
        """One tile; 204 where there is no vehicle."""
        if x >= 1 << zoom or y >= 1 << zoom:
            raise HTTPException(404, "there is no such tile")
        key = visitor_of(request).tenant_id, zoom, x, y, chosen
        data = await self._newest(key)
        headers = {"Cache-Control": f"private, max-age={CACHED_S:.0f}"}
        if not data:
            return Response(status_code=204, headers=headers)
        return Response(data, 200, headers, "application/vnd.mapbox-vector-tile")

    async def _newest(self, key: Key) -> bytes:
        lock = self._making.setdefault(key, Lock())
        try:
            async with lock:
                made_s, data = self._made.get(key, (-1e9, b""))
                if time.monotonic() - made_s < CACHED_S:
                    return data
                data = await self._make(key)
                self._made[key] = time.monotonic(), data
                self._made.move_to_end(key)
                while len(self._made) > CACHED_TILES:
                    self._made.popitem(last=False)
                return data
        finally:
            if self._making.get(key) is lock and not lock.locked():
                self._making.pop(key, None)

    async def _make(self, key: Key) -> bytes:
        tenant_id, zoom, x, y, chosen = key
        async with self._database.tenant(tenant_id) as cursor:
            await cursor.execute(TILE, {"zoom": zoom, **frame_of(zoom, x, y), **chosen.values})
            row = await cursor.fetchone()
        return b"" if row is None or row["tile"] is None else bytes(row["tile"])
