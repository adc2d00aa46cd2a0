"""Published tables: each says whether the code that it describes is still that of today."""

from pathlib import Path

import pytest

from benchmarks import tables
from cli import campaign


def test_every_stored_result_is_a_table_and_its_first_line_is_true() -> None:
    stored = {path.relative_to(tables.ROOT).as_posix() for path in (tables.ROOT / "benchmarks/results").glob("*.md")}
    assert stored <= set(tables.TABLES), "name its module and its command in benchmarks/tables.py"
    for name in tables.TABLES:
        text = (tables.ROOT / name).read_text(encoding="utf-8")
        assert text == tables.headed(name, text), f"{name}: run `make docs`"


def test_a_table_is_older_after_a_change_of_code_and_not_of_comments(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, page = tmp_path / "measure.py", tmp_path / "page.md"
    monkeypatch.setattr(tables, "ROOT", tmp_path)
    monkeypatch.setattr(tables, "DIGESTS", tmp_path / "code.json")
    monkeypatch.setattr(tables, "TABLES", {"page.md": tables.Table("measure", "make measure")})
    monkeypatch.setattr(tables, "code_of", lambda _module: campaign._content_of.__wrapped__(source, 0))
    source.write_text("def measured() -> int:\n    return 1\n")
    page.write_text("# Figures\n\n1\n")
    assert tables.renew() == ["page.md"], "nothing says of which code it is"
    assert page.read_text().startswith("> Older than the code that it describes: `make measure`")
    tables.publish(page, "# Figures\n\n2\n")
    assert not tables.renew() and page.read_text() == "# Figures\n\n2\n"
    source.write_text('"""Measures."""\n\n\ndef measured() -> int:\n    """One."""\n    return 1  # one\n')
    assert not tables.renew()
    source.write_text("def measured() -> int:\n    return 2\n")
    assert tables.renew() == ["page.md"] and page.read_text().endswith("# Figures\n\n2\n")
    assert tables.renew() == ["page.md"] and page.read_text().count("Older than") == 1
