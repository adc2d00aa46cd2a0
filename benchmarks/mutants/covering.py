"""Tests that execute a line, from a run with coverage contexts (`make coverage`), the nearest and shortest first."""

import ast
import sqlite3
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from coverage import CoverageData

from tests.support.changed import UNIT, tests_of

from .sites import Site

MOST = 150  # tests of a fault, so that one in a line that everything executes has an end
REFERENCE = "tests/architecture/test_contract.py"  # prints defaults and limits of settings and messages
MOST_FILES = 4  # where the tests of a line are not known


class Selection(NamedTuple):
    """Tests of a fault, and how they were found."""

    tests: tuple[str, ...]  # arguments for pytest
    how: str  # line, name, file, import, folder, none


def nearest(root: Path, site: Site, _source: str) -> Selection:
    """Choose tests without coverage: unit tests in files that import the module of a fault, then the nearest folder."""
    inner = site.path.with_suffix("") if site.path.stem != "__init__" else site.path.parent
    module = ".".join(inner.parts)
    folder = tests_of(PurePosixPath(site.path))
    paths = [path for path in sorted((root / UNIT).rglob("test_*.py")) if module in _imported(path)]
    files = [path.relative_to(root).as_posix() for path in paths]
    if files:
        near = str(folder)
        files.sort(key=lambda name: (site.path.stem not in name, not name.startswith(near), name))
        return Selection((*files[:MOST_FILES], *([near] if folder else [])), "import")
    return Selection((str(folder),), "folder") if folder else Selection((), "none")


def _imported(path: Path) -> set[str]:
    text = path.read_text(encoding="utf-8")
    found: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{name.name}" for name in node.names)}
        elif isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
    return found


class Covering:
    """Reads the data of one run; the data may come from another folder with the same tree."""

    def __init__(self, data_file: Path, root: Path, existing: Iterable[str]) -> None:
        """Read the data; tests that are not in `existing` are left out. Raises CoverageException if there are none."""
        self._data = CoverageData(str(data_file))
        self._data.read()
        self._root, self._existing = root, frozenset(existing)
        self._files = sorted(self._data.measured_files())
        self._lines_of_test = _lines_of_tests(data_file)

    def tests(self, site: Site, source: str) -> Selection:
        """Choose the tests of a fault: those of its line, or else of lines with the name that is assigned there.

        A value that is assigned when the module is imported belongs to no test. Where the name does not appear in a
        function, those of any line of the file are chosen; where there are none either, the nearest ones.
        """
        folder = tests_of(PurePosixPath(site.path))
        contexts = self._contexts(site.path)
        named = _lines_with_assigned_name(source, site)
        for how, lines in (("line", range(site.line, site.end_line + 1)), ("name", named), ("file", contexts)):
            found = {test for line in lines for test in contexts.get(line, ()) if test in self._existing}
            if found:
                chosen = sorted(found, key=lambda test: self._order(test, folder))[:MOST]
                printed = [REFERENCE] if how != "line" and (self._root / REFERENCE).exists() else []
                return Selection((*chosen, *printed), how)
        return nearest(self._root, site, source)

    def _contexts(self, path: Path) -> dict[int, set[str]]:
        measured = [name for name in self._files if name.endswith(f"/{path.as_posix()}")]
        if not measured:
            return {}
        by_line = self._data.contexts_by_lineno(min(measured, key=len))
        return {line: {name.split("|")[0] for name in names if name} for line, names in by_line.items()}

    def _order(self, test: str, folder: PurePosixPath | None) -> tuple[bool, bool, int, str]:
        near = folder is not None and test.startswith(str(folder))
        return not near, not test.startswith(f"{UNIT}/"), self._lines_of_test.get(test, 0), test


def _lines_of_tests(data_file: Path) -> dict[str, int]:
    """Count branches, or lines, that each test executes: a test that executes little is short, and about that."""
    with sqlite3.connect(f"file:{data_file}?mode=ro", uri=True) as database:
        rows = database.execute(
            "select context, (select count(*) from arc where context_id = id)"
            " + (select total(length(numbits)) from line_bits where context_id = id) from context"
        ).fetchall()
    found: dict[str, int] = {}
    for context, lines in rows:
        test = context.split("|")[0]
        found[test] = found.get(test, 0) + int(lines)
    return found


def _lines_with_assigned_name(source: str, site: Site) -> list[int]:
    """Lines that read the name which the statement of a fault assigns, also as an attribute."""
    tree = ast.parse(source)
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.lineno <= site.line <= (node.end_lineno or 0):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {item.id for target in targets for item in ast.walk(target) if isinstance(item, ast.Name)}
    return [
        node.lineno
        for node in ast.walk(tree)
        if (isinstance(node, ast.Name) and node.id in names and isinstance(node.ctx, ast.Load))
        or (isinstance(node, ast.Attribute) and node.attr in names)
    ]
