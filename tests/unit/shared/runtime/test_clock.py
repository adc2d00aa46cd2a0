"""The offset of the time line: set once a boot by the first process."""

import os
import threading
from pathlib import Path

import pytest

from shared.errors import UserError
from shared.runtime import clock


def test_processes_that_start_together_agree_on_the_offset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getpid", lambda: 1)  # as in containers
    for round_ in range(30):
        folder = tmp_path / str(round_)
        folder.mkdir()
        agreed: list[int] = []
        start = threading.Barrier(8)

        def ask(folder: Path = folder, agreed: list[int] = agreed, start: threading.Barrier = start) -> None:
            start.wait()
            agreed.append(clock.fixed_offset_ns(folder))

        threads = [threading.Thread(target=ask) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(agreed) == 8 and len(set(agreed)) == 1
        assert [path.name for path in folder.iterdir()] == [f"clock-{clock.boot_id()}"]


def test_the_offset_of_an_earlier_boot_is_not_used(tmp_path: Path) -> None:
    (tmp_path / "clock-of-another-boot").write_text("1")
    clock.fixed_offset_ns(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [f"clock-{clock.boot_id()}"]


def test_an_agreed_offset_is_read_without_writing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    offset = clock.fixed_offset_ns(tmp_path)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    assert clock.fixed_offset_ns(tmp_path) == offset
    with pytest.raises(UserError, match="OBU_STATE"):
        clock.fixed_offset_ns(tmp_path / "elsewhere")
