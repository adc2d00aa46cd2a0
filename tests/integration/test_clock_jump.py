"""A host whose clock jumps by ten years: every process is back at once, and no recording is lost."""

import shutil
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from tests.integration.test_demo import Demo, start_demo
from tests.support.patience import HANGS_S

pytestmark = [pytest.mark.whole_unit, pytest.mark.broker]
TEN_YEARS_S = 3652 * 86_400
SOURCE = Path(__file__).resolve().parents[1] / "support" / "jumping_clock.c"


@pytest.fixture
def clock_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file that sets the clock of all that is started; the monotonic clock goes on, as on a real host."""
    if (compiler := shutil.which("cc")) is None:
        pytest.skip("no C compiler is installed: `apt install gcc`")
    library, path = tmp_path / "clock.so", tmp_path / "clock"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", str(library), str(SOURCE), "-ldl"], check=True)
    path.write_bytes(struct.pack("q", 0))
    monkeypatch.setenv("LD_PRELOAD", str(library))
    monkeypatch.setenv("LD_JUMPING_CLOCK", str(path))
    return path


@pytest.fixture
def demo(clock_file: Path, tmp_path: Path) -> Iterator[Demo]:
    made = start_demo(tmp_path / "state")
    try:
        made.wait(made.all_ready, "every process is ready")
        yield made
    finally:
        made.process.terminate()
        made.process.communicate(timeout=HANGS_S)


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1, -1], ids=["forward", "back"])
def test_after_a_jump_every_process_is_back_and_every_recording_there(demo: Demo, clock_file: Path, sign: int) -> None:
    recordings = demo.folder / "recordings"
    earlier = recordings / "20260101T000000Z_demo.mcap"
    earlier.write_bytes(bytes(1000))
    (first,) = [path for path in recordings.glob("*.mcap") if path != earlier]
    with clock_file.open("r+b") as file:
        file.write(struct.pack("q", sign * TEN_YEARS_S))
    shown = subprocess.run([sys.executable, "-c", "import time; print(time.time())"], capture_output=True, check=True)
    assert abs(abs(float(shown.stdout) - time.time()) - TEN_YEARS_S) < 60.0, "the programs of the demo see the jump"
    demo.wait(demo.all_ready, "a jump under way disturbs nobody")

    old = [child for child in psutil.Process(demo.process.pid).children() if child.is_running()]
    for child in old:
        child.send_signal(signal.SIGKILL)
    psutil.wait_procs(old, timeout=HANGS_S)
    demo.wait(demo.all_ready, "every process is ready again")

    now = {path.name: path.stat().st_size for path in recordings.glob("*.mcap")}
    assert earlier.name in now and now[first.name] > 1000
    assert len(now) == 3, now
