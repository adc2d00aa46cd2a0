"""The map that the configuration names: one PMTiles or MBTiles file, described and read from disk."""

import re
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from struct import Struct
from typing import TYPE_CHECKING, cast

from shared.bounded import load_json, open_sqlite
from shared.unpacked import compression_of, unpacked

if TYPE_CHECKING:
    import sqlite3

REMEDY = "see docs/how-to/install-a-map.md"
REPACK = "write it anew with tiles that are packed with gzip"
METADATA_BYTES, METADATA_UNPACKED_BYTES = 2_000_000, 20_000_000
MBTILES_KEYS = ("format", "bounds", "minzoom", "maxzoom", "attribution", "json")
SAMPLES, SAMPLE_BYTES = 20, 12  # tiles, and bytes of each, that are looked at
# PMTiles specification, version 3, section 3: offsets of the fields that are read here.
_PLACES = Struct("<Q")  # 24: offset of the metadata, 32: their length, 56: offset of the tiles
_BOUNDS = Struct("<4i")  # 102: west, south, east, north [1e-7 deg]
HEADER_BYTES, VERSION = 127, 3
COMPRESSION_NONE, COMPRESSION_GZIP = 1, 2
COMPRESSIONS = {0: "an unknown compression", 1: "no compression", 2: "gzip", 3: "Brotli", 4: "Zstandard"}
MVT_LAYER = 0x1A  # the first byte of a vector tile that is not packed: the tag of its first layer
TILE_FORMATS = {1: "mvt", 2: "png", 3: "jpg", 4: "webp"}
MBTILES_FORMATS = {"pbf": "mvt", "mvt": "mvt", "png": "png", "jpg": "jpg", "jpeg": "jpg", "webp": "webp"}
CONTENT_TYPES = {
    "mvt": "application/vnd.mapbox-vector-tile",
    "png": "image/png",
    "jpg": "image/jpeg",
    "webp": "image/webp",
}


class BadMap(Exception):
    """The map cannot be used; the text says why and what to do."""


@dataclass(frozen=True)
class MapDescription:
    """What a browser must know of a map before it asks for tiles."""

    container: str  # pmtiles or mbtiles
    tiles: str  # mvt, png, jpg or webp
    zoom_minimum: int
    zoom_maximum: int
    bounds_deg: tuple[float, float, float, float]  # west, south, east, north
    attribution: str  # plain text
    layers: tuple[str, ...]  # of vector tiles


def describe(path: Path) -> MapDescription:
    """Read what a file says of itself; raises `BadMap`."""
    try:
        if path.suffix == ".pmtiles":
            return _describe_pmtiles(path)
        if path.suffix == ".mbtiles":
            return _describe_mbtiles(path)
    except FileNotFoundError as error:
        raise BadMap(f"the map {path.name} named by map_file is not there; {REMEDY}") from error
    except (OSError, ValueError, EOFError) as error:
        raise BadMap(f"the map {path.name} cannot be read ({error}); {REMEDY}") from error
    raise BadMap(f"the map {path.name} is neither a .pmtiles nor a .mbtiles file; {REMEDY}")


def _describe_pmtiles(path: Path) -> MapDescription:
    with path.open("rb") as file:
        header = file.read(HEADER_BYTES)
        if len(header) < HEADER_BYTES or header[:7] != b"PMTiles" or header[7] != VERSION:
            raise ValueError(f"it is no PMTiles file of version {VERSION}")
        begin, size = (_PLACES.unpack_from(header, at)[0] for at in (24, 32))
        if size > METADATA_BYTES:
            raise ValueError(f"its metadata have {size} bytes, more than {METADATA_BYTES}")
        file.seek(begin)
        packed = file.read(size)
        file.seek(_PLACES.unpack_from(header, 56)[0])
        sample = file.read(SAMPLE_BYTES)
    tiles, compression = TILE_FORMATS.get(header[99]), header[97]
    if tiles is None or compression not in (COMPRESSION_NONE, COMPRESSION_GZIP):
        raise ValueError("its tiles are neither MVT nor PNG, JPEG or WebP, or it is not packed with gzip")
    if header[98] not in (COMPRESSION_NONE, COMPRESSION_GZIP):
        named = COMPRESSIONS.get(header[98], "an unknown compression")
        raise ValueError(f"its tiles are packed with {named}, which a browser does not unpack: {REPACK}")
    if compression == COMPRESSION_GZIP:
        packed = unpacked(packed, "gzip", METADATA_UNPACKED_BYTES)
    _check_sample(sample, tiles, packed=header[98] == COMPRESSION_GZIP)
    metadata = _object(packed)
    west, south, east, north = (e7 * 1e-7 for e7 in _BOUNDS.unpack_from(header, 102))
    return MapDescription(
        "pmtiles", tiles, header[100], header[101], (west, south, east, north), *_credits(metadata, metadata)
    )


def _describe_mbtiles(path: Path) -> MapDescription:
    import sqlite3

    try:
        with closing(open_sqlite(path)) as database:
            metadata = {key: value for key in MBTILES_KEYS if (value := _value(database, key)) is not None}
            query = "select substr(cast(tile_data as blob), 1, ?) from tiles limit ?"
            samples = [bytes(row[0]) for row in database.execute(query, (SAMPLE_BYTES, SAMPLES)) if row[0]]
    except (sqlite3.Error, MemoryError) as error:
        raise ValueError(str(error) or "a query of it takes too much memory") from error
    tiles = MBTILES_FORMATS.get(metadata.get("format", ""))
    if tiles is None:
        raise ValueError(f"its format {metadata.get('format')!r} is none of {', '.join(MBTILES_FORMATS)}")
    if not samples:
        raise ValueError("it holds no tiles")
    for sample in samples:
        _check_sample(sample, tiles, packed=None)
    bounds = tuple(float(part) for part in metadata.get("bounds", "-180,-85,180,85").split(","))
    if len(bounds) != 4:
        raise ValueError("its bounds are not four numbers")
    zooms = int(metadata.get("minzoom", "0")), int(metadata.get("maxzoom", "14"))
    return MapDescription(
        "mbtiles", tiles, *zooms, bounds, *_credits(metadata, _object(metadata.get("json", "{}").encode()))
    )


def _check_sample(sample: bytes, tiles: str, *, packed: bool | None) -> None:
    """Raise ValueError for a tile that begins as none does that a browser can show.

    Parameters
    ----------
    sample : bytes
        The first bytes of a tile.
    tiles : str
        Format of the tiles: mvt, png, jpg or webp.
    packed : bool or None
        Whether they are packed with gzip; None: some may be.
    """
    compression = compression_of(sample)
    if compression == "gzip" and packed is not False:
        return
    if compression is not None:
        raise ValueError(f"its tiles are packed with {compression}, which is not what it says: {REPACK}")
    if _is_zlib(sample) and tiles == "mvt":
        raise ValueError(f"its tiles are packed with zlib, which a browser does not unpack: {REPACK}")
    begins = {"mvt": bytes((MVT_LAYER,)), "png": b"\x89PNG", "jpg": b"\xff\xd8\xff", "webp": b"RIFF"}[tiles]
    if packed or not sample.startswith(begins):
        wanted = f"{tiles.upper()} packed with gzip" if packed else tiles.upper()
        raise ValueError(f"its tiles begin with {sample[:4].hex(' ')}, and are not {wanted}: {REPACK}")


def _is_zlib(sample: bytes) -> bool:
    """Whether bytes begin as a stream of zlib (RFC 1950, section 2.2)."""
    return len(sample) >= 2 and sample[0] & 0x0F == 8 and sample[0] >> 4 <= 7 and (sample[0] << 8 | sample[1]) % 31 == 0


def read_tile(path: Path, zoom: int, x: int, y: int) -> bytes | None:
    """Read a tile of an MBTiles file by its XYZ address; None where the map has none; raises `BadMap`.

    References
    ----------
    MBTiles specification 1.3: rows are counted from the south, as in the Tile Map Service specification.
    """
    import sqlite3

    try:
        with closing(open_sqlite(path)) as database:
            row = database.execute(
                "select tile_data from tiles where zoom_level = ? and tile_column = ? and tile_row = ?",
                (zoom, x, (1 << zoom) - 1 - y),
            ).fetchone()
    except (sqlite3.Error, OSError, MemoryError) as error:
        raise BadMap(f"the map {path.name} cannot be read ({error}); {REMEDY}") from error
    return bytes(row[0]) if row else None


def _value(database: "sqlite3.Connection", key: str) -> str | None:
    row = database.execute("select value from metadata where name = ? limit 1", (key,)).fetchone()
    return None if row is None or row[0] is None else str(row[0])


def _object(data: bytes) -> Mapping[str, object]:
    content = load_json(data or b"{}", METADATA_UNPACKED_BYTES)
    return cast(Mapping[str, object], content) if isinstance(content, dict) else {}


def _credits(metadata: Mapping[str, object], described: Mapping[str, object]) -> tuple[str, tuple[str, ...]]:
    """Find the attribution, without its markup, and the names of the vector layers."""
    attribution = re.sub(r"<[^>]*>", "", str(metadata.get("attribution", "")))[:300].replace("&copy;", "©")
    layers = described.get("vector_layers")
    names = [str(layer.get("id")) for layer in layers if isinstance(layer, dict)] if isinstance(layers, list) else []
    return attribution, tuple(names[:50])
