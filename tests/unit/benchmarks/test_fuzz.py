"""Half a second of damaged bytes for each parser; `make fuzz` gives each a minute."""

from pathlib import Path

import pytest

from benchmarks import fuzz, fuzz_files
from shared.devices.recognition import recognise
from shared.faults import FAULT
from tests.support.data import REPOSITORY

# 0.3 s on this test's machine are 200 inputs and more; a parser that fails mostly does within the first hundred.
SECONDS = 0.5


@pytest.mark.parametrize("name", sorted(fuzz.TARGETS))
def test_damaged_bytes_neither_raise_nor_grow(name: str, tmp_path: Path) -> None:
    inputs, failures = fuzz.fuzz(name, 1, SECONDS, tmp_path)
    assert inputs > 20 and not failures


@pytest.mark.parametrize("name", sorted(fuzz_files.READERS))
def test_damaged_files_are_read_or_refused(name: str, tmp_path: Path) -> None:
    inputs, failures = fuzz_files.fuzz(name, 1, SECONDS, tmp_path)
    assert inputs > 2 and not failures


def test_a_failing_input_is_stored_and_fails_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Fragile:
        def __init__(self) -> None:
            self.rejects = {FAULT: 0}

        def handle(self, message: object) -> list[object]:
            if b"\xff" in message.data:  # type: ignore[attr-defined]
                raise IndexError("too short")
            return []

    monkeypatch.setattr(fuzz, "parser_of", lambda name: Fragile())
    _, failures = fuzz.fuzz("can", 3, 0.1, tmp_path)
    assert failures and "IndexError: too short; input: " in failures[0]
    stored = Path(failures[0].split("input: ")[1]).read_bytes()
    assert fuzz.failure_of(Fragile(), "can", stored, fuzz.NOW_NS) == "IndexError: too short"


def test_repaired_frames_have_right_checksums() -> None:
    for path in sorted((REPOSITORY / "tests" / "golden").glob("*.[ux]b*")):
        seed = path.read_bytes()[:4000]
        assert recognise(bytes(fuzz.repaired(bytearray(seed)))).frames == recognise(seed).frames
        damaged = bytearray(seed)
        damaged[30::97] = bytes(len(damaged[30::97]))
        assert count(fuzz.repaired(bytearray(damaged))) > count(damaged)


def count(data: bytearray) -> int:
    return sum(recognise(bytes(data)).frames.values())


def test_buffers_are_measured() -> None:
    parser = fuzz.parser_of("can")
    before = fuzz.held_bytes(parser)
    parser.kinds._reasons["x"] = "y" * 100_000
    assert fuzz.held_bytes(parser) - before > 100_000
