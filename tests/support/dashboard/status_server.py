"""The status process as it is, on a free port, with the simulated unit instead of a broker."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import httpx

from services.monitoring.status.process import Config, Process
from shared.bus.bus import Bus
from shared.runtime.config import ADDRESS_FILE
from tests.support.dashboard.fake_unit import FakeBus, FakeUnit
from tests.support.patience import HANGS_S
from tests.support.v2x.fake_plaza import FakePlaza


@dataclass
class RunningServer:
    """A server that runs, and the strings that move its unit."""

    address: str
    bus: FakeBus
    unit: FakeUnit | None
    thread: threading.Thread

    def stop(self) -> None:
        """End the process as SIGTERM would."""
        self.bus.stopping = True
        self.thread.join(HANGS_S)
        assert not self.thread.is_alive(), "the process does not end"


@contextmanager
def status_server(
    state_dir: Path,
    *,
    unit: bool = True,
    plaza: FakePlaza | None = None,
    offset_ns: int | None = None,
    **settings: object,
) -> Iterator[RunningServer]:
    """Run the status process of a vehicle or of a plaza; its address is known when the block begins.

    With `offset_ns` of an earlier bus the time line goes on.
    """
    bus = FakeBus(state_dir)
    bus.offset_ns = bus.offset_ns if offset_ns is None else offset_ns
    if plaza is not None:
        plaza.join(bus)
    fake = FakeUnit(bus) if unit and plaza is None else None
    process = Process(Config.model_validate({"port": 0, **settings}))
    thread = threading.Thread(target=process.run, args=(cast(Bus, bus),), daemon=True)
    thread.start()
    file = state_dir / ADDRESS_FILE
    eventually(lambda: file.exists() and file.read_text().endswith("/"))
    running = RunningServer(file.read_text().rstrip("/"), bus, fake, thread)
    try:
        yield running
    finally:
        running.stop()


def change(address: str, path: str, body: object, **headers: str) -> httpx.Response:
    """Send a change as a page does, with the value of /api/session."""
    csrf = httpx.get(f"{address}/api/session", timeout=HANGS_S).json()["csrf"]
    return httpx.post(f"{address}{path}", json=body, headers={"X-OBU-CSRF": csrf, **headers}, timeout=HANGS_S)


def eventually(condition: Callable[[], object], *, within_s: float = HANGS_S) -> None:
    """Wait until something holds."""
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline, f"did not come true within {within_s} s"
        time.sleep(0.02)
