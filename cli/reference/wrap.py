"""Wraps the prose of Markdown at 120 columns: `python -m cli.reference.wrap` does so in every page of the repository.

A paragraph whose lines all fit stays as it is. Tables, code, headings and comments are never wrapped, and neither is
what cannot be broken: the address of a link, a code span.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

WIDTH = 120
ATOM = re.compile(r"(?:`[^`]*`|\]\([^)]*\)|\S)+")  # a code span and the address of a link are part of a word
ITEM = re.compile(r"( *)([-*+]|\d+[.)]) +")
# At the start of a line these would turn a paragraph into a list, a heading, a quotation or a table.
MARK = re.compile(r"[-*+>|=#]+$|#|>|\||\d+[.)]$|<!--|```")
VERBATIM = re.compile(r"\s*(?:#|\||<|!\[|\[[^\]]+\]: |-{3,}$)")
CODE = "    "  # begins a line of code behind a line that is empty or code


def wrap(text: str) -> str:
    """Wrap every paragraph and list item with a line that is too long.

    Parameters
    ----------
    text : str
        A page of Markdown.

    Returns
    -------
    str
        The same page for a reader of HTML.
    """
    parts = (_fitted(lines) if prose else lines for prose, lines in _parts(text.split("\n")))
    return "\n".join(line for lines in parts for line in lines)


def _parts(lines: list[str]) -> Iterator[tuple[bool, list[str]]]:
    """Divide a page into paragraphs or list items (True), and lines that stay as they are (False)."""
    paragraph: list[str] = []
    fenced = False
    for line in lines:
        fence = line.lstrip().startswith("```")
        code = not paragraph and line.startswith(CODE) and not ITEM.match(line)
        alone = fence or fenced or code or not line.strip() or VERBATIM.match(line) is not None
        if paragraph and (alone or ITEM.match(line)):
            yield True, paragraph
            paragraph = []
        if alone:
            yield False, [line]
        else:
            paragraph.append(line)
        fenced ^= fence
    if paragraph:
        yield True, paragraph


def _fitted(paragraph: list[str]) -> list[str]:
    if max(map(len, paragraph)) <= WIDTH:
        return paragraph
    first = paragraph[0]
    item = ITEM.match(first)
    start = item.group() if item else first[: len(first) - len(first.lstrip())]
    indent = " " * len(start)
    words: list[str] = []
    for word in ATOM.findall(" ".join([first[len(start) :], *(line.strip() for line in paragraph[1:])])):
        if words and MARK.match(word):
            words[-1] += f" {word}"
        else:
            words.append(word)
    return list(_filled(words, start, indent))


def _filled(words: list[str], start: str, indent: str) -> Iterator[str]:
    line = start + words[0]
    for word in words[1:]:
        if len(line) + 1 + len(word) <= WIDTH:
            line = f"{line} {word}"
        else:
            yield line
            line = indent + word
    yield line


def pages(root: Path) -> list[Path]:
    """Every page of Markdown that is written by people, or printed from code."""
    folders = [root / "docs", root / "benchmarks", root / ".github"]
    return sorted([*root.glob("*.md"), *(page for folder in folders for page in folder.rglob("*.md"))])


if __name__ == "__main__":
    for page in pages(Path()):
        before = page.read_text(encoding="utf-8")
        if (after := wrap(before)) != before:
            page.write_text(after, encoding="utf-8")
            sys.stdout.write(f"{page}\n")
