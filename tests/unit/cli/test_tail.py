"""Topic names of `obu tail`."""

from pathlib import Path

import pytest

from cli.tail import follow
from shared.bus.bus import Bus
from shared.errors import UserError
from shared.messages.operation import ProcessState
from shared.runtime.config import BrokerAddress, parse_vehicle
from tests.support.bus import brokers

CAR = parse_vehicle("[vehicle]\nname = 'car'\n")


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("solution", "navigation/solution"),
        ("obu/car/imu/raw", "imu/raw"),
        ("navigation/soluton", "navigation/solution"),
    ],
)
def test_an_unknown_topic_is_reported_with_the_most_similar_one(name: str, meant: str) -> None:
    with pytest.raises(UserError, match=f"did you mean {meant}\\? `obu topics` lists them"):
        follow(name, CAR, 1)


def test_a_topic_of_one_process_prints_that_process_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broker = brokers.start(brokers.SIMULATED, tmp_path)
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    monkeypatch.setenv("OBU_BROKER", f"mqtt://127.0.0.1:{broker.port}")
    address = BrokerAddress("127.0.0.1", broker.port)
    buses = [Bus(name, "car", address, (), tmp_path) for name in ("parsers.gnss", "core.fusion")]
    try:
        for bus in buses:
            while not bus.connected:
                bus.receive(0.02)
            bus.publish(bus.health(ProcessState.READY))
            bus.receive(0.1)
        assert follow("health/core.fusion", CAR, 1) == 0
    finally:
        for bus in buses:
            bus.close()
        broker.stop()
    printed = capsys.readouterr().out
    assert '"topic": "health/core.fusion"' in printed and "parsers.gnss" not in printed
