"""Many recordings by one command, on a real Dask cluster of this machine."""

import json
import os
import shutil
import signal
from pathlib import Path

import pytest

from cli.campaign import Job, code_of, in_executor
from cli.fleet.run import MODULES, Command, CommandOutcome, cluster, run, work_on
from shared.errors import UserError
from shared.evidence import KeyFile, Outcome
from shared.evidence.outcome import OTHER_RELEASE
from tests.unit.shared.recording.test_proof import drive, record

ROOT = Path(__file__).parents[4]
RECORDING = ROOT / "tests" / "golden" / "releases" / "0_1_0_turned_imu.mcap"


@pytest.fixture(autouse=True)
def _own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OBU_STATE", str(tmp_path / "state"))


def once_killed(number: int, folder: str) -> int:
    """Kill the worker at the first try of each third job, and give the square."""
    marker = Path(folder) / str(number)
    if number % 3 == 0 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def test_a_killed_worker_costs_nothing(tmp_path: Path) -> None:
    jobs = {number: Job(str(number), once_killed, (number, str(tmp_path))) for number in range(12)}
    with cluster(None, 2) as client:
        results = in_executor(jobs, client.get_executor())  # type: ignore[no-untyped-call]
        found = dict(results)
        assert found == {number: number**2 for number in range(12)}


def ask(command: Command, *recordings: Path, out: Path, fresh: bool = False) -> tuple[int, list[dict[str, object]]]:
    options = ["--signatures"] if command is Command.VERIFY else []
    code = run(command, list(recordings), out=out, option=options, scheduler=None, jobs=1, fresh=fresh)
    return code, json.loads((out / "summary.json").read_text())


def test_a_copy_is_done_once_and_what_is_done_is_not_done_again(tmp_path: Path) -> None:
    drives, out = tmp_path / "drives", tmp_path / "out"
    drives.mkdir()
    shutil.copy(RECORDING, drives / "a.mcap")
    shutil.copy(RECORDING, drives / "copy.mcap")
    code, first = ask(Command.VERIFY, drives, out=out)
    assert code == 0
    assert [(row["recording"], row["command"]) for row in first] == [(str(drives / "a.mcap"), "verify")]
    assert Path(str(first[0]["out"]), "output.txt").read_text() != ""
    shutil.move(drives / "a.mcap", drives / "moved.mcap")
    assert ask(Command.VERIFY, drives, out=out) == (0, first)


def test_a_recording_that_cannot_be_used_leaves_the_others_alone(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"nothing")
    code, rows = ask(Command.VERIFY, bad, RECORDING, out=tmp_path / "out")
    assert code == 1
    assert [row["recording"] for row in rows] == [str(RECORDING)]
    assert "bad.mcap failed" in capfd.readouterr().err


def test_a_worker_of_another_version_does_nothing(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="another version"):
        work_on(str(RECORDING), "0", "verify", (), str(tmp_path), "of before")


@pytest.mark.parametrize("what", ["missing.mcap", "empty"])
def test_what_is_no_recording_is_said_before_anything_starts(tmp_path: Path, what: str) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(UserError, match=r"check the name|obu record"):
        run(Command.SOLVE, [tmp_path / what], out=tmp_path / "out", option=None, scheduler=None, jobs=1, fresh=False)


def test_a_folder_that_cannot_be_made_is_said_before_anything_starts(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=r"cannot write to .*file/out: Not a directory; name another folder with --out"):
        ask(Command.VERIFY, RECORDING, out=tmp_path / "file" / "out")


def done(command: Command, to: Path, recording: Path, *words: str) -> CommandOutcome:
    return work_on(str(recording), "", command, words, str(to), code_of(MODULES[command]))


def test_what_a_recording_is_verified_as_says_why_the_code_is_not_0(tmp_path: Path) -> None:
    signed = record(tmp_path / "foreign.mcap", drive(20), KeyFile(tmp_path / "other").signer())
    foreign = done(Command.VERIFY, tmp_path / "out", signed, "--signatures")
    assert foreign.code == Outcome.FOREIGN
    assert foreign.said.startswith("signed by key ") and "not among the accepted ones" in foreign.said


def test_what_another_release_has_made_is_said_with_its_own_code(tmp_path: Path) -> None:
    verified = done(Command.VERIFY, tmp_path / "out", RECORDING)
    assert verified.code == OTHER_RELEASE
    assert "version 0.1.0 or earlier" in verified.said


@pytest.mark.slow
def test_what_was_solved_and_attacked_is_a_sentence_and_no_path(tmp_path: Path) -> None:
    solved = done(Command.SOLVE, tmp_path / "solved", RECORDING)
    assert solved.said == json.loads((tmp_path / "solved" / "metrics.json").read_text())["verdict"]
    attacked = done(Command.ATTACK_LAB, tmp_path / "attacked", RECORDING, "--attack", "position_jump@10:10")
    assert attacked.said == "0 of 1 attacks detected"


def test_a_wrong_option_is_named_without_the_frame_around_it(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"^No such option: --nonsense \(code 2;"):
        work_on(str(RECORDING), "", Command.SOLVE, ("--nonsense",), str(tmp_path), code_of(MODULES[Command.SOLVE]))
