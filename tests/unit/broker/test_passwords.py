"""Mosquitto's password file as we write and read it, against Mosquitto's own program."""

import shutil
import subprocess
from pathlib import Path

import pytest

from broker.passwords import Passwords, PasswordsError, line, password_file
from tests.support.cases import each

SECRET = "0123456789abcdef" * 4


def test_a_secret_matches_its_name_alone() -> None:
    known = Passwords(password_file({"core.fusion": SECRET, "core.trust": SECRET[::-1]}))
    for _ in range(2):  # an answer changes nothing
        assert known.matches("core.fusion", SECRET)
        assert known.matches("core.trust", SECRET[::-1])
        assert not known.matches("core.fusion", SECRET[::-1])
        assert not known.matches("core.fusion", SECRET[:-1])
        assert not known.matches("core.fusion", None)
        assert not known.matches("", SECRET)
        assert not known.matches(None, SECRET)


def test_what_still_holds_is_not_written_anew() -> None:
    before = password_file({"a": "1", "b": "2"})
    after = password_file({"b": "2", "a": "other", "c": "3"}, before)
    assert before.splitlines()[1] in after.splitlines()
    assert before.splitlines()[0] not in after.splitlines()
    assert [row.split(":")[0] for row in after.splitlines()] == ["b", "a", "c"]
    assert password_file({"a": "1"}, "no password file").startswith("a:$7$")


@each(
    "row",
    ["a", "a:", "a:plain", "a:$6$1$c2FsdA==$aGFzaA==", "a:$7$0$c2FsdA==$aGFzaA==", "a:$7$x$c2FsdA==$aGFzaA==",
     "a:$7$101$c2FsdA==$aGFzaA==", "a:$7$99999999$c2FsdA==$" + 86 * "A" + "==", "a:$7$101$?$" + 86 * "A" + "=="],
)  # fmt: skip
def test_a_line_that_is_no_password_is_named(row: str) -> None:
    with pytest.raises(PasswordsError, match="line 2"):
        Passwords(line("b", "1") + row + "\n")


@pytest.mark.broker
def test_lines_of_mosquittos_own_program_are_read(tmp_path: Path) -> None:
    program = shutil.which("mosquitto_passwd")
    if program is None:
        pytest.skip("no mosquitto_passwd on this machine: `apt install mosquitto` brings it")
    path = tmp_path / "passwords"
    subprocess.run([program, "-b", "-c", str(path), "core.fusion", SECRET], check=True, capture_output=True)
    known = Passwords(path.read_text())
    assert known.matches("core.fusion", SECRET) and not known.matches("core.fusion", "other")
