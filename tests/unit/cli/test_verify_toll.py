"""`obu verify-toll`: charges are recomputed from their evidence, and changes of the evidence are found."""

import sqlite3
import zlib
from pathlib import Path

import pytest

from benchmarks.toll_campaign import Campaign
from cli.verify_toll import differences_of, parse, read, verify_toll
from shared.errors import UserError
from shared.unpacked import ALWAYS_BYTES


@pytest.fixture(scope="module")
def ledger(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger of at least three charges at the simulated plaza, without kills."""
    folder = tmp_path_factory.mktemp("toll")
    made = Campaign(folder, 1, 40, float("inf"))
    made.run(12)
    assert made.store is not None
    made.store.close()
    return made.path


def test_every_charge_is_recomputed_bit_for_bit(ledger: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert verify_toll([ledger]) == 0
    *_, last = capsys.readouterr().out.splitlines()
    number = int(last.split()[0])
    assert number >= 3 and last == f"{number} of {number} charges verified"


def test_an_exported_pack_is_verified_without_the_ledger(ledger: Path, tmp_path: Path) -> None:
    first = next(iter(read(ledger)))
    assert verify_toll([ledger], first.name, tmp_path) == 0
    (path,) = tmp_path.iterdir()
    assert path.stem == first.name and verify_toll([path]) == 0


@pytest.mark.parametrize("change", ["lane", "frame", "amount", "plaza", "crossing"])
def test_a_change_of_the_evidence_is_found(ledger: Path, change: str) -> None:
    evidence = next(iter(read(ledger)))
    pack = parse(evidence)
    assert pack.crossed.evidence is not None
    shown = pack.crossed.evidence
    changes: dict[str, dict[str, object]] = {
        "lane": {"crossed": pack.crossed.model_copy(update={"lane": "s9"})},
        "frame": {"crossed": pack.crossed.model_copy(
            update={"evidence": shown.model_copy(update={"frames": shown.frames[:20] + shown.frames[21:]})})},
        "amount": {"amount_cents": pack.amount_cents + 1},
        "plaza": {"plaza_file": pack.plaza_file + " "},
        "crossing": {"crossed": pack.crossed.model_copy(update={"crossing_ns": (pack.crossed.crossing_ns or 0) + 1})},
    }  # fmt: skip
    forged = pack.model_copy(update=changes[change])
    assert differences_of(evidence, pack) == []
    assert differences_of(evidence, forged)


def test_a_pack_that_differs_from_that_of_the_transaction_is_reported(ledger: Path) -> None:
    evidence = next(iter(read(ledger)))
    other = type(evidence)(evidence.name, evidence.pack + b" ", evidence.transaction)
    assert differences_of(other, parse(evidence))[0] == "the pack is not the one of the transaction"


@pytest.mark.parametrize("content", [b"", b"{}", b"SQLite format 3\0garbage"])
def test_a_file_without_evidence_is_a_user_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "file"
    path.write_bytes(content)
    with pytest.raises(UserError, match="file"):
        verify_toll([path])


def test_an_unknown_passage_is_a_user_error(ledger: Path) -> None:
    with pytest.raises(UserError, match="no evidence of ffffffffff"):
        verify_toll([ledger], "ffffffffff")


@pytest.mark.parametrize(
    ("column", "damage"),
    [("pack", b"no zlib"), ("pack", b""), ("pack", "a text"), ("pack", zlib.compress(b"{}")),
     ("pack", zlib.compress(b"\xff")), ("pack", zlib.compress(bytes(ALWAYS_BYTES + 1))),
     ("content", "{"), ("content", b"\x00")],
)  # fmt: skip
def test_a_damaged_row_is_a_sentence_and_the_other_charges_are_verified(
    ledger: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], column: str, damage: str | bytes
) -> None:
    copy = tmp_path / "ledger.sqlite"
    copy.write_bytes(ledger.read_bytes())
    first, *others = [evidence.name for evidence in read(ledger)]
    table = "evidence" if column == "pack" else "booking"
    with sqlite3.connect(copy) as database:
        database.execute(f"UPDATE {table} SET {column} = ? WHERE passage_id = ?", (damage, first))
    assert verify_toll([copy]) == 1
    lines = capsys.readouterr().out.splitlines()
    what = "evidence" if column == "pack" else "transaction"
    (said,) = [line for line in lines if line.startswith(first)]
    assert f"its {what} is damaged" in said and "restore the ledger" in said
    assert lines[-1] == f"{len(others)} of {len(others) + 1} charges verified"
    assert verify_toll([copy], others[0]) == 0
