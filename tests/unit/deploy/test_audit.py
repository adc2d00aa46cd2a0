"""What `make audit` says and ends with, for answers of pip-audit and npm as they were observed."""

import json
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from deploy import audit

SOUND = {"dependencies": [{"name": "numpy", "version": "2.4.6", "vulns": []}]}
WEAK = {"dependencies": [{"name": "numpy", "version": "2.4.6",
                          "vulns": [{"id": "PYSEC-1", "fix_versions": ["2.4.7"], "aliases": []}]}]}  # fmt: skip
SKIPPED = {
    "dependencies": [{"name": name, "skip_reason": "Dependency not found"} for name in ("a", "b", "c", "d", "e")]
}
NO_ROUTE = "ERROR:pip_audit._cli:could not connect to the vulnerability service\n"
NOT_ALLOWED = (
    "npm warn audit 405 Method Not Allowed\nnpm error audit endpoint returned an error\nnpm error A complete log"
)


class Answers:
    """Programs that answer what they are told to, and a note of what was started."""

    def __init__(self, pip_audit: object, npm: object, stderr: str = "", *, install: int = 0) -> None:
        self._answers = {"pip-audit": pip_audit, "npm": npm}
        self._stderr, self._install = stderr, install
        self.started: list[str] = []

    def __call__(self, command: Sequence[str], _folder: Path) -> "subprocess.CompletedProcess[str]":
        name = Path(command[0]).name
        self.started.append(" ".join(map(str, command)))
        if name not in self._answers:
            return subprocess.CompletedProcess(command, self._install, "", self._stderr)
        answer = self._answers[name]
        text = answer if isinstance(answer, str) else json.dumps(answer)
        return subprocess.CompletedProcess(command, 0, text, self._stderr)


def npm(*names: str) -> dict[str, object]:
    return {"vulnerabilities": {name: {"severity": "high", "range": "<2"} for name in names}}


def test_nothing_known_ends_with_0(capsys: pytest.CaptureFixture[str]) -> None:
    assert audit.main(Answers(SOUND, npm())) == 0
    assert capsys.readouterr().out == "Python packages: nothing is known\nJavaScript packages: nothing is known\n"


def test_a_known_weakness_is_named_and_ends_with_1(capsys: pytest.CaptureFixture[str]) -> None:
    assert audit.main(Answers(WEAK, npm("uplot"))) == 1
    out = capsys.readouterr().out
    assert "numpy 2.4.6: PYSEC-1, corrected in 2.4.7" in out
    assert "uplot <2: high" in out


@pytest.mark.parametrize("answer", ["", "[]", {"message": "405"}])
def test_a_source_that_cannot_be_reached_is_one_sentence_and_ends_with_2(
    answer: object, capsys: pytest.CaptureFixture[str]
) -> None:
    assert audit.main(Answers(SOUND, answer, NOT_ALLOWED)) == 2
    assert capsys.readouterr().err == (
        "JavaScript packages: the source could not be asked (npm error audit endpoint returned an error); "
        "try again with internet\n"
    )
    assert audit.main(Answers("", npm(), NO_ROUTE)) == 2
    assert "could not connect to the vulnerability service" in capsys.readouterr().err


def test_packages_that_the_source_does_not_know_are_no_clean_result(capsys: pytest.CaptureFixture[str]) -> None:
    assert audit.main(Answers(SKIPPED, npm())) == 2
    assert "it does not know a, b, c and 2 more of 5 packages" in capsys.readouterr().err


def test_a_weakness_counts_more_than_a_source_that_was_not_asked() -> None:
    assert audit.main(Answers(WEAK, "")) == 1
    assert audit.main(Answers("", npm("uplot"))) == 1


def test_a_tool_that_cannot_be_installed_is_one_sentence(tmp_path: Path) -> None:
    answers = Answers(SOUND, npm(), "WARNING: retrying\nERROR: No matching distribution found\n", install=1)
    with pytest.raises(
        audit.SourceUnavailable, match=r"pip-audit==.* could not be installed: ERROR: No matching distribution"
    ):
        audit.python_packages(answers, tmp_path / "audit")


def test_the_tool_is_installed_beside_and_asked_about_the_hashed_lock(tmp_path: Path) -> None:
    answers = Answers(SOUND, npm())
    assert audit.python_packages(answers, tmp_path / "audit") == []
    assert [name.split()[0].rpartition("/")[2] for name in answers.started][1:] == ["python", "pip-audit"]
    assert "--requirement requirements-dev.lock --disable-pip --require-hashes" in answers.started[-1]


def test_a_program_that_is_missing_is_not_asked(tmp_path: Path) -> None:
    with pytest.raises(audit.SourceUnavailable, match="cannot be started: No such file"):
        audit.run([str(tmp_path / "npm")], tmp_path)
