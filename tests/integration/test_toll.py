"""The road-side unit as `obu demo --role rsu` runs it, with kill -9 of both processes that charge."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from cli.verify_toll import differences_of, is_continued, parse, read
from tests.support.patience import HANGS_S

pytestmark = [pytest.mark.whole_unit, pytest.mark.broker, pytest.mark.slow]

DURATION_S = 75.0
VICTIMS = ("core.toll", "monitoring.ledger")


def child(demo: subprocess.Popen[str], name: str) -> psutil.Process | None:
    for process in psutil.Process(demo.pid).children(recursive=True):
        if " ".join(process.cmdline()).strip().endswith(f" run {name}"):
            return process
    return None


def test_with_killed_processes_no_vehicle_is_charged_twice_and_each_charge_is_recomputed(tmp_path: Path) -> None:
    demo = subprocess.Popen(
        [sys.executable, "-m", "cli", "demo", "--role", "rsu", "--vehicles", "60", "--duration", str(DURATION_S),
         "--port", "0", "--json"],
        env={**os.environ, "OBU_STATE": str(tmp_path)}, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    kills = 0
    try:
        ledger = tmp_path / "demo" / "toll" / "ledger.sqlite"
        deadline = time.monotonic() + HANGS_S
        while not ledger.exists() and time.monotonic() < deadline:
            time.sleep(0.2)
        time.sleep(12.0)
        for n in range(6):
            victim = child(demo, VICTIMS[n % 2])
            if victim is not None:
                victim.send_signal(signal.SIGKILL)
                kills += 1
            time.sleep(5.0)
        output, _ = demo.communicate(timeout=DURATION_S + 60.0)
    finally:
        demo.kill()
    result = json.loads(output)
    assert kills >= 5 and result["restarts"] >= 5
    assert result["double_charges"] == result["wrong_charges"] == 0
    assert result["transactions"] > 3
    assert result["lane_decisions_right"] >= 0.95 * result["lane_decisions"]
    evidence = list(read(ledger))
    assert len(evidence) >= result["transactions"]
    packs = [(each, parse(each)) for each in evidence]
    derived = {pack.charged.passage_id: differences_of(each, pack) for each, pack in packs}
    whole = [pack.charged.passage_id for _, pack in packs if not is_continued(pack)]
    assert whole
    assert not [text for passage_id in whole for text in derived[passage_id]]
    other = [text for passage_id, texts in derived.items() if passage_id not in whole for text in texts]
    assert not [text for text in other if not text.startswith("cannot be derived: the crossing lies")]
