import sys
from pathlib import Path

import pytest

from shared import compiling
from shared.compiling import compiled
from shared.maths import earth, rotation


def test_without_numba_there_is_nothing_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)
    assert compiled(earth.wrap_angle, [], {}) is None


def test_the_cache_is_another_one_for_other_sources(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    one = compiling._cache_folder(earth.wrap_angle, earth.gravity)
    both = compiling._cache_folder(earth.wrap_angle, rotation.skew)
    assert one is not None and both is not None and one != both
    assert one == compiling._cache_folder(earth.gravity), "the files count, not the functions"
    assert one.is_dir() and tmp_path in one.parents


def test_a_place_that_cannot_be_written_is_no_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    assert compiling._cache_folder(earth.gravity) is None
