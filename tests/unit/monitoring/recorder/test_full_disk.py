import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.patience import HANGS_S

REPOSITORY = Path(__file__).resolve().parents[4]
IN_A_NAMESPACE = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-ec"]
ON_A_SMALL_DISK = """
import os, random, sys
from pathlib import Path
from services.monitoring.recorder.process import Config, Process
from shared.messages.operation import RecordingState
from shared.recording import Recording
from tests.support.bus.envelopes import sent_bytes
from tests.support.bus.fake_bus import FakeBus

disk = Path(sys.argv[1])
rng = random.Random(1)

def body():
    return b'{"noise":"%s"}' % rng.randbytes(1300).hex().encode()

def script(call):
    if call == 120:
        (disk / "filler").unlink()
    if call == 40:
        room = os.statvfs(disk).f_bavail * 4096
        (disk / "filler").write_bytes(bytes(room - 20_000))
    return [sent_bytes("mode/state", body(), call, "controller.mode", 1, call)] if call < 250 else None

bus = FakeBus(disk, script, start_ns=10**18)
Process(Config(minimum_free_bytes=0)).run(bus.as_bus())
states = [m for m in bus.published if isinstance(m, RecordingState)]
found = []
for path in sorted((disk / "recordings").glob("*.mcap")):
    with Recording(path) as recording:
        found += [m.sequence for m in recording]
stopped = [s for s in states if not s.recording]
assert 4 <= len(stopped) <= 12, len(stopped)
FULL = {"quoted": "No space left on device"}
assert all(s.reason_code.model_dump()["values"]["error"] == FULL for s in stopped), {s.reason for s in stopped}
assert found[:35] == list(range(35))
assert found[-70:] == list(range(180, 250))
assert found == sorted(set(found))
assert states[-1].recording
print("resumed after", len(stopped), "s")
"""


def test_on_a_disk_that_is_really_full_the_recorder_waits_and_resumes(tmp_path: Path) -> None:
    small = f"mount -t tmpfs -o size=1m none {tmp_path}"
    if subprocess.run([*IN_A_NAMESPACE, small], capture_output=True, check=False).returncode:
        pytest.skip("this system lets no ordinary user mount a small disk")

    command = [*IN_A_NAMESPACE, f'{small} && exec "$@"', "sh", sys.executable, "-c", ON_A_SMALL_DISK, str(tmp_path)]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, timeout=HANGS_S, check=False)

    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("resumed after")
