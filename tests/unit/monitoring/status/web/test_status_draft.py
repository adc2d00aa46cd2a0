"""Drafts of mappings over the web: by the command, of bytes of a stranger."""

import tempfile
import threading
from pathlib import Path

import pytest
from fastapi import HTTPException

from cli.import_drive.mapping.mapping import parse_mapping
from services.monitoring.status.web import draft
from services.monitoring.status.web.draft import DraftApi, MappingDraft, _drafted
from tests.support.cases import each

HEADER = "time,lat,lon,alt,speed_kmh\n"
ROWS = "".join(f"{1_700_000_000 + s},{48.1 + s * 1e-4:.6f},11.500000,520.0,{40 + s % 3}\n" for s in range(80))


def test_a_table_becomes_a_mapping_that_is_one() -> None:
    found = _drafted("drive of mine.csv", (HEADER + ROWS).encode())
    assert found["name"] == "drive-of-mine.toml" and parse_mapping(found["toml"], "the draft")
    assert "guessed:" in found["text"] and tempfile.gettempdir() not in found["text"] + found["toml"]


@each("name", ["../../etc/passwd", "C:\\drive.csv", "/abs/x.csv", "...", "x.toml", "-o", ""])
def test_a_name_stays_in_its_folder(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    found = _drafted(name, (HEADER + ROWS).encode())
    assert "/" not in found["name"] and not found["name"].startswith((".", "-"))
    assert not list(tmp_path.iterdir())


@each("data", [b"", b"\x00\xff" * 500, b"a,b\n1,2\n3,4\n", (HEADER + "x" * 3000).encode()])
def test_what_is_no_table_with_a_position_is_refused_in_words(data: bytes) -> None:
    with pytest.raises(HTTPException) as refused:
        _drafted("x.csv", data)
    assert refused.value.status_code == 422 and "x.csv" in refused.value.detail
    assert tempfile.gettempdir() not in refused.value.detail


def test_two_at_once_are_one_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    begun, go_on, api = threading.Event(), threading.Event(), DraftApi()

    def fails(_name: str, _beginning: bytes) -> None:
        begun.set()
        go_on.wait()
        raise HTTPException(422, "no table")

    def first() -> None:
        with pytest.raises(HTTPException, match="no table"):
            api.drafted("x.csv", b"")

    monkeypatch.setattr(draft, "_drafted", fails)
    thread = threading.Thread(target=first)
    thread.start()
    begun.wait()
    with pytest.raises(HTTPException) as refused:
        api.drafted("y.csv", b"")
    go_on.set()
    thread.join()
    assert refused.value.status_code == 409
    done: MappingDraft = {"name": "z.toml", "toml": "", "text": ""}
    monkeypatch.setattr(draft, "_drafted", lambda _name, _beginning: done)
    assert api.drafted("z.csv", b"") == done, "after one that failed too"
