"""A computer that is too slow: the position goes on, checks are paused, and nothing is SAFE that is not checked.

Judged are stamps and states of the unit, never a time of this machine.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from shared.bus.bus import Bus
from shared.load import CHECKS
from shared.messages.navigation import NavigationPhase, NavigationSolution
from shared.messages.operation import ProcessLoad
from shared.messages.trust import TrustLevel, TrustState
from shared.runtime.config import BrokerAddress
from shared.topics import TOPICS
from tests.integration.test_demo import Demo, start_demo
from tests.support.patience import HANGS_S

pytestmark = [pytest.mark.whole_unit, pytest.mark.broker, pytest.mark.slow]

OLDEST_S = 2.0  # age of a position, from which it is none
PERIOD_S = 0.2  # of the turns of a process that is throttled
MEASURED_S, THROTTLED_S = 5.0, 15.0
NAVIGATING = (NavigationPhase.NAVIGATING, NavigationPhase.COASTING)


class Observer:
    """What a unit publishes of position, load and verdict, by arrival."""

    def __init__(self, demo: Demo) -> None:
        address = BrokerAddress.parse(f"mqtt://127.0.0.1:{_broker_port(demo)}")
        names = ("navigation/solution", "health/load", "trust/state")
        self._bus = Bus("observer", "demo", address, [t for t in TOPICS if t.name in names], demo.folder, observer=True)
        self.ages_s: list[float] = []  # largest age of each position until the next one
        self.loads: list[ProcessLoad] = []
        self.verdicts: list[tuple[TrustState, bool]] = []  # and whether checks were paused before
        self._sampled_ns: int | None = None  # of the newest position

    def until(self, condition: object, limit_s: float = HANGS_S) -> bool:
        """Receive until a condition holds; whether it came to hold."""
        assert callable(condition)
        end = time.monotonic() + limit_s
        while not condition() and time.monotonic() < end:
            self.receive()
        return bool(condition())

    def receive(self) -> None:
        """Take what has arrived."""
        for envelope in self._bus.receive(0.05):
            match message := envelope.decode():
                case NavigationSolution() if message.phase in NAVIGATING:
                    if self._sampled_ns is not None:  # until this one arrived the one before was the newest
                        self.ages_s.append((envelope.received_ns - self._sampled_ns) * 1e-9)
                    self._sampled_ns = message.sampled_ns
                case ProcessLoad():
                    self.loads.append(message)
                case TrustState():
                    self.verdicts.append((message, self.checks_paused))
                case _:
                    pass

    @property
    def checks_paused(self) -> bool:
        return bool(self.loads) and any(work in CHECKS for work in self.loads[-1].paused)

    @property
    def level(self) -> TrustLevel | None:
        return self.verdicts[-1][0].state if self.verdicts else None

    def close(self) -> None:
        self._bus.close()


def _broker_port(demo: Demo) -> int:
    [port] = {
        int(address.laddr.port)
        for address in demo.child("mosquitto").net_connections("inet")
        if address.status == psutil.CONN_LISTEN
    }
    return port


@contextmanager
def throttled(process: psutil.Process, share: float) -> Iterator[None]:
    """Let a process run for a share of the time only, in short turns, however much it would need."""
    over = threading.Event()

    def turns() -> None:
        while not over.is_set():
            before, began = process.cpu_times(), time.monotonic()
            process.send_signal(signal.SIGCONT)
            while sum(process.cpu_times()[:2]) - sum(before[:2]) < share * PERIOD_S and not over.wait(0.005):
                pass
            process.send_signal(signal.SIGSTOP)
            over.wait(max(0.0, began + PERIOD_S - time.monotonic()))

    thread = threading.Thread(target=turns)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        process.send_signal(signal.SIGCONT)


@contextmanager
def busy_processors() -> Iterator[None]:
    """Run two programs a processor that never wait."""
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2 * (os.cpu_count() or 1))]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def test_fusion_with_half_of_the_processor_time_it_needs_keeps_a_position_and_is_repeatable(tmp_path: Path) -> None:
    demo = start_demo(tmp_path, "--broker", "mosquitto")
    observer: Observer | None = None
    try:
        demo.wait(demo.all_ready, "every process is ready")
        observer = Observer(demo)
        assert observer.until(lambda: observer.level is TrustLevel.SAFE)
        fusion = demo.child("core.fusion")
        before = sum(fusion.cpu_times()[:2])
        observer.until(lambda: False, MEASURED_S)
        needed = (sum(fusion.cpu_times()[:2]) - before) / MEASURED_S
        observer.ages_s.clear()
        with throttled(fusion, 0.5 * needed):  # of what it needs beside others, which may end meanwhile
            assert observer.until(lambda: any(load.paused for load in observer.loads)), "nothing was paused"
            observer.until(lambda: False, THROTTLED_S)
        late = [age_s for age_s in observer.ages_s if age_s > OLDEST_S]
        assert len(observer.ages_s) > THROTTLED_S and not late, f"positions {late} s old"
        observer.ages_s.clear()
        with busy_processors():
            observer.until(lambda: False, THROTTLED_S)
        late = [age_s for age_s in observer.ages_s if age_s > OLDEST_S]
        assert len(observer.ages_s) > THROTTLED_S and not late, f"positions {late} s old beside busy programs"
        assert observer.until(lambda: observer.level is TrustLevel.SAFE and not observer.checks_paused)
        first_safe = next(i for i, (v, _) in enumerate(observer.verdicts) if v.state is TrustLevel.SAFE)
        wrong = [v for v, paused in observer.verdicts[first_safe:] if paused and v.state is TrustLevel.SAFE]
        assert len(wrong) <= 1, "SAFE while checks were paused"  # one that was on its way
        assert all(v.state is not TrustLevel.UNSAFE for v, _ in observer.verdicts)
    finally:
        if observer is not None:
            observer.close()
        demo.process.terminate()
        demo.process.communicate(timeout=HANGS_S)
    [recording] = (demo.folder / "recordings").glob("*.mcap")
    repeated = subprocess.run(
        [sys.executable, "-m", "cli", "verify", str(recording), "--process", "core.fusion"],
        env=os.environ | {"OBU_STATE": str(demo.folder)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "identical" in repeated.stdout, repeated.stdout + repeated.stderr
