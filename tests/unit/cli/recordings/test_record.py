import random
from pathlib import Path

import pytest
from mcap.reader import make_reader

from cli.recordings.common import open_recording
from cli.recordings.record import repair
from shared import VERSION
from shared.bus.bus import Envelope
from shared.errors import UserError
from shared.recording import Recording, RecordingWriter
from tests.support.bus.envelopes import sent_bytes

START_NS = 1_790_000_000_000_000_000


def cut_recording(path: Path, lost_bytes: int = 40) -> list[Envelope]:
    messages = [
        sent_bytes("mode/state", b'{"k":%d}' % k, START_NS + k, "controller.mode", START_NS, k) for k in range(90)
    ]
    writer = RecordingWriter(path, vehicle="car", vehicle_toml="[vehicle]\n", provenance={"device": "x"})
    for k, envelope in enumerate(messages):
        writer.write(envelope)
        if k % 30 == 29:
            writer.flush()
    writer.abandon()
    path.write_bytes(path.read_bytes()[:-lost_bytes])
    return messages


def test_a_repaired_recording_is_opened_by_the_mcap_reader(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    messages = cut_recording(tmp_path / "cut.mcap", lost_bytes=900)

    assert repair(tmp_path / "cut.mcap", tmp_path / "whole.mcap") == 0

    with (tmp_path / "whole.mcap").open("rb") as file:
        assert sum(1 for _ in make_reader(file).iter_messages()) == 60
    with Recording(tmp_path / "whole.mcap") as recording:
        assert list(recording) == messages[:60]
        assert recording.problems == []
        assert recording.attachments == {"vehicle.toml": b"[vehicle]\n"}
        assert recording.metadata == {"obu": {"vehicle": "car", "version": VERSION}, "provenance": {"device": "x"}}
    captured = capsys.readouterr()
    assert captured.out.startswith("wrote 60 messages")
    assert "the recording was not closed" in captured.err


def test_a_repair_does_not_overwrite_a_file(tmp_path: Path) -> None:
    cut_recording(tmp_path / "cut.mcap")
    with pytest.raises(UserError, match=r"cut\.mcap exists already; name another"):
        repair(tmp_path / "cut.mcap", tmp_path / "cut.mcap")


def test_a_file_without_messages_is_an_error_and_no_output_is_left(tmp_path: Path) -> None:
    RecordingWriter(tmp_path / "silent.mcap").close()
    with pytest.raises(UserError, match="holds no message that can be read"):
        repair(tmp_path / "silent.mcap", tmp_path / "whole.mcap")
    assert not (tmp_path / "whole.mcap").exists()


def test_an_unwritable_folder_is_reported(tmp_path: Path) -> None:
    cut_recording(tmp_path / "cut.mcap")
    with pytest.raises(UserError, match=r"cannot create .*: No such file or directory"):
        repair(tmp_path / "cut.mcap", tmp_path / "no" / "such" / "folder.mcap")


def test_a_file_that_is_no_recording_is_reported_as_such(tmp_path: Path) -> None:
    (tmp_path / "noise.mcap").write_bytes(random.Random(1).randbytes(100_000))
    with pytest.raises(UserError, match=r"noise\.mcap is no recording, not even a damaged one; .*`obu import`"):
        open_recording(tmp_path / "noise.mcap")


def test_a_recording_without_its_beginning_is_repaired(tmp_path: Path) -> None:
    messages = cut_recording(tmp_path / "cut.mcap")
    (tmp_path / "cut.mcap").write_bytes((tmp_path / "cut.mcap").read_bytes()[20:])
    with open_recording(tmp_path / "cut.mcap") as recording:
        assert list(recording)[:60] == messages[:60]
