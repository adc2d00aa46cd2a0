import subprocess
import sys
from pathlib import Path

from cli.demo.local import free_port

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
    return subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)


def test_a_hung_process_ends_itself_and_logs_its_stack(tmp_path: Path) -> None:
    result = ended(tmp_path, "hang")
    assert result.stdout == "alive\n", "it runs while it serves the bus, with or without a broker"
    assert result.returncode == 1
    assert "lost_in_thought" in result.stderr


def test_a_process_that_has_left_the_bus_is_not_monitored(tmp_path: Path) -> None:
    result = ended(tmp_path, "close")
    assert (result.returncode, result.stdout) == (0, "alive\n")
