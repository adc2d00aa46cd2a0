"""A tiny map of one crossroads, as vector tiles of either schema, in a PMTiles or an MBTiles file.

Written from the specifications: Mapbox Vector Tile 2.1, PMTiles 3, MBTiles 1.3.
"""

import gzip
import json
import sqlite3
from collections.abc import Mapping, Sequence
from math import asinh, pi, radians, tan
from pathlib import Path
from struct import pack

EXTENT = 4096
ZOOMS = (10, 14)
LINE, POLYGON, POINT = 2, 3, 1

Point = tuple[int, int]
Feature = tuple[int, Sequence[Point], Mapping[str, str]]  # geometry type, vertices in tile units, attributes

CROSSROADS: dict[str, list[Feature]] = {
    "transportation": [
        (LINE, [(0, 2048), (4096, 2048)], {"class": "primary"}),
        (LINE, [(2048, 0), (2048, 4096)], {"class": "minor"}),
    ],
    "water": [(POLYGON, [(0, 0), (1400, 0), (1400, 1400), (0, 1400)], {"class": "lake"})],
    "landcover": [(POLYGON, [(2600, 2600), (4096, 2600), (4096, 4096), (2600, 4096)], {"class": "grass"})],
    "building": [(POLYGON, [(2300, 1500), (2600, 1500), (2600, 1800), (2300, 1800)], {})],
    "place": [(POINT, [(3000, 900)], {"class": "village", "name": "Testhausen"})],
}
PROTOMAPS = {"transportation": "roads", "building": "buildings", "place": "places"}
KINDS = {"primary": "major_road", "minor": "minor_road", "grass": "grassland", "village": "locality", "lake": "lake"}


def write_pmtiles(path: Path, latitude_deg: float, longitude_deg: float, *, protomaps: bool = False) -> None:
    """Write a PMTiles file with the tiles of all zoom levels at a place."""
    layers = _as_protomaps(CROSSROADS) if protomaps else CROSSROADS
    tile = gzip.compress(_tile(layers), mtime=0)
    ids = sorted(_tile_id(zoom, *tile_at(zoom, latitude_deg, longitude_deg)) for zoom in range(ZOOMS[0], ZOOMS[1] + 1))
    directory = gzip.compress(_directory(ids, len(tile)), mtime=0)
    metadata = gzip.compress(json.dumps(_metadata(layers)).encode(), mtime=0)
    root, begin = 127, 127 + len(directory)
    west, east, south, north = (round(x * 1e7) for x in _bounds(latitude_deg, longitude_deg))
    header = b"PMTiles\x03" + pack(
        "<11Q",
        root,
        len(directory),
        begin,
        len(metadata),
        0,
        0,
        begin + len(metadata),
        len(tile),
        len(ids),
        len(ids),
        1,
    )
    header += pack("<6B", 1, 2, 2, 1, *ZOOMS) + pack("<4i", west, south, east, north)
    header += pack("<B2i", ZOOMS[1], round(longitude_deg * 1e7), round(latitude_deg * 1e7))
    path.write_bytes(header + directory + metadata + tile)


def write_mbtiles(path: Path, latitude_deg: float, longitude_deg: float, *, png: bytes | None = None) -> None:
    """Write an MBTiles file with the tiles of all zoom levels at a place: vectors, or one picture everywhere."""
    west, east, south, north = _bounds(latitude_deg, longitude_deg)
    described = {
        "name": "test", "format": "png" if png else "pbf", "minzoom": str(ZOOMS[0]), "maxzoom": str(ZOOMS[1]),
        "bounds": f"{west},{south},{east},{north}", "attribution": "<a href='x'>&copy; test mappers</a>",
        "json": json.dumps(_metadata(CROSSROADS)),
    }  # fmt: skip
    with sqlite3.connect(path) as database:
        database.execute("create table metadata (name text, value text)")
        database.execute(
            "create table tiles (zoom_level integer, tile_column integer, tile_row integer, tile_data blob)"
        )
        database.executemany("insert into metadata values (?, ?)", described.items())
        for zoom in range(ZOOMS[0], ZOOMS[1] + 1):
            x, y = tile_at(zoom, latitude_deg, longitude_deg)
            data = png or gzip.compress(_tile(CROSSROADS), mtime=0)
            database.execute("insert into tiles values (?, ?, ?, ?)", (zoom, x, (1 << zoom) - 1 - y, data))
    database.close()


def _metadata(layers: Mapping[str, object]) -> dict[str, object]:
    return {"attribution": "<a href='x'>© test mappers</a>", "vector_layers": [{"id": name} for name in layers]}


def _as_protomaps(layers: Mapping[str, list[Feature]]) -> dict[str, list[Feature]]:
    return {
        PROTOMAPS.get(name, name): [
            (kind, points, {"kind" if k == "class" else k: KINDS.get(v, v) for k, v in attributes.items()})
            for kind, points, attributes in features
        ]
        for name, features in layers.items()
    }


def _bounds(latitude_deg: float, longitude_deg: float) -> tuple[float, float, float, float]:
    return longitude_deg - 0.5, longitude_deg + 0.5, latitude_deg - 0.5, latitude_deg + 0.5


def tile_at(zoom: int, latitude_deg: float, longitude_deg: float) -> tuple[int, int]:
    """Column and row, from the north-west, of the Web Mercator tile that holds a place."""
    size = 1 << zoom
    north = 0.5 - asinh(tan(radians(latitude_deg))) / (2.0 * pi)
    return int((longitude_deg / 360.0 + 0.5) * size), int(north * size)


def _tile_id(zoom: int, x: int, y: int) -> int:
    """Position on the Hilbert curves of all zoom levels below and of this one (PMTiles specification, 4.1)."""
    number = ((1 << (2 * zoom)) - 1) // 3
    half = 1 << zoom >> 1
    while half:
        right, lower = int(x & half > 0), int(y & half > 0)
        number += half * half * ((3 * right) ^ lower)
        if not lower:
            if right:
                x, y = half - 1 - (x & (half - 1)), half - 1 - (y & (half - 1))
            x, y = y, x
        half >>= 1
    return number


def _directory(ids: Sequence[int], length: int) -> bytes:
    """Entries that share one tile: identifiers as differences, run lengths, lengths, offsets plus one."""
    steps = [b - a for a, b in zip([0, *ids], ids, strict=False)]
    return b"".join(map(_varint, [len(ids), *steps, *[1] * len(ids), *[length] * len(ids), *[1] * len(ids)]))


def _varint(value: int) -> bytes:
    out = b""
    while value > 127:
        out, value = out + bytes([value & 127 | 128]), value >> 7
    return out + bytes([value])


def _field(number: int, data: bytes | int) -> bytes:
    """A field of a Protocol Buffers message: a number, or bytes with their length."""
    if isinstance(data, int):
        return _varint(number << 3) + _varint(data)
    return _varint(number << 3 | 2) + _varint(len(data)) + data


def _tile(layers: Mapping[str, list[Feature]]) -> bytes:
    return b"".join(_field(3, _layer(name, features)) for name, features in layers.items())


def _layer(name: str, features: list[Feature]) -> bytes:
    keys = list(dict.fromkeys(k for _, _, attributes in features for k in attributes))
    values = list(dict.fromkeys(v for _, _, attributes in features for v in attributes.values()))
    body = _field(15, 2) + _field(1, name.encode())
    for kind, points, attributes in features:
        tags = b"".join(_varint(keys.index(k)) + _varint(values.index(v)) for k, v in attributes.items())
        body += _field(2, _field(2, tags) + _field(3, kind) + _field(4, _geometry(kind, points)))
    body += b"".join(_field(3, k.encode()) for k in keys)
    return body + b"".join(_field(4, _field(1, v.encode())) for v in values) + _field(5, EXTENT)


def _geometry(kind: int, points: Sequence[Point]) -> bytes:
    """MoveTo the first vertex, LineTo the others, and close a polygon."""
    numbers, (px, py) = [1 | 1 << 3], (0, 0)
    for i, (x, y) in enumerate(points):
        if i == 1:
            numbers.append(2 | (len(points) - 1) << 3)
        numbers += [_zigzag(x - px), _zigzag(y - py)]
        px, py = x, y
    if kind == POLYGON:
        numbers.append(7 | 1 << 3)
    return b"".join(map(_varint, numbers))


def _zigzag(value: int) -> int:
    return value << 1 if value >= 0 else (-value << 1) - 1
