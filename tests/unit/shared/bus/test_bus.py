import subprocess
import sys
from pathlib import Path

import pytest

from cli.demo.local import free_port
from shared.runtime.last_end import LastEnd
from tests.support.patience import HANGS_S

HUNG = """
import sys, time
from pathlib import Path
from shared.bus import bus
from shared.runtime.config import BrokerAddress

bus.HUNG_S, bus.HEARTBEAT_S = 0.3, 0.05
link = bus.Bus("core.fusion", "test", BrokerAddress("127.0.0.1", int(sys.argv[1])), (), Path(sys.argv[2]))
link.guard()

def lost_in_thought():
    time.sleep(30.0)

until = time.monotonic() + 1.0
while time.monotonic() < until:
    link.receive(0.02)
print("alive", flush=True)
if sys.argv[3] == "hang":
    lost_in_thought()
link.close()
time.sleep(0.6)
"""


def ended(folder: Path, how: str) -> "subprocess.CompletedProcess[str]":
    """Run a process that serves the bus for three times as long as it may hang, and then hangs or closes."""
    command = [sys.executable, "-c", HUNG, str(free_port()), str(folder), how]
    return subprocess.run(command, capture_output=True, text=True, timeout=HANGS_S, check=False)


def test_a_hung_process_ends_itself_and_its_next_run_tells_where_it_hung(tmp_path: Path) -> None:
    result = ended(tmp_path, "hang")
    assert result.stdout == "alive\n", "it runs while it serves the bus, with or without a broker"
    assert result.returncode == 1
    following = ended(tmp_path, "close")
    assert "lost_in_thought" in following.stderr, "the stack is in the log"
    assert "the run before was ended by its watchdog: it hung, in lost_in_thought" in following.stderr
    assert not list((tmp_path / "ends").iterdir()), "a run that ends as it should leaves nothing"


def test_without_room_for_its_file_a_hung_process_logs_its_stack_itself(tmp_path: Path) -> None:
    (tmp_path / "ends").write_text("no folder")
    result = ended(tmp_path, "hang")
    assert result.returncode == 1 and "lost_in_thought" in result.stderr


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", None),
        ("\n", None),
        ("ValueError: no such antenna\n", "the run before ended by ValueError: no such antenna"),
        ("Timeout (0:00:20)!\nThread 0x1:\n", "the run before was ended by its watchdog: it hung"),
    ],
)
def test_why_a_run_ended_is_one_sentence_for_the_next(tmp_path: Path, text: str, reason: str | None) -> None:
    (tmp_path / "ends").mkdir()
    (tmp_path / "ends" / "core.fusion.txt").write_text(text)
    end = LastEnd(tmp_path, "core.fusion")
    end.begin()
    assert end.reason == reason
    end.failed(RuntimeError("again"))
    other = LastEnd(tmp_path, "core.fusion")
    other.begin()
    assert other.reason == "the run before ended by RuntimeError: again"
    other.close()


def test_a_process_that_has_left_the_bus_is_not_monitored(tmp_path: Path) -> None:
    result = ended(tmp_path, "close")
    assert (result.returncode, result.stdout) == (0, "alive\n")
