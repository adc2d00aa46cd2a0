"""What a command tells its starter, beside what it prints."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from shared.runtime import reports
from shared.runtime.reports import MAXIMUM_BYTES, VARIABLE, Report, begin, read_report, tell
from tests.support.data import REPOSITORY


def ended(folder: Path, *words: str) -> tuple[int, Report]:
    path = folder / "report.json"
    environment = {**os.environ, VARIABLE: str(path), "OBU_STATE": str(folder)}
    command = [sys.executable, "-m", "cli", *words]
    code = subprocess.run(command, env=environment, cwd=REPOSITORY, check=False, capture_output=True).returncode
    return code, read_report(path)


@pytest.mark.parametrize(
    ("words", "code", "part"),
    [
        (("verify", "missing.mcap"), 2, "missing.mcap"),
        (("verify", "--nonsense"), 2, "--nonsense"),
        (("verify", "tests/golden/releases/0_1_0_turned_imu.mcap", "--signatures"), 3, ""),
    ],
    ids=["an error", "a wrong option", "a finding"],
)
def test_a_command_tells_why_it_failed_or_what_it_found(
    tmp_path: Path, words: tuple[str, ...], code: int, part: str
) -> None:
    found, report = ended(tmp_path, *words)
    assert found == code
    assert part in report.error and bool(report.error) is bool(part)
    assert bool(report.finding) is not bool(part)


@pytest.mark.parametrize(
    "content", [None, b"", b"\xff", b"[]", b'{"port": "80"}', b'{"error": "' + b"x" * MAXIMUM_BYTES + b'"}'], ids=str
)
def test_what_is_no_report_is_an_empty_one(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "report.json"
    if content is not None:
        path.write_bytes(content)
    assert read_report(path) == Report()


def test_children_of_a_command_do_not_write_its_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reports._Place, "path", None)
    tell(error="no file is named")
    monkeypatch.setenv(VARIABLE, str(tmp_path / "report.json"))
    begin()
    assert VARIABLE not in os.environ
    tell(port=8080, error="x" * 5000)
    assert read_report(tmp_path / "report.json") == Report(port=8080, error="x" * 1000)
