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
