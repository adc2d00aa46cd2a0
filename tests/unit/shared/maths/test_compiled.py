"""Machine code of the version in use is kept, however many other trees are compiled on the same machine."""

import os
from pathlib import Path

import pytest

from shared.maths.compiled import MAX_VERSIONS, machine_code


def test_the_version_in_use_outlives_many_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    used = machine_code()
    os.utime(used, ns=(0, 0))
    others = [used.with_name(f"{k:016x}") for k in range(MAX_VERSIONS)]
    for k, other in enumerate(others):
        other.mkdir()
        os.utime(other, ns=(k + 1, k + 1))
    assert machine_code() == used and used.is_dir(), "it was used last"
    assert [other for other in others if not other.is_dir()] == others[:1], "the one that was not used for longest"


def test_without_a_folder_that_can_be_written_it_is_kept_for_one_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert machine_code().is_dir() and machine_code() != machine_code()
