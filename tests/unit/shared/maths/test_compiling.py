import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shared.bus import codec
from shared.maths import compiling, earth
from shared.maths.compiling import Program, machine_code

ROOT = Path(__file__).parents[4]


def hypotenuse(x: float, y: float) -> float:
    return float((x * x + y * y) ** 0.5)


def doubled(x: float) -> float:
    raise NotImplementedError


def _main(array_at: Callable[..., Any]) -> Callable[..., Any]:
    def main(at: Any, count: int) -> int:
        numbers = array_at(at, (count,))
        numbers[0] = doubled(hypotenuse(numbers[1], numbers[2]))
        return count + 1

    return main


PROGRAM = Program(_main, "int64(CPointer(float64), int64)", [hypotenuse], {doubled: lambda x: x + x})


@pytest.fixture(autouse=True)
def own_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(compiling, "_loaded", {})
    return tmp_path


def test_without_numba_there_is_no_machine_code(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "llvmlite.binding", None)
    assert machine_code(PROGRAM) is None


def test_what_was_made_once_is_loaded_by_processes_that_never_import_numba(own_cache: Path) -> None:
    pytest.importorskip("numba", reason="Numba is not installed: pip install .[fast]")
    code, numbers = machine_code(PROGRAM), np.array([0.0, 3.0, 4.0])
    assert code is not None
    assert code(numbers.ctypes.data, 3) == 4 and numbers[0] == 10.0
    (kept,) = (own_cache / "obu").iterdir()
    again = (
        "import sys; from tests.unit.shared.maths.test_compiling import PROGRAM, machine_code, np;"
        "numbers = np.array([0.0, 5.0, 12.0]);"
        "print(machine_code(PROGRAM)(numbers.ctypes.data, 3), numbers[0], 'numba' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", again], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["4", "26.0", "False"] and kept.is_file()


def test_what_is_kept_is_named_by_the_sources_and_the_machine() -> None:
    one = PROGRAM._replace(parts=[earth.wrap_angle])
    other = PROGRAM._replace(parts=[codec.encode])
    same = PROGRAM._replace(parts=[earth.gravity])
    digest = compiling._digest
    assert digest(one, ["cpu"]) != digest(other, ["cpu"])
    assert digest(one, ["cpu"]) != digest(one, ["another"])
    assert digest(one, ["cpu"]) == digest(same, ["cpu"]), "the files count, not the functions"


def test_a_place_that_cannot_be_written_keeps_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    compiling._keep(tmp_path / "file" / "code.o", b"code")
    compiling._keep(tmp_path / "folder" / "code.o", b"code")
    assert (tmp_path / "folder" / "code.o").read_bytes() == b"code"
    assert [path.name for path in (tmp_path / "folder").iterdir()] == ["code.o"]
