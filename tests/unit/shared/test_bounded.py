"""Readers of files of others take little memory and time, whatever the file holds.

Each hostile file is read in a process of its own with an address space of `SPACE` bytes above what the imports take:
a reader that grows is ended by the system instead of growing.
"""

import gzip
import io
import sqlite3
import subprocess
import sys
import tomllib
from pathlib import Path
from struct import pack

import pytest

from shared import bounded
from shared.bounded import SizeExceeded, checked, lines, load_json, load_toml, read_bytes, read_text
from tests.support.cases import each
from tests.support.dashboard.tile_files import write_pmtiles
from tests.support.patience import HANGS_S

SPACE = 200_000_000  # bytes
LIMITED = """
import resource, sys
from pathlib import Path
{imports}
with open("/proc/self/statm") as file:
    now = int(file.read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (now + {space}, now + {space}))
resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
path = Path(sys.argv[1])
try:
    {read}
except {refusal} as error:
    print("refused:", error)
else:
    print("read")
"""


def outcome(path: Path, imports: str, read: str, refusal: str, *, mapped: int = 0) -> str:
    """Read a file in a process with little memory; return what it prints."""
    program = LIMITED.format(imports=imports, read=read, refusal=refusal, space=SPACE + mapped)
    done = subprocess.run(
        [sys.executable, "-c", program, str(path)], capture_output=True, text=True, timeout=HANGS_S, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.strip()


def test_a_file_is_read_up_to_its_bound(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"x" * 10)
    assert read_bytes(path, 10) == b"x" * 10
    assert read_text(path, 10) == "x" * 10
    with pytest.raises(SizeExceeded, match="more than 9 bytes"):
        read_bytes(path, 9)
    with pytest.raises(SizeExceeded, match=r"more than 1\.0 MB"):
        read_bytes(Path("/dev/zero"), 1_000_000)


def test_lines_are_read_up_to_their_bound() -> None:
    assert list(lines(io.BytesIO(b"a\nbc\n"), 3)) == [b"a\n", b"bc\n"]
    with pytest.raises(SizeExceeded, match="a line of more than 3 bytes"):
        list(lines(io.BytesIO(b"a\nlonger\n"), 3))
    assert list(checked(["ab", "c"], 2)) == ["ab", "c"]
    with pytest.raises(SizeExceeded):
        list(checked(["abc"], 2))


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"[" * 100_000, "levels"),
        (b'{"a":' * 50_000, "levels"),
        (b"[" + b"{}," * 250_000 + b"{}]", "values"),
        (b'"' + b"x" * 1_000_001 + b'"', "more than"),
    ],
    ids=["lists in lists", "tables in tables", "many values", "long"],
)
def test_json_that_takes_more_than_its_bytes_is_refused(data: bytes, reason: str) -> None:
    with pytest.raises(SizeExceeded, match=reason):
        load_json(data, 1_000_000)


def test_json_of_ordinary_size_is_read() -> None:
    assert load_json(b'{"a": [1, {"b": null}]}', 100) == {"a": [1, {"b": None}]}
    with pytest.raises(ValueError, match="Expecting"):
        load_json(b"{", 100)


TOML = {
    "deep lists": "a = " + "[" * 60_000 + "]" * 60_000,
    "deep tables": "a = " + "{b=" * 1000 + "1" + "}" * 1000,
    "dotted key": ".".join(["a"] * 50_000) + " = 1",
    "spaced dots": " . ".join(["a"] * 50_000) + " = 1",
    "quoted dots": ".".join(['"a"'] * 50_000) + " = 1",
    "dotted header": "[" + ".".join(["a"] * 50_000) + "]",
    "many keys": "\n".join(f"k{n} = {n}" for n in range(10_000)),
    "many headers": "\n".join(f"[t{n}]" for n in range(10_000)),
    "many values": "a = [" + "1," * 100_000 + "]",
    "long": "# " + "x" * 300_000,
}


@each("text", TOML.values())
def test_toml_that_takes_more_than_its_bytes_is_refused(text: str) -> None:
    with pytest.raises(SizeExceeded):
        load_toml(text)


def test_brackets_and_dots_in_texts_and_comments_are_no_levels() -> None:
    text = f'''
# {"[" * 100} {".".join("a" * 100)}
a = "{"[" * 100} \\" {".".join("a" * 100)}"
b = \'{"{" * 100} "\'
c = """
{"[" * 100} "quoted" \\""" # none
"""
d = \'\'\'{"[" * 100}
\'\'\'
[t.u]
"e.f" = [[1.5, 2.5], [3.5]]
'''
    assert load_toml(text) == tomllib.loads(text)
    assert load_toml(text)["t"] == {"u": {"e.f": [[1.5, 2.5], [3.5]]}}


def test_every_toml_file_of_the_repository_is_far_from_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    root = Path(__file__).resolve().parents[3]
    texts = [path.read_text() for folder in ("deploy", "benchmarks") for path in (root / folder).rglob("*.toml")]
    assert len(texts) > 5
    monkeypatch.setattr(bounded, "TOML_DEPTH", bounded.TOML_DEPTH // 2)
    monkeypatch.setattr(bounded, "TOML_KEYS", bounded.TOML_KEYS // 5)
    for text in texts:
        assert load_toml(text) == tomllib.loads(text)


def test_a_vehicle_file_without_end_is_refused_in_little_memory(tmp_path: Path) -> None:
    config = "from shared.runtime.config import load_vehicle\nfrom shared.errors import UserError"
    assert "more than 0.3 MB" in outcome(Path("/dev/zero"), config, "load_vehicle(path)", "UserError")
    path = tmp_path / "car.toml"
    path.write_text(TOML["dotted key"])
    assert "levels" in outcome(path, config, "load_vehicle(path)", "UserError")


def test_a_dbc_file_with_a_huge_message_or_signal_is_refused_in_little_memory(tmp_path: Path) -> None:
    dbc = "from services.parsers.can.database import load"
    path = tmp_path / "bus.dbc"
    for text in (
        'BO_ 100 Huge: 99999999 X\n SG_ s : 0|8@1+ (1,0) [0|1] "" X\n',
        'BO_\n100\nHuge\n:\n99999999 X\n SG_ s : 0|8@1+ (1,0) [0|1] "" X\n',
        'BO_ 100 Ok: 8 X\n SG_ s m1 : 99999999|8@1+ (1,0) [0|1] "" X\n',
        'BO_ 100 Ok: 8 X\n SG_ s : 0|99999999@1+ (1,0) [0|1] "" X\n',
        "BO_ 1 A: 8 X\n" * 6000,
    ):
        path.write_text(text)
        assert outcome(path, dbc, "load(path.read_text())", "ValueError").startswith("refused:"), text[:80]


def test_a_recording_with_huge_metadata_or_attachments_is_opened_in_little_memory(tmp_path: Path) -> None:
    path = tmp_path / "huge.mcap"
    name = b"\x01\0\0\0a"
    with path.open("wb") as file:
        file.write(b"\x89MCAP0\r\n\x0c" + (400_000_000).to_bytes(8, "little") + name)
        file.truncate(17 + 400_000_000 + 100)
    read = "print(len(Recording(path).metadata)); list(Recording(path))"
    size = path.stat().st_size
    assert outcome(path, "from shared.recording import Recording", read, "ValueError", mapped=size).endswith("read")


MAP = "import sqlite3\nfrom shared.page.map.tiles import BadMap, describe, read_tile"
VIEWS = {
    "endless tiles": "create view tiles as with recursive n(x) as (select 1 union all select x + 1 from n) "
    "select x % 1 zoom_level, x % 1 tile_column, x % 1 tile_row, x'' tile_data from n",
    "huge tile": "create view tiles as select 1 zoom_level, 1 tile_column, 0 tile_row, zeroblob(900000000) tile_data",
    "growing text": "create view tiles as with recursive n(x, t) as (select 1, 'x' union all select x + 1, t || t "
    "from n) select 1 zoom_level, 1 tile_column, 0 tile_row, t tile_data from n where x > 40",
    "a list that is kept": "create view tiles as with recursive n(x) as (select 1 union select x + 1 from n) "
    "select 1 zoom_level, 1 tile_column, 0 tile_row, group_concat(x, 'xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx') tile_data "
    "from n",
    "a file of the host": "create view tiles as select 1 zoom_level, 1 tile_column, 0 tile_row, "
    "load_extension('/etc/passwd') tile_data",
}


@pytest.mark.parametrize("view", VIEWS)
def test_a_map_whose_view_has_no_end_is_refused_in_little_memory(tmp_path: Path, view: str) -> None:
    path = tmp_path / "a.mbtiles"
    with sqlite3.connect(path) as database:
        database.execute("create table metadata (name text, value text)")
        database.execute("insert into metadata values ('format', 'png')")
        database.execute(VIEWS[view])
    database.close()
    for read in ("describe(path)", "read_tile(path, 1, 1, 1)"):
        assert outcome(path, MAP, read, "BadMap").startswith("refused:")


def test_metadata_of_a_map_that_are_a_view_without_end_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mbtiles"
    with sqlite3.connect(path) as database:
        database.execute("create table tiles (zoom_level, tile_column, tile_row, tile_data)")
        database.execute(
            "create view metadata as with recursive n(x) as (select 1 union all select x + 1 from n) "
            "select 'other' name, x value from n"
        )
    database.close()
    assert outcome(path, MAP, "describe(path)", "BadMap").startswith("refused:")


def test_metadata_of_a_map_with_millions_of_values_are_refused_in_little_memory(tmp_path: Path) -> None:
    path = tmp_path / "a.pmtiles"
    write_pmtiles(path, 48.0, 11.0)
    data = bytearray(path.read_bytes())
    packed = gzip.compress(b"[" + b"{}," * 6_000_000 + b"{}]")
    assert len(packed) < 100_000
    data[24:40] = pack("<2Q", len(data), len(packed))
    path.write_bytes(bytes(data) + packed)
    assert "more than 200000 values" in outcome(path, MAP, "describe(path)", "BadMap")
