"""Places of faults: each changes one thing, compiles, and is drawn again with the same seed."""

import ast
from pathlib import Path

import pytest

from benchmarks.mutants.__main__ import EQUIVALENTS, ROOT, candidates
from benchmarks.mutants.sites import Kind, draw, sites_of

PATH = Path("example.py")
SOURCE = '''"""A text with a - sign and 3 numbers."""
LIMIT_M = 2.0  # ä

def find(values: list[float], most: int = 3) -> float:
    """Return -1."""
    total = -sum(values) + LIMIT_M * most
    if total <= most and values is not None:
        values.append(total)
    return f"{total}" + "x" if total == 1 else total ** 2
'''


def faults(kind: Kind) -> list[str]:
    """Lines that each fault of a kind makes in place of the old one."""
    found = []
    for site in sites_of(PATH, SOURCE):
        if site.kind is kind:
            changed = site.applied(SOURCE).splitlines()
            found += [new.strip() for old, new in zip(SOURCE.splitlines(), changed, strict=True) if old != new]
    return found


@pytest.mark.parametrize(("kind", "lines"), [
    (Kind.ARITHMETIC, ["total = (-sum(values) - LIMIT_M * most)", "total = -sum(values) + (LIMIT_M / most)",
                       'return f"{total}" + "x" if total == 1 else (total * 2)']),
    (Kind.SIGN, ["total = (sum(values)) + LIMIT_M * most"]),
    (Kind.BOUNDARY, ["if (total < most) and values is not None:"]),
    (Kind.DROPPED_CALL, ["pass"]),
])  # fmt: skip
def test_a_fault_changes_one_line(kind: Kind, lines: list[str]) -> None:
    assert sorted(faults(kind)) == sorted(lines)


def test_every_fault_compiles_and_none_is_in_a_text_or_an_annotation() -> None:
    sites = sites_of(PATH, SOURCE)
    for site in sites:
        ast.parse(site.applied(SOURCE))
        assert site.applied(SOURCE) != SOURCE
    assert {site.line for site in sites if site.kind is Kind.CONSTANT} == {2, 4, 9}
    assert {site.kind for site in sites} == set(Kind)


def test_a_draw_takes_every_kind_and_is_the_same_again() -> None:
    sites = sites_of(PATH, SOURCE)
    drawn = draw(sites, 6, seed=3)
    assert {site.kind for site in drawn} == set(Kind)
    assert drawn == draw(sites, 6, seed=3) and len(set(draw(sites, 1000, seed=4))) == len(sites)


def test_every_fault_that_is_named_as_equivalent_is_one_of_the_places() -> None:
    named = {(item["path"], item["line"], item["replacement"]) for item in EQUIVALENTS}
    lines = {path: (ROOT / path).read_text(encoding="utf-8").splitlines() for path, *_ in named}
    places = {
        (site.path.as_posix(), lines[site.path.as_posix()][site.line - 1].strip(), site.replacement)
        for site in candidates(ROOT)
        if site.path.as_posix() in lines
    }
    assert named and named <= places
