"""Random access to a recording against a reading of all of it."""

from pathlib import Path

import pytest

from shared.errors import BadRecording
from shared.recording import Recording
from shared.recording.index import RecordingIndex
from tests.support.drives.meridian import BEGIN_NS, SECOND, record


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("drive") / "drive.mcap", 60)


@pytest.mark.parametrize("at_s", [-1.0, 0.0, 0.05, 17.35, 59.9, 1000.0])
def test_the_newest_message_of_each_topic_equals_that_of_a_full_read(drive: Path, at_s: float) -> None:
    at_ns = BEGIN_NS + round(at_s * SECOND)
    with Recording(drive) as recording:
        wanted = {e.topic: e.payload for e in recording if e.received_ns <= at_ns}
        found = {e.topic: e.payload for e in RecordingIndex(recording).newest(at_ns)}
    assert found == wanted


@pytest.mark.parametrize(("after_s", "until_s"), [(-1.0, 0.0), (3.0, 3.1), (12.04, 31.77), (59.0, 99.0), (5.0, 5.0)])
def test_a_span_equals_that_of_a_full_read(drive: Path, after_s: float, until_s: float) -> None:
    after_ns, until_ns = (BEGIN_NS + round(s * SECOND) for s in (after_s, until_s))
    with Recording(drive) as recording:
        everything = [e for e in recording if after_ns < e.received_ns <= until_ns]
        index = RecordingIndex(recording)
        assert list(index.between(after_ns, until_ns)) == everything
        fixes = [e for e in everything if e.topic == "gnss/fix"]
        assert list(index.between(after_ns, until_ns, ("gnss/fix",))) == fixes


def test_extent_and_topics_are_those_of_the_messages(drive: Path) -> None:
    with Recording(drive) as recording:
        index, stamps = RecordingIndex(recording), [e.received_ns for e in recording]
        assert (index.begin_ns, index.end_ns) == (min(stamps), max(stamps))
        assert index.topics == {e.topic for e in recording} == recording.topics
        assert len(index.chunks) > 10, "the drive is long enough to have an index worth the name"


def test_a_recording_that_was_not_closed_has_no_index(tmp_path: Path) -> None:
    with Recording(record(tmp_path / "cut.mcap", 5, close=False)) as recording:
        assert not recording.topics
        with pytest.raises(BadRecording, match="was not closed"):
            RecordingIndex(recording)
