import bz2
import gzip
import sqlite3
import zlib
from math import cos, log, pi, radians, tan
from pathlib import Path
from struct import pack

import lz4.frame
import pytest
import zstandard

from shared.page.map.tiles import BadMap, describe, read_tile
from tests.support.dashboard.tile_files import tile_at, write_mbtiles, write_pmtiles

LATITUDE_DEG, LONGITUDE_DEG = 48.1351, 11.5820


def test_a_pmtiles_file_is_described_by_its_header_and_metadata(tmp_path: Path) -> None:
    write_pmtiles(tmp_path / "a.pmtiles", LATITUDE_DEG, LONGITUDE_DEG, protomaps=True)
    found = describe(tmp_path / "a.pmtiles")
    assert (found.container, found.tiles, found.zoom_minimum, found.zoom_maximum) == ("pmtiles", "mvt", 10, 14)
    assert found.bounds_deg == pytest.approx((11.082, 47.6351, 12.082, 48.6351), abs=1e-6)
    assert found.attribution == "© test mappers", "text without markup"
    assert "roads" in found.layers


def test_an_mbtiles_file_is_described_and_its_rows_are_counted_from_the_south(tmp_path: Path) -> None:
    path = tmp_path / "a.mbtiles"
    write_mbtiles(path, LATITUDE_DEG, LONGITUDE_DEG)
    found = describe(path)
    assert (found.container, found.tiles, found.attribution) == ("mbtiles", "mvt", "© test mappers")
    assert "transportation" in found.layers
    x, y = tile_at(14, LATITUDE_DEG, LONGITUDE_DEG)
    phi = radians(LATITUDE_DEG)  # the form of the formula that OpenStreetMap's wiki gives
    assert y == int((1.0 - log(tan(phi) + 1.0 / cos(phi)) / pi) / 2.0 * 2**14)
    data = read_tile(path, 14, x, y)
    assert data is not None and b"transportation" in gzip.decompress(data)
    assert read_tile(path, 14, x, y + 1) is None


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("a.pmtiles", b"", "no PMTiles file of version 3"),
        ("a.pmtiles", b"PMTiles\x02" + bytes(200), "no PMTiles file of version 3"),
        ("a.pmtiles", b"PMTiles\x03" + bytes(24) + b"\xff" * 100, "more than 2000000"),
        ("a.pmtiles", b"PMTiles\x03" + bytes(200), "neither MVT nor PNG"),
        ("a.mbtiles", b"no database at all" * 100, "not a database"),
        ("a.zip", b"", "neither a .pmtiles nor a .mbtiles"),
    ],
)
def test_a_file_that_is_no_map_is_refused_with_the_how_to(tmp_path: Path, name: str, content: bytes, why: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BadMap, match=why) as found:
        describe(tmp_path / name)
    assert "install-a-map.md" in str(found.value)


def repacked(path: Path, tile: bytes) -> None:
    """Replace every tile of an MBTiles file."""
    with sqlite3.connect(path) as database:
        database.execute("update tiles set tile_data = ?", (tile,))
    database.close()


VECTOR = b"\x1a\x10" + bytes(40)
PACKED = gzip.compress(VECTOR, mtime=0)  # without the time, which would be in the names of tests
PNG = b"\x89PNG\r\n\x1a\n" + bytes(20)


@pytest.mark.parametrize(
    ("tile", "why"),
    [
        (zlib.compress(VECTOR), "packed with zlib, which a browser does not unpack"),
        (zlib.compress(VECTOR, 1), "packed with zlib"),
        (zstandard.compress(VECTOR), "packed with zstd"),
        (lz4.frame.compress(VECTOR), "packed with lz4"),
        (bz2.compress(VECTOR), "packed with bzip2"),
        (PNG, "are not MVT"),
        (b"\x8b\x02\x80" + VECTOR, "are not MVT"),  # Brotli has no magic number
    ],
)
def test_tiles_that_a_browser_cannot_unpack_are_a_problem(tmp_path: Path, tile: bytes, why: str) -> None:
    path = tmp_path / "a.mbtiles"
    write_mbtiles(path, LATITUDE_DEG, LONGITUDE_DEG)
    repacked(path, tile)
    with pytest.raises(BadMap, match=why):
        describe(path)


@pytest.mark.parametrize("tile", [VECTOR, PACKED])
def test_vector_tiles_may_be_packed_with_gzip_or_not(tmp_path: Path, tile: bytes) -> None:
    path = tmp_path / "a.mbtiles"
    write_mbtiles(path, LATITUDE_DEG, LONGITUDE_DEG)
    repacked(path, tile)
    assert describe(path).tiles == "mvt"


def test_pictures_of_another_format_and_no_tiles_are_a_problem(tmp_path: Path) -> None:
    path = tmp_path / "a.mbtiles"
    write_mbtiles(path, LATITUDE_DEG, LONGITUDE_DEG, png=PNG)
    assert describe(path).tiles == "png"
    repacked(path, b"\xff\xd8\xff\xe0" + bytes(20))
    with pytest.raises(BadMap, match="are not PNG"):
        describe(path)
    with sqlite3.connect(path) as database:
        database.execute("delete from tiles")
    database.close()
    with pytest.raises(BadMap, match="holds no tiles"):
        describe(path)


@pytest.mark.parametrize(
    ("stated", "tile", "why"),
    [(3, None, "packed with Brotli"), (4, None, "packed with Zstandard"), (0, None, "an unknown compression"),
     (2, zlib.compress(VECTOR), "packed with zlib"), (1, zlib.compress(VECTOR), "packed with zlib"),
     (2, VECTOR, "are not MVT packed with gzip"), (1, PACKED, "packed with gzip, which is not")],
)  # fmt: skip
def test_a_pmtiles_file_with_tiles_that_a_browser_cannot_unpack_is_a_problem(
    tmp_path: Path, stated: int, tile: bytes | None, why: str
) -> None:
    path = tmp_path / "a.pmtiles"
    write_pmtiles(path, LATITUDE_DEG, LONGITUDE_DEG)
    data = bytearray(path.read_bytes())
    data[98] = stated
    if tile is not None:
        begin = int.from_bytes(data[56:64], "little")
        data[begin:] = tile
    path.write_bytes(data)
    with pytest.raises(BadMap, match=why):
        describe(path)


def test_metadata_that_unpack_to_gigabytes_are_a_problem(tmp_path: Path) -> None:
    path = tmp_path / "a.pmtiles"
    write_pmtiles(path, LATITUDE_DEG, LONGITUDE_DEG)
    data = bytearray(path.read_bytes())
    bomb = gzip.compress(bytes(30_000_000))
    data[24:40] = pack("<2Q", len(data), len(bomb))
    path.write_bytes(data + bomb)
    with pytest.raises(BadMap, match="unpack to more than 20 MB"):
        describe(path)


@pytest.mark.parametrize("name", ["b.pmtiles", "b.mbtiles"])
def test_a_map_that_is_not_there_is_said_to_be_missing(tmp_path: Path, name: str) -> None:
    with pytest.raises(BadMap, match="is not there"):
        describe(tmp_path / name)


def test_bounds_of_a_hostile_database_are_refused(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "c.mbtiles") as database:
        database.execute("create table metadata (name text, value text)")
        database.execute("insert into metadata values ('format', 'png'), ('bounds', '1,2,x')")
    database.close()
    with pytest.raises(BadMap, match="cannot be read"):
        describe(tmp_path / "c.mbtiles")


def test_a_database_without_tiles_and_one_that_is_gone_cannot_be_read(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "d.mbtiles") as database:
        database.execute("create table metadata (name text, value text)")
    database.close()
    for name in ("d.mbtiles", "e.mbtiles"):
        with pytest.raises(BadMap, match="cannot be read"):
            read_tile(tmp_path / name, 0, 0, 0)
