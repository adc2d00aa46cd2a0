"""Reads a recipe of `docs/how-to/add`: its rows say what to touch, and which test fails without it."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

from .tree import ROOT, Edit

FOLDER = ROOT / "docs" / "how-to" / "add"
# What a step runs in place of an edit, with the arguments of Python that do the same.
COMMANDS = {
    "`make docs`": ("-m", "cli", "reference"),
    "`.venv/bin/python -m tests.support.words`": ("-m", "tests.support.words"),
}
ROW = re.compile(r"^\| (\d+)\. (.*?) \| (.*?) \| (.*?) \|$", re.MULTILINE)
QUOTED = re.compile(r"`([^`]+)`")


@dataclass(frozen=True)
class Step:
    """One row of a recipe."""

    number: int
    what: str
    files: tuple[str, ...]  # names in angle brackets stand for any
    failing: tuple[str, ...]  # tests that fail without it, as pytest names them

    @property
    def command(self) -> tuple[str, ...]:
        """Arguments of Python that do this step; empty of one that is done by hand."""
        return next((command for text, command in COMMANDS.items() if self.what.startswith(text)), ())

    def names(self, path: str) -> bool:
        """Whether the step says to touch a file."""
        return any(re.fullmatch(pattern(file), path) for file in self.files)

    def tests(self, paths: Iterable[str]) -> list[str]:
        """Tests that fail without it, with the names that files of this step have for angle brackets."""
        names: dict[str, str] = {}
        for path in paths:
            for file in self.files:
                if matched := re.fullmatch(pattern(file), path):
                    names |= matched.groupdict()
        return [re.sub(r"<(\w+)>", lambda match: names[match[1]], test) for test in self.failing]


def pattern(file: str) -> str:
    """Regular expression of a file's name on a page; what stands for a name in angle brackets is a group."""
    parts = re.split(r"<(\w+)>", file)
    seen: set[str] = set()
    found = ""
    for n, part in enumerate(parts):
        if n % 2 == 0:
            found += re.escape(part)
        else:
            found += f"(?P={part})" if part in seen else f"(?P<{part}>[^/]+)"
            seen.add(part)
    return found


def steps_of(recipe: str) -> list[Step]:
    """Rows of a page."""
    text = (FOLDER / f"{recipe}.md").read_text(encoding="utf-8")
    return [
        Step(int(number), what, tuple(QUOTED.findall(files)), tuple(QUOTED.findall(tests)))
        for number, what, files, tests in ROW.findall(text)
    ]


Example = tuple[tuple[Edit, ...], ...]  # of each step that is not printed, in the order of the page
