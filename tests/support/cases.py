"""Many cases of milliseconds in one test, which names all that fail."""

import inspect
from collections.abc import Callable, Iterable, Sequence
from functools import wraps
from typing import Any

import pytest

Test = Callable[..., None]
FAILURES = Exception, pytest.fail.Exception  # that of pytest.raises is no Exception


def each(names: str | tuple[str, ...], cases: Iterable[object]) -> Callable[[Test], Test]:
    """Run a test once with every case, in place of `pytest.mark.parametrize`, where a case takes milliseconds.

    Cases share the fixtures of the test, so they may not change them. With several names, a case is a tuple of values,
    or what `pytest.param` makes of them, without marks.
    Raises a group of all failures, each with its case as a note.
    """
    listed = [_named(names, case) for case in cases]
    assert listed, f"there is no case of {names}"

    def decorate(test: Test) -> Test:
        signature = inspect.signature(test)
        given = listed[0].keys()
        assert given <= signature.parameters.keys(), f"{test.__name__} takes no {given - signature.parameters.keys()}"

        @wraps(test)
        def with_every_case(**fixtures: object) -> None:
            failures: list[BaseException] = []
            skips: list[BaseException] = []
            for case in listed:
                try:
                    test(**fixtures, **case)
                except FAILURES as error:
                    error.add_note(f"with {shortened(case)}")
                    failures.append(error)
                except pytest.skip.Exception as skip:
                    skips.append(skip)
            if skips and not failures:
                raise skips[0]
            if failures:
                named = "; ".join(error.__notes__[-1] for error in failures[:10])
                raise BaseExceptionGroup(f"{len(failures)} of {len(listed)} cases fail, {named}", failures)

        kept = [parameter for name, parameter in signature.parameters.items() if name not in given]
        with_every_case.__signature__ = signature.replace(parameters=kept)  # type: ignore[attr-defined]
        return with_every_case

    return decorate


def crossed(rows: Sequence[object], columns: Sequence[object]) -> list[object]:
    """Every pair, for `pytest.mark.parametrize`: each row and each column runs always, and other pairs are slow."""
    return [
        pytest.param(row, column, marks=() if i % len(columns) == j or j % len(rows) == i else pytest.mark.slow)
        for i, row in enumerate(rows)
        for j, column in enumerate(columns)
    ]


def _named(names: str | tuple[str, ...], case: Any) -> dict[str, object]:
    if hasattr(case, "marks"):
        assert not case.marks, "a case has no mark of its own"
        case = case.values if isinstance(names, tuple) else case.values[0]
    return dict(zip(names, case, strict=True)) if isinstance(names, tuple) else {names: case}


def shortened(case: dict[str, object]) -> str:
    """Values of a case by name, each in at most 60 characters."""
    texts = {name: getattr(value, "__name__", None) or repr(value) for name, value in case.items()}
    return ", ".join(f"{name} = {text if len(text) <= 60 else text[:57] + '...'}" for name, text in texts.items())
