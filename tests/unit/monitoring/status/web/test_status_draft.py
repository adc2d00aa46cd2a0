"""Drafts of mappings over the web: by the command, of bytes of a stranger."""

import tempfile
from pathlib import Path

import pytest
from fastapi import HTTPException

from cli.import_drive.mapping.mapping import parse_mapping
from services.monitoring.status.web.draft import _drafted
from tests.support.cases import each

HEADER = "time,lat,lon,alt,speed_kmh\n"
ROWS = "".join(f"{1_700_000_000 + s},{48.1 + s * 1e-4:.6f},11.500000,520.0,{40 + s % 3}\n" for s in range(80))


def test_a_table_becomes_a_mapping_that_is_one() -> None:
    found = _drafted("drive of mine.csv", (HEADER + ROWS).encode())
    assert found["name"] == "drive-of-mine.toml" and parse_mapping(found["toml"], "the draft")
    assert "guessed:" in found["text"] and tempfile.gettempdir() not in found["text"] + found["toml"]


@each("name", ["../../etc/passwd", "C:\\drive.csv", "/abs/x.csv", "...", "x.toml", "-o", ""])
def test_a_name_stays_in_its_folder(name: str, tmp_path: Path) -> None:
    before = set(Path(tempfile.gettempdir()).glob("obu-draft-*"))
    found = _drafted(name, (HEADER + ROWS).encode())
    assert "/" not in found["name"] and not found["name"].startswith((".", "-"))
    assert set(Path(tempfile.gettempdir()).glob("obu-draft-*")) <= before


@each("data", [b"", b"\x00\xff" * 500, b"a,b\n1,2\n3,4\n", (HEADER + "x" * 3000).encode()])
def test_what_is_no_table_with_a_position_is_refused_in_words(data: bytes) -> None:
    with pytest.raises(HTTPException) as refused:
        _drafted("x.csv", data)
    assert refused.value.status_code == 422 and "x.csv" in refused.value.detail
    assert tempfile.gettempdir() not in refused.value.detail
