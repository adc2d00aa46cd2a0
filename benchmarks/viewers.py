"""Load of `monitoring.status` by the number of dashboards: `python -m benchmarks.viewers`.

The process runs as in a vehicle, on the messages of the pretended unit of the tests; the clients only read.
"""

import asyncio
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil
from websockets.asyncio.client import connect

from benchmarks import tables
from shared.runtime.config import ADDRESS_FILE

HEAD = """# Load of the dashboard's server by the number of viewers

Printed by `python -m benchmarks.viewers`: `monitoring.status` on the messages of the pretended unit of the tests (160 a
second; memory includes that unit), on a machine with two cores that others use too. The dashboard takes packed frames.

"""
RESULTS = Path(__file__).parent / "results"
CLIENTS = (0, 1, 20, 100)
SETTLE_S, MEASURE_S = 3.0, 15.0
SERVER = """
import sys, threading
from pathlib import Path
from services.monitoring.status.process import Config, Process
from tests.support.dashboard.fake_unit import FakeBus, FakeUnit
bus = FakeBus(Path(sys.argv[1]))
unit = FakeUnit(bus)
threading.Thread(target=lambda: (sys.stdin.readline(), setattr(bus, "stopping", True)), daemon=True).start()
Process(Config(port=0)).run(bus)
"""


async def read(address: str, counted: list[int]) -> None:
    """Count the bytes that one client is sent."""
    async with connect(address, max_size=None, compression=None) as socket:
        async for frame in socket:
            counted[0] += len(frame)


async def measure(server: psutil.Process, address: str, clients: int) -> dict[str, float]:
    """Give the server's CPU [share of a core], its memory and the bytes a second of one client."""
    counted = [[0] for _ in range(clients)]
    tasks = [asyncio.create_task(read(address, count)) for count in counted]
    await asyncio.sleep(SETTLE_S)
    before, cpu_s, started = sum(c[0] for c in counted), sum(server.cpu_times()[:2]), time.monotonic()
    await asyncio.sleep(MEASURE_S)
    elapsed_s = time.monotonic() - started
    sent = sum(c[0] for c in counted) - before
    cpu = (sum(server.cpu_times()[:2]) - cpu_s) / elapsed_s
    rss = server.memory_info().rss
    lost = sum(task.done() for task in tasks)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    return {
        "clients": clients,
        "lost": lost,
        "cpu_share": round(cpu, 3),
        "rss_mb": round(rss / 1e6, 1),
        "kb_s_per_client": round(sent / elapsed_s / clients / 1000, 2) if clients else 0.0,
    }


def main() -> None:
    """Measure each number of clients, plain and packed, and write the table."""
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", SERVER, folder]
        with subprocess.Popen(command, stdin=subprocess.PIPE) as process:
            file = Path(folder) / ADDRESS_FILE
            while not (file.exists() and file.read_text().endswith("/")):
                time.sleep(0.1)
            address = file.read_text().replace("http", "ws") + "ws"
            server = psutil.Process(process.pid)
            for suffix, form in (("", "plain"), ("?packed=1", "packed")):
                for clients in CLIENTS:
                    row = asyncio.run(measure(server, address + suffix, clients))
                    rows.append({"form": form, **row})
                    print(rows[-1], flush=True)
            assert process.stdin is not None
            process.stdin.close()
    (RESULTS / "viewers.json").write_text(json.dumps(rows, indent=1) + "\n")
    lines = ["| frames | clients | CPU, % of a core | RSS, MB | kB/s for each |", "| --- | --- | --- | --- | --- |"]
    lines += [
        f"| {r['form']} | {r['clients']} | {100 * r['cpu_share']:.1f} | {r['rss_mb']} | {r['kb_s_per_client']} |"
        for r in rows
    ]
    tables.publish(RESULTS / "viewers.md", HEAD + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
