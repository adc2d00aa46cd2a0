"""Reads files and texts of others within bounds of bytes, lines, values and depth, checked before they are parsed.

A parser takes many times the memory of its text: JSON and TOML some hundred bytes a value, and a level of the stack for
each level of the text.
"""

import json
import re
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    import sqlite3

JSON_VALUES = 200_000  # at most so many in a document; each takes up to 250 bytes
TOML_BYTES, TOML_KEYS, TOML_DEPTH = 256 * 1024, 5000, 16  # of a file; ours have at most 6 kB and depth 4
LINE_BYTES = 1 << 20  # of a text file
SQLITE_VALUE_BYTES, SQLITE_HEAP_BYTES = 20_000_000, 64_000_000
SQLITE_STEPS, SQLITE_TURNS = 10_000, 500  # instructions of SQLite's machine: 5 million take about 0.5 s
_TOML_TEXTS = re.compile(
    r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|(?P<comment>#[^\n]*)', re.S
)
_TOML_BRACKETS = re.compile(r"[\[\]{}]")
_TOML_DOTTED = re.compile(r"[A-Za-z0-9_-]+(?:[ \t]*\.[ \t]*[A-Za-z0-9_-]+)+")


class SizeExceeded(ValueError):
    """A file or text has more than is read of its kind; the text says how much, and ends a sentence."""


def read_bytes(path: Path, most: int) -> bytes:
    """Read a file of at most `most` bytes; raises `SizeExceeded` for a longer one, and `OSError`."""
    with path.open("rb") as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise SizeExceeded(f"it has more than {_size(most)}")
    return data


def read_text(path: Path, most: int, encoding: str = "utf-8") -> str:
    """Read a text of at most `most` bytes; raises `SizeExceeded` for more, `OSError`, and `UnicodeDecodeError`."""
    return read_bytes(path, most).decode(encoding).replace("\r\n", "\n")


def lines(file: IO[bytes], most: int = LINE_BYTES) -> Iterator[bytes]:
    """Yield the lines of a file; raises `SizeExceeded` for a longer one: a file without lines would be read whole."""
    while line := file.readline(most + 1):
        if len(line) > most:
            raise SizeExceeded(f"it has a line of more than {_size(most)}")
        yield line


def checked(texts: Iterable[str], most: int = LINE_BYTES) -> Iterator[str]:
    """Yield the rows of a text that was opened elsewhere; raises `SizeExceeded` for one that is longer."""
    for text in texts:
        if len(text) > most:
            raise SizeExceeded(f"it has a line of more than {_size(most)}")
        yield text


def load_json(data: bytes, most: int) -> object:
    """Parse JSON of at most `most` bytes.

    Raises
    ------
    ValueError
        The text is no JSON, is longer, has too many values or too many levels.
    """
    if len(data) > most:
        raise SizeExceeded(f"its JSON has {_size(len(data))}, more than {_size(most)}")
    if sum(data.count(mark) for mark in (b",", b":", b"[", b"{")) > JSON_VALUES:
        raise SizeExceeded(f"its JSON has more than {JSON_VALUES} values")
    try:
        content: object = json.loads(data)
    except RecursionError as error:
        raise SizeExceeded("its JSON has too many levels") from error
    return content


def load_toml(text: str) -> dict[str, object]:
    """Parse TOML of at most 256 KiB, 5,000 keys and 16 levels.

    Raises
    ------
    tomllib.TOMLDecodeError
        The text is no TOML.
    TooMuch
        It is longer, or has more keys or levels.
    """
    if len(text) > TOML_BYTES:
        raise SizeExceeded(f"it has more than {_size(TOML_BYTES)}")
    bare = _TOML_TEXTS.sub(lambda match: "" if match["comment"] else "q", text)
    if bare.count("=") + bare.count("[") + bare.count(",") > TOML_KEYS:
        raise SizeExceeded(f"it has more than {TOML_KEYS} keys and values")
    depth = deepest = 0
    for bracket in _TOML_BRACKETS.finditer(bare):
        depth = depth + 1 if bracket[0] in "[{" else max(depth - 1, 0)
        deepest = max(deepest, depth)
    dotted = max((match[0].count(".") for match in _TOML_DOTTED.finditer(bare)), default=0)
    if deepest + dotted > TOML_DEPTH:
        raise SizeExceeded(f"it has more than {TOML_DEPTH} levels")
    return tomllib.loads(text)


def open_sqlite(path: Path) -> "sqlite3.Connection":
    """Open an SQLite file of others to read it.

    A query of its views that does not end is interrupted (`sqlite3.OperationalError`) after 5 million instructions of
    all queries; no value is longer than 20 MB, and SQLite takes at most 64 MB (`MemoryError`). Its views call no
    function that reaches beyond it.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    """
    import sqlite3  # 2 MB of memory, which a unit without such a file saves

    if not path.is_file():
        raise FileNotFoundError(path)
    database = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True, timeout=1.0)
    turns = iter(range(SQLITE_TURNS))
    database.set_progress_handler(lambda: int(next(turns, None) is None), SQLITE_STEPS)
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, SQLITE_VALUE_BYTES)
    for pragma in ("trusted_schema=OFF", "query_only=ON", "cell_size_check=ON", f"hard_heap_limit={SQLITE_HEAP_BYTES}"):
        database.execute(f"PRAGMA {pragma}")
    return database


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e5 else f"{count} bytes"
