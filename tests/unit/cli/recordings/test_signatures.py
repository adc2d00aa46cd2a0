"""`obu verify` names what happened to a recording by its exit code, and `obu evidence-key` manages the keys."""

from collections.abc import Sequence
from pathlib import Path

import pytest
from mcap.writer import CompressionType

from cli.evidence_key import accepted_keys, export, rotate, show
from cli.recordings.record import repair
from cli.recordings.verify import verify
from shared.errors import UserError
from shared.evidence import KeyFile, Outcome, keys_folder
from shared.recording import RecordingWriter
from shared.recording.folder import RecordingFolder
from tests.support.rewritten import rewrite
from tests.unit.shared.recording.test_proof import drive, record
from tests.unit.shared.recording.test_recording import START_NS


def check_signatures(files: Sequence[Path], keys: list[Path] | None) -> int:
    return verify(list(files), key=keys, signatures=True)


@pytest.fixture(autouse=True)
def key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> KeyFile:
    monkeypatch.setenv("OBU_STATE", str(tmp_path / "state"))
    monkeypatch.delenv("OBU_KEYS", raising=False)
    return KeyFile(keys_folder(tmp_path / "state"))


def changed(path: Path, to: Path, begin: int, data: bytes) -> Path:
    content = bytearray(path.read_bytes())
    content[begin : begin + len(data)] = data
    to.write_bytes(content)
    return to


def test_each_outcome_has_an_exit_code(tmp_path: Path, key: KeyFile) -> None:
    good = record(tmp_path / "good.mcap", drive(1100), key.signer())
    cut = record(tmp_path / "cut.mcap", drive(1100), key.signer(), close=False)
    unsigned = tmp_path / "old.mcap"
    writer = RecordingWriter(unsigned, vehicle="car")
    writer.write(drive(1)[0])
    writer.close()
    edited = changed(good, tmp_path / "edited.mcap", 3000, b"xx")
    foreign = record(tmp_path / "foreign.mcap", drive(20), KeyFile(tmp_path / "other").signer())
    rewrite(good, tmp_path / "packed.mcap", CompressionType.LZ4)
    repair(cut, tmp_path / "repaired.mcap")
    repair(unsigned, tmp_path / "old-repaired.mcap")

    codes = {
        path.name: verify([path], None, None, signatures=True)
        for path in (good, unsigned, cut, edited, foreign, *(tmp_path / f"{n}.mcap" for n in
                     ("packed", "repaired", "old-repaired")))
    }  # fmt: skip

    assert codes == {
        "good.mcap": 0, "old.mcap": 3, "cut.mcap": 4, "edited.mcap": 5, "foreign.mcap": 6, "packed.mcap": 7,
        "repaired.mcap": 7, "old-repaired.mcap": 3,
    }  # fmt: skip


def test_the_gravest_file_decides(tmp_path: Path, key: KeyFile) -> None:
    good = record(tmp_path / "good.mcap", drive(20), key.signer())
    cut = record(tmp_path / "cut.mcap", drive(20), key.signer(), close=False)
    edited = changed(good, tmp_path / "edited.mcap", 3000, b"xx")
    assert check_signatures([good, cut], None) == Outcome.CUT
    assert check_signatures([edited, cut, good], None) == Outcome.EDITED


def test_the_line_of_a_file_says_whose_it_is(tmp_path: Path, key: KeyFile, capsys: pytest.CaptureFixture[str]) -> None:
    check_signatures([record(tmp_path / "a.mcap", drive(20), key.signer())], None)
    first, second = capsys.readouterr().out.splitlines()
    assert first == "a.mcap: verified: 21 messages until 2026-09-21 14:13:20 UTC"
    assert second == (f"  vehicle car, origin simulated, begun 2026-09-21 14:13:20 UTC, key {key.signer().key_id}")


def test_a_missing_file_between_two_of_a_recorder_is_named(
    tmp_path: Path, key: KeyFile, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = RecordingFolder(tmp_path / "drives", signer=key.signer)
    folder.stored()
    for number in range(3):
        folder.open(f"{number}", vehicle="car", vehicle_toml="", chunk_bytes=4096, now_ns=START_NS)
        folder.write(drive(20))
        folder.close()
    files = [tmp_path / "drives" / f"{number}.mcap" for number in range(3)]
    assert check_signatures(files, None) == Outcome.VERIFIED
    assert check_signatures([files[0], files[2]], None) == Outcome.EDITED
    assert "a recording is missing" in capsys.readouterr().out


def test_a_public_key_is_enough_to_verify_elsewhere(
    tmp_path: Path, key: KeyFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = record(tmp_path / "a.mcap", drive(20), key.signer())
    assert export(tmp_path / "car.pub") == 0
    monkeypatch.setenv("OBU_STATE", str(tmp_path / "elsewhere"))
    assert check_signatures([path], None) == Outcome.FOREIGN
    assert check_signatures([path], [tmp_path / "car.pub"]) == Outcome.VERIFIED
    assert not (tmp_path / "elsewhere").exists()


def test_given_keys_replace_those_of_this_unit(tmp_path: Path, key: KeyFile) -> None:
    path = record(tmp_path / "a.mcap", drive(20), key.signer())
    other = KeyFile(tmp_path / "other")
    other.signer()
    assert check_signatures([path], [tmp_path / "other" / "ring.json"]) == Outcome.FOREIGN


def test_rotation_is_shown_and_the_old_key_stays_accepted(
    tmp_path: Path, key: KeyFile, capsys: pytest.CaptureFixture[str]
) -> None:
    old = key.signer().key_id
    assert rotate() == 0
    assert show() == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith(old) and "until" in line for line in lines)
    assert sum("signs now" in line for line in lines) == 1
    assert len(accepted_keys(None).keys) == 2
    assert accepted_keys(None).find(old) is not None
    assert check_signatures([record(tmp_path / "a.mcap", drive(20), key.signer())], None) == Outcome.VERIFIED


def test_key_files_that_hold_none_are_user_errors(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"cannot read .*gone\.pub"):
        accepted_keys([tmp_path / "gone.pub"])
    (tmp_path / "text.pub").write_text("text")
    with pytest.raises(UserError, match="obu evidence-key export"):
        accepted_keys([tmp_path / "text.pub"])
