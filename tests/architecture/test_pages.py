"""Every page is found from the index, every link leads somewhere, and the front page stays short."""

import re
from pathlib import Path

import pytest

from cli.reference.wrap import pages, wrap

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]+)(?:#[^)]*)?\)")
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.rglob("*.md"), *(ROOT / "benchmarks").rglob("*.md")])


def links(page: Path) -> set[Path]:
    """Files of the repository that a page links."""
    text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return {(page.parent / item).resolve() for item in LINK.findall(text) if "://" not in item}


def test_the_index_names_every_page() -> None:
    pages = {
        page for folder in ("tutorials", "how-to", "explanation", "reference") for page in (DOCS / folder).rglob("*.md")
    }
    assert pages - links(DOCS / "README.md") == set()


def test_the_list_of_decisions_is_complete_in_their_numbers() -> None:
    numbers = sorted(int(page.name[:4]) for page in (DOCS / "decisions").glob("[0-9]*.md"))
    assert numbers == list(range(1, len(numbers) + 1))


def test_every_link_leads_to_a_file() -> None:
    broken = {
        str(page.relative_to(ROOT)): {str(target) for target in links(page) if not target.exists()} for page in PAGES
    }
    assert {page: targets for page, targets in broken.items() if targets} == {}


def test_the_front_page_is_short() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 70


@pytest.mark.parametrize("page", pages(ROOT), ids=lambda page: str(page.relative_to(ROOT)))
def test_prose_is_wrapped_at_120_columns(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert text == wrap(text), "run `.venv/bin/python -m cli.reference.wrap`"


def test_only_paragraphs_that_are_too_long_are_wrapped_and_code_spans_and_links_stay_whole() -> None:
    code, link = f"`{'a b ' * 20}c`", f"[{'word ' * 12}here]({'x' * 60})"
    kept = f"# {'long ' * 30}\n\nshort\nlines\n\n    {'code ' * 40}\n\n| {'cell ' * 40} |\n\n```\n{'code ' * 40}\n```\n"
    wrapped = wrap(f"{kept}\n- {'item ' * 30}{code} - {link}\n")
    assert wrapped.startswith(kept)
    lines = wrapped[len(kept) :].strip().splitlines()
    assert max(map(len, lines)) <= 120 and lines[0].startswith("- item") and lines[1].startswith("  item")
    assert any(code in line for line in lines) and not any(line.startswith("  - ") for line in lines)
    assert wrap(wrapped) == wrapped
