"""The recordings of a unit: what cannot be read, and jobs that cannot start, say so."""

import os
from pathlib import Path

import httpx
import pytest

from shared.library.library import Library
from shared.library.order import write_order
from shared.library.summary import SUFFIX, SummaryWorker
from shared.recording.summary import write_summary
from tests.support.dashboard.status_server import change, eventually, status_server
from tests.support.drives.meridian import record
from tests.support.patience import HANGS_S

NAME = "20231114T221320Z_car.mcap"


def old(path: Path) -> Path:
    """Make a file look settled."""
    os.utime(path, (0, 0))
    return path


def test_a_recording_without_a_summary_to_come_is_said_to_be_unreadable(tmp_path: Path) -> None:
    (tmp_path / NAME).write_bytes(b"this is no recording")
    old(tmp_path / NAME)
    library = Library(tmp_path)
    library.look(None)
    library.look(None)
    assert not library.entries[NAME].failed, "while it is being computed nothing is known"

    def failed() -> bool:
        library.look(None)
        return library.entries[NAME].failed

    eventually(failed)


def test_a_job_that_cannot_start_is_answered_with_the_reason_and_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()
    (tmp_path / "jobs").write_text("a file where the folder of the jobs should be")
    drive = record(tmp_path / "recordings" / NAME, 5)
    write_summary(drive, drive.with_name(NAME + SUFFIX))
    with status_server(tmp_path, unit=False, recordings=["solve"]) as server:
        url = f"{server.address}/api/recordings"
        eventually(lambda: httpx.get(url, timeout=HANGS_S).json()["recordings"])
        answer = change(server.address, "/api/recordings", {"action": "solve", "name": NAME})
    assert answer.status_code == 503
    assert answer.json()["detail"] == "it cannot start: File exists; make room, for example by deleting a recording"


@pytest.mark.parametrize("known", [True, False])
def test_a_summary_beside_the_recording_is_not_computed_again(tmp_path: Path, known: bool) -> None:
    drive = record(tmp_path / NAME, 5)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    if known:
        write_summary(drive, drive.with_name(NAME + SUFFIX))
    worker = SummaryWorker(drive, elsewhere)
    assert worker.running is not known
    worker.wait(HANGS_S)
    assert worker.result() is not None
    assert bool(list(elsewhere.iterdir())) is not known


def test_recordings_are_listed_by_their_order_of_making_and_the_newest_never_fall_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shared.library.library.MAX_LISTED", 3)
    made = ["20300101T000000Z_car.mcap", "20260101T000000Z_car_9.mcap", "20260101T000000Z_car_10.mcap", "1970.mcap"]
    for name in made:
        (tmp_path / name).write_bytes(b"x")
    write_order(tmp_path, made)
    (tmp_path / "dangling.mcap").symlink_to("nowhere")
    (tmp_path / "folder.mcap").mkdir()
    library = Library(tmp_path)
    library.look(made[-1])
    library.stop()
    assert list(library.entries) == made[:0:-1], "the newest first"


def test_without_a_stored_order_numbers_in_names_count_as_numbers(tmp_path: Path) -> None:
    for name in ("a_10.mcap", "a_2.mcap", "a.mcap"):
        (tmp_path / name).write_bytes(b"x")
    library = Library(tmp_path)
    library.look("a_10.mcap")
    library.stop()
    assert list(library.entries) == ["a_10.mcap", "a_2.mcap", "a.mcap"]
