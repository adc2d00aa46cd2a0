"""The summary of a drive with a known track."""

import itertools
from pathlib import Path

import pytest

from shared.errors import BadRecording
from shared.library.summary import SUFFIX, SummaryWorker, read_summary
from shared.recording import RecordingWriter
from shared.recording.summary import POINTS, summarise, write_summary
from tests.support.drives.meridian import BEGIN_NS, NORTH_M_S, SECOND, record
from tests.support.patience import HANGS_S


def test_a_summary_has_the_course_of_the_drive(tmp_path: Path) -> None:
    summary = summarise(record(tmp_path / "drive.mcap", 300))
    assert (summary.begin_ns, summary.end_ns) == (BEGIN_NS, BEGIN_NS + 300 * SECOND - SECOND // 10)
    assert summary.distance_m == pytest.approx(299 * NORTH_M_S, rel=1e-3)
    assert [(c.state, (c.since_ns - BEGIN_NS) / SECOND) for c in summary.trust[:3]] == [
        ("safe", 0.0),
        ("unsafe", 20.0),
        ("safe", 40.0),
    ]
    assert [outage.what for outage in summary.outages] == ["sensors.imu"]
    assert (summary.vehicle, summary.origin, summary.solved) == ("car", "simulated", True)


def test_the_outline_has_few_points_evenly_spaced_with_both_ends(tmp_path: Path) -> None:
    track = summarise(record(tmp_path / "drive.mcap", 300)).track
    steps = [b[0] - a[0] for a, b in itertools.pairwise(track)]
    assert len(track) == POINTS
    assert max(steps) < 2.1 * min(steps), "positions are a second apart, and chosen ones about three"
    assert track[-1][0] - track[0][0] == pytest.approx(299 * NORTH_M_S / 111_194.9, rel=1e-6)


def test_a_recording_that_was_not_closed_has_the_same_summary(tmp_path: Path) -> None:
    whole = summarise(record(tmp_path / "whole.mcap", 30))
    cut = summarise(record(tmp_path / "cut.mcap", 30, close=False))
    assert cut.model_copy(update={"size_bytes": whole.size_bytes}) == whole


def test_a_recording_without_a_message_has_none(tmp_path: Path) -> None:
    RecordingWriter(tmp_path / "empty.mcap").close()
    with pytest.raises(BadRecording, match="holds no message"):
        summarise(tmp_path / "empty.mcap")


def test_a_stored_summary_is_valid_for_the_stored_file_size_only(tmp_path: Path) -> None:
    drive, output = record(tmp_path / "drive.mcap", 10), tmp_path / "summary.json"
    write_summary(drive, output)
    size = drive.stat().st_size
    assert read_summary(output, size) == summarise(drive)
    assert read_summary(output, size + 1) is None
    output.write_text("{")
    assert read_summary(output, size) is None


def test_a_worker_computes_a_summary_once(tmp_path: Path) -> None:
    drive = record(tmp_path / "drive.mcap", 10)
    worker = SummaryWorker(drive, tmp_path)
    worker.wait(HANGS_S)
    assert worker.result() == summarise(drive)
    stamp = (tmp_path / f"drive.mcap{SUFFIX}").stat().st_mtime_ns
    again = SummaryWorker(drive, tmp_path)
    assert not again.running
    assert again.result() is not None and (tmp_path / f"drive.mcap{SUFFIX}").stat().st_mtime_ns == stamp
