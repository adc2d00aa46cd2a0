"""The offset of the time line: set once a boot by the first process."""

import ctypes
import errno
import os
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from shared.errors import UserError
from shared.maths.dates import EARLIEST_HOST_NS
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


def test_where_a_full_disk_left_no_folder_the_time_line_is_kept_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clock, "SHARED_MEMORY", tmp_path)
    monkeypatch.setattr(clock, "is_full", lambda path: path == tmp_path / "missing")
    made = clock.Clock(tmp_path / "missing")
    assert made.not_stored is not None and clock.Clock(tmp_path / "missing").offset_ns == made.offset_ns


def test_a_state_folder_that_is_not_there_is_an_error_with_its_remedy(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="OBU_STATE"):
        clock.fixed_offset_ns(tmp_path / "elsewhere")


class Disk:
    """A state folder on a disk that takes nothing until it has room, beside shared memory that does."""

    def __init__(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: int) -> None:
        self.state, self.memory = tmp_path / "state", tmp_path / "memory"
        self.state.mkdir()
        self.memory.mkdir()
        self.full, write = True, Path.write_text

        def write_text(path: Path, text: str, **options: Any) -> int:
            if self.full and path.parent == self.state:
                raise OSError(fault, os.strerror(fault))
            return write(path, text, **options)

        monkeypatch.setattr(Path, "write_text", write_text)
        monkeypatch.setattr(clock, "SHARED_MEMORY", self.memory)


@pytest.mark.parametrize("fault", [errno.ENOSPC, errno.EROFS, errno.EIO, errno.EDQUOT])
def test_on_a_disk_that_takes_nothing_processes_agree_in_memory_and_say_so(
    fault: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Disk(tmp_path, monkeypatch, fault)
    first = clock.Clock(disk.state)
    monkeypatch.setattr(time, "time_ns", lambda: 1_900_000_000 * 10**9)  # NTP has set the host's clock
    second = clock.Clock(disk.state)
    assert first.offset_ns == second.offset_ns
    assert first.not_stored is not None and os.strerror(fault) in first.not_stored
    assert not list(disk.state.iterdir()), "not even an empty file"
    disk.full = False
    third = clock.Clock(disk.state)
    assert third.offset_ns == first.offset_ns and third.not_stored is None


def test_without_shared_memory_each_process_starts_with_a_time_line_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Disk(tmp_path, monkeypatch, errno.ENOSPC)
    monkeypatch.setattr(clock, "SHARED_MEMORY", tmp_path / "none")
    made = clock.Clock(disk.state)
    assert made.not_stored is not None and abs(made.now_ns() - time.time_ns()) < 5 * 10**9


@pytest.mark.parametrize("content", ["", "\0\0\0\0", "12x"])
def test_a_file_without_an_offset_is_made_anew(content: str, tmp_path: Path) -> None:
    path = tmp_path / f"clock-{clock.boot_id()}"
    path.write_text(content)
    offset = clock.fixed_offset_ns(tmp_path)
    assert int(path.read_text()) == offset == clock.fixed_offset_ns(tmp_path)


@pytest.mark.parametrize("shown_ns", [0, 86_400 * 10**9, 10**19])
def test_a_host_that_shows_an_impossible_date_begins_the_time_line_at_the_earliest_one_that_is_possible(
    shown_ns: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "time_ns", lambda: shown_ns)
    assert 0 <= clock.Clock(tmp_path).now_ns() - EARLIEST_HOST_NS < 10 * 10**9


class Library:
    """A C library whose ntp_gettime(3) answers and writes what a test says: a kernel cannot be asked to."""

    def __init__(self, answer: int, maximum_error_us: int) -> None:
        self._answer, self._maximum_error_us = answer, maximum_error_us

    def ntp_gettime(self, reference: Any) -> int:
        reference._obj.maximum_error_us = self._maximum_error_us
        return self._answer


@pytest.mark.parametrize(("answer", "error_s"), [(0, 0.025), (1, 0.025), (5, None), (-1, None)])
def test_the_error_of_the_clock_is_known_while_the_kernel_calls_it_synchronised(
    answer: int, error_s: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda _: Library(answer, 25_000))
    assert clock.maximum_error_s() == error_s


def test_the_kernel_of_this_machine_is_asked() -> None:
    error_s = clock.maximum_error_s()
    assert error_s is None or 0.0 <= error_s < 20.0, "the kernel gives up at 16 s"


def test_a_c_library_without_the_question_holds_no_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda _: object())
    assert clock.maximum_error_s() is None
