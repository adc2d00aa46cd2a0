"""The version and its date are stated once; the changelog has a section of that name."""

import re
import tomllib

from shared import RELEASED, VERSION
from tests.support.data import REPOSITORY


def test_the_newest_section_of_the_changelog_is_this_version() -> None:
    text = (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")
    sections = re.findall(r"^## (.*)$", text, re.MULTILINE)
    assert sections[:2] == ["Unreleased", f"{VERSION} - {RELEASED}"]


def test_the_version_of_the_package_is_that_of_the_code() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    assert "version" in project["project"]["dynamic"]
    assert project["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "shared.VERSION"}


def test_a_release_has_at_most_thirty_lines_and_an_entry_one() -> None:
    text = (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")
    _, *sections = re.split(r"^(?=## )", text, flags=re.MULTILINE)
    long = {section.splitlines()[0]: len(section.rstrip().splitlines()) for section in sections}
    assert sections and max(long.values()) <= 30, f"merge entries, the details are in the pages: {long}"
    body = [line for section in sections for line in section.splitlines() if line]
    assert [line for line in body if not line.startswith(("## ", "### ", "- ")) or len(line) > 120] == []
