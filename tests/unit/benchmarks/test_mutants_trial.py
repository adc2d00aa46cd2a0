"""Tests of a fault: those that execute its line, nearest and shortest first; what fails without it finds nothing."""

import subprocess
from pathlib import Path

import pytest
from coverage import CoverageData

from benchmarks.mutants.covering import Covering, Selection, nearest
from benchmarks.mutants.sites import Kind, Site, sites_of
from benchmarks.mutants.trial import Copy

PATH = Path("services/core/fusion/example.py")
SOURCE = """FACTOR = 3

def tripled(x):
    return FACTOR * x

def other(x):
    return x - 1
"""
TESTS = """import sys
from pathlib import Path
sys.path.insert(0, str(Path(__file__).parents[4] / "services/core/fusion"))
import example

def test_broken():
    assert False

def test_tripled():
    assert example.tripled(2) == 6
"""
NEAR, FAR = "tests/unit/core/fusion/test_example.py::test_tripled", "tests/unit/cli/test_far.py::test_far"


def site(kind: Kind, line: int) -> Site:
    return next(site for site in sites_of(PATH, SOURCE) if (site.kind, site.line) == (kind, line))


@pytest.fixture
def contexts(tmp_path: Path) -> Path:
    """Data of a run in which a far test executes both functions, and a near one the first."""
    data = CoverageData(str(tmp_path / "data"))
    for test, lines in ((FAR, [4, 7]), (NEAR, [4])):
        data.set_context(f"{test}|run")
        data.add_lines({f"/elsewhere/{PATH}": lines})
    data.write()
    return tmp_path / "data"


@pytest.mark.parametrize(("place", "expected"), [
    (site(Kind.ARITHMETIC, 4), Selection((NEAR, FAR), "line")),
    (site(Kind.CONSTANT, 1), Selection((NEAR, FAR), "name")),
    (site(Kind.ARITHMETIC, 7), Selection((FAR,), "line")),
])  # fmt: skip
def test_tests_execute_the_line_or_the_name_and_the_nearest_come_first(
    contexts: Path, tmp_path: Path, place: Site, expected: Selection
) -> None:
    assert Covering(contexts, tmp_path, [NEAR, FAR]).tests(place, SOURCE) == expected


def test_without_a_test_of_the_line_any_of_the_file_and_then_the_nearest_are_chosen(
    contexts: Path, tmp_path: Path
) -> None:
    place = site(Kind.ARITHMETIC, 7)
    assert Covering(contexts, tmp_path, [NEAR]).tests(place, SOURCE) == Selection((NEAR,), "file")
    folder = Selection(("tests/unit/core/fusion",), "folder")
    assert Covering(contexts, tmp_path, []).tests(place, SOURCE) == nearest(tmp_path, place, SOURCE) == folder
    (tmp_path / folder.tests[0]).mkdir(parents=True)
    importing = tmp_path / folder.tests[0] / "test_one.py"
    importing.write_text("from services.core.fusion import example")
    assert nearest(tmp_path, place, SOURCE) == Selection(
        ("tests/unit/core/fusion/test_one.py", *folder.tests), "import"
    )


def test_a_fault_is_tried_in_a_copy_and_a_test_that_fails_without_it_finds_nothing(tmp_path: Path) -> None:
    root, copied = tmp_path / "root", tmp_path / "copy"
    for path, text in ((PATH, SOURCE), (Path(NEAR.partition("::")[0]), TESTS)):
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(text)
    subprocess.run(["git", "init", "-q"], cwd=root, check=True)
    (root / "pytest.ini").write_text("[pytest]\nmarkers = slow\n")
    copied.mkdir()
    copy = Copy(root, copied)
    tests = copy.tests()
    assert NEAR in tests and len(tests) == 2

    def choose(_site: Site, _source: str) -> Selection:
        return Selection(tuple(tests), "line")

    killed = copy.tried(site(Kind.ARITHMETIC, 4), choose)
    assert (killed.outcome, killed.test) == ("killed", NEAR)
    assert copy.tried(site(Kind.ARITHMETIC, 7), choose).outcome == "survived"
    assert (copied / PATH).read_text() == (root / PATH).read_text() == SOURCE
