from pathlib import Path

import pytest

from services.monitoring.health.process import Config, Process
from services.monitoring.health.watch import Watch
from shared.bus import codec
from shared.bus.bus import Envelope
from shared.messages.operation import DeadlineReport, Outage, ProcessHealth, ProcessState
from tests.support.bus.envelopes import sent_bytes
from tests.support.bus.fake_bus import FakeBus

START_NS = 1_790_000_000_000_000_000
STEP_NS = 40_000_000


def heartbeat(call: int, process: str = "core.fusion", payload: bytes | None = None) -> Envelope:
    now_ns = START_NS + (call + 1) * STEP_NS
    health = ProcessHealth(process=process, state=ProcessState.READY, incarnation=1, sent_ns=now_ns)
    return sent_bytes(f"health/{process}", payload or codec.encode(health), now_ns, process, 1, call)


def test_reports_come_twice_a_second_and_outages_when_they_happen(tmp_path: Path) -> None:
    def script(call: int) -> list[Envelope] | None:
        if call >= 800:
            return None
        return [heartbeat(call, "core.fusion" if call < 500 else "parsers.imu")]

    bus = FakeBus(tmp_path, script, start_ns=START_NS, step_ns=STEP_NS)
    bus.vehicle_toml = ""
    Process(Config()).run(bus.as_bus())

    reports = [message for message in bus.published if isinstance(message, DeadlineReport)]
    outages = [message for message in bus.published if isinstance(message, Outage)]
    assert 58 <= len(reports) <= 66
    assert [outage.what for outage in outages] == ["core.fusion"]
    assert {age.process: age.status for age in reports[-1].processes}["core.fusion"] == "stale"


def test_a_bad_heartbeat_is_counted_and_nothing_else_happens(tmp_path: Path) -> None:
    bad = [heartbeat(0, payload=b"{"), heartbeat(1, payload=b'{"process":"core.fusion"}')]
    bus = FakeBus(tmp_path, lambda call: bad if call == 0 else None, start_ns=START_NS)
    Process(Config()).run(bus.as_bus())

    assert bus.rejects == {"payload": 2}
    assert bus.last_error is not None


def test_a_heartbeat_that_cannot_be_handled_costs_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise OverflowError("too large")

    monkeypatch.setattr(Watch, "take_health", fails)
    bus = FakeBus(tmp_path, lambda call: [heartbeat(call)] if call < 2 else None, start_ns=START_NS)
    Process(Config()).run(bus.as_bus())
    assert bus.rejects == {"fault": 2}


def test_nothing_is_judged_before_the_broker_was_met(tmp_path: Path) -> None:
    bus = FakeBus(tmp_path, lambda call: [] if call < 5000 else None, start_ns=START_NS)
    bus.connected, bus.sequence = False, 0
    Process(Config()).run(bus.as_bus())

    assert bus.published == []


def test_the_wills_of_all_before_the_connection_ends_are_the_broker_shutting_down(tmp_path: Path) -> None:
    def script(call: int) -> list[Envelope] | None:
        bus.connected = call < 50 or call >= 80
        if call == 49:
            wills = [
                codec.encode(ProcessHealth(process=name, state=ProcessState.LOST, incarnation=1, sent_ns=1))
                for name in ("core.fusion", "parsers.imu")
            ]
            return [heartbeat(call, "core.fusion", wills[0]), heartbeat(call, "parsers.imu", wills[1])]
        alive = [heartbeat(call, "core.fusion"), heartbeat(call, "parsers.imu")] if bus.connected else []
        return [envelope._replace(received_ns=bus.now_ns()) for envelope in alive] if call < 800 else None

    bus = FakeBus(tmp_path, script, start_ns=START_NS, step_ns=STEP_NS // 8)
    bus.vehicle_toml = ""
    Process(Config()).run(bus.as_bus())

    assert {message.what for message in bus.published if isinstance(message, Outage)} == {"broker"}
