"""The history file is a stack on disk: push, cut, and iteration from the newest record."""

from pathlib import Path

import pytest

from cli.solve import history_file
from services.core.fusion.smoothing.history import Start
from shared.errors import UserError


def stamps(records: history_file.HistoryFile) -> list[int]:
    return [record.time_ns for record in records.newest_first()]


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(history_file, "CHUNK", 10)


def test_all_records_are_returned_newest_first(tmp_path: Path) -> None:
    with history_file.HistoryFile(tmp_path) as records:
        for k in range(57):
            records.push(Start(k))
        assert len(records) == 57
        assert stamps(records) == list(reversed(range(57)))
        assert stamps(records) == list(reversed(range(57))), "on each call"


@pytest.mark.parametrize("count", [57, 51, 42, 41, 40, 13, 1, 0])
def test_cut_removes_records_on_disk_and_push_continues(tmp_path: Path, count: int) -> None:
    with history_file.HistoryFile(tmp_path) as records:
        for k in range(57):
            records.push(Start(k))
        records.cut(count)
        assert stamps(records) == list(reversed(range(count)))
        for k in range(100, 145):
            records.push(Start(k))
        assert stamps(records) == [*reversed(range(100, 145)), *reversed(range(count))]


def test_the_temporary_file_is_removed(tmp_path: Path) -> None:
    with history_file.HistoryFile(tmp_path) as records:
        for k in range(100):
            records.push(Start(k))
    assert not list(tmp_path.iterdir())


def test_an_unwritable_folder_is_reported_with_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="choose another folder with --out"):
        history_file.HistoryFile(tmp_path / "missing")
