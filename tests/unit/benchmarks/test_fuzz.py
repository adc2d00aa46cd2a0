"""A few damaged bytes for each parser; `make fuzz` gives each a minute."""

from pathlib import Path

import pytest

from benchmarks import fuzz, fuzz_files, fuzz_fleet
from fleet.admission.enrolment import Refusal
from shared.faults import FAULT
from shared.protocols.recognition import recognise
from tests.support.data import REPOSITORY

LEAST, LEAST_FILES = 100, 10  # a parser that fails mostly does within the first hundred inputs


@pytest.mark.parametrize("name", sorted(fuzz.TARGETS))
def test_damaged_bytes_neither_raise_nor_grow(name: str, tmp_path: Path) -> None:
    inputs, failures = fuzz.fuzz(name, 1, 0.0, tmp_path, LEAST)
    assert inputs == LEAST and not failures


@pytest.mark.parametrize("name", sorted(fuzz_files.READERS))
def test_damaged_files_are_read_or_refused(name: str, tmp_path: Path) -> None:
    inputs, failures = fuzz_files.fuzz(name, 1, 0.0, tmp_path, LEAST_FILES)
    assert inputs == LEAST_FILES and not failures


@pytest.mark.parametrize("name", fuzz_fleet.NAMES)
def test_hostile_messages_of_a_unit_or_a_centre_are_read_or_refused(name: str, tmp_path: Path) -> None:
    inputs, failures = fuzz_fleet.fuzz(name, 1, 0.0, tmp_path, LEAST)
    assert inputs == LEAST and not failures


def test_sound_messages_between_a_unit_and_a_centre_are_read() -> None:
    with fuzz_fleet.readers() as readers:
        assert tuple(readers) == fuzz_fleet.NAMES
        for name, reader in readers.items():
            for seed in reader.seeds:
                if name in ("enrol", "renew"):
                    with pytest.raises(Refusal, match="it was believed"):
                        reader.read(reader.framed(seed))
                else:
                    reader.read(reader.framed(seed))


def test_a_failing_input_is_stored_and_fails_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class FragileParser:
        def __init__(self) -> None:
            self.rejects = {FAULT: 0}

        def handle(self, message: object) -> list[object]:
            if b"\xff" in message.data:  # type: ignore[attr-defined]
                raise IndexError("too short")
            return []

    monkeypatch.setattr(fuzz, "parser_of", lambda name: FragileParser())
    _, failures = fuzz.fuzz("can", 3, 0.1, tmp_path)
    assert failures and "IndexError: too short; input: " in failures[0]
    stored = Path(failures[0].split("input: ")[1]).read_bytes()
    assert fuzz.failure_of(FragileParser(), "can", stored, fuzz.NOW_NS) == "IndexError: too short"


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
