"""The start of a command: what its imports make is not searched for garbage."""

import gc
from collections.abc import Iterator

import pytest

from cli.__main__ import GARBAGE, imported


@pytest.fixture(autouse=True)
def _same_garbage_collection() -> Iterator[None]:
    thresholds = gc.get_threshold()
    yield
    gc.unfreeze()
    gc.set_threshold(*thresholds)
    gc.enable()


def test_a_command_that_is_imported_finds_garbage_but_not_among_its_imports() -> None:
    gc.unfreeze()
    command = imported(["solve"])
    assert callable(command)
    assert gc.isenabled() and gc.get_threshold()[0] == GARBAGE
    assert gc.get_freeze_count() > 0
