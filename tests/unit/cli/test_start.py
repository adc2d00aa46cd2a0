"""The start of a command: what its imports make is not searched for garbage."""

import gc
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from cli.__main__ import GARBAGE, imported

SIMULATED = Path(__file__).resolve().parents[3] / "deploy" / "vehicles" / "simulated.toml"
# All processes in one, with what each imports later as well: Numba would come with the first that it compiles.
ALL_PROCESSES = """
import sys
from importlib import import_module
from cli import __main__ as command
from shared.processes import BY_NAME
from shared.runtime import live

def imported(name, vehicle):
    for process in BY_NAME:
        import_module(f"services.{process}.process")

live.run_process = imported
command.run("core.fusion")
assert "shared.inertial.strapdown" in sys.modules
print([name for name in ("numba", "llvmlite") if name in sys.modules])
"""


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


def test_no_process_of_a_vehicle_imports_numba_which_takes_120_mb() -> None:
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_DISABLE_JIT"}
    done = subprocess.run(
        [sys.executable, "-c", ALL_PROCESSES], env=environment | {"OBU_VEHICLE": str(SIMULATED)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.strip() == "[]"
    compiled = "from shared.maths.compiled import COMPILED; print(COMPILED)"
    done = subprocess.run([sys.executable, "-c", compiled], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "True", "commands and tests are compiled"
