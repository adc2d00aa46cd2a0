"""The trail on disk gives back what it was given, from the end, and forgets what it is told to forget."""

from pathlib import Path

import pytest

from cli.solve import history_file
from services.core.fusion.smoothing.history import Start
from shared.errors import UserError


def stamps(records: history_file.Spool) -> list[int]:
    return [record.time_ns for record in records.newest_first()]


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(history_file, "CHUNK", 10)


def test_it_gives_everything_back_from_the_end(tmp_path: Path) -> None:
    with history_file.Spool(tmp_path) as records:
        for k in range(57):
            records.push(Start(k))
        assert len(records) == 57
        assert stamps(records) == list(reversed(range(57)))
        assert stamps(records) == list(reversed(range(57))), "as often as it is asked"


@pytest.mark.parametrize("count", [57, 51, 42, 41, 40, 13, 1, 0])
def test_it_forgets_across_what_is_on_disk_and_goes_on(tmp_path: Path, count: int) -> None:
    with history_file.Spool(tmp_path) as records:
        for k in range(57):
            records.push(Start(k))
        records.cut(count)
        assert stamps(records) == list(reversed(range(count)))
        for k in range(100, 145):
            records.push(Start(k))
        assert stamps(records) == [*reversed(range(100, 145)), *reversed(range(count))]


def test_it_leaves_no_file_behind(tmp_path: Path) -> None:
    with history_file.Spool(tmp_path) as records:
        for k in range(100):
            records.push(Start(k))
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="choose another folder with --out"):
        history_file.Spool(tmp_path / "missing")
