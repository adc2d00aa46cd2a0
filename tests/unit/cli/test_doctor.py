"""`obu doctor` finds what is wrong and says what to do."""

from pathlib import Path

import pytest

from cli import doctor
from tests.support import brokers


def test_a_machine_without_a_broker_is_told_to_start_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    monkeypatch.setenv("OBU_BROKER", "mqtt://127.0.0.1:1")
    assert doctor.examine(None) == 1
    said = capsys.readouterr().out
    assert "NO  broker at 127.0.0.1:1" in said and "OBU_BROKER" in said
    assert "ok  [core.fusion]" in said


def test_a_broker_without_a_unit_asks_for_the_vehicles_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broker = brokers.start(brokers.SIMULATED, tmp_path)
    try:
        monkeypatch.setenv("OBU_STATE", str(tmp_path))
        monkeypatch.setenv("OBU_BROKER", f"mqtt://127.0.0.1:{broker.port}")
        assert doctor.examine(None) == 1
    finally:
        broker.stop()
    assert "NO  processes of 'vehicle'" in capsys.readouterr().out


def test_a_wrong_setting_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    monkeypatch.setenv("OBU_BROKER", "mqtt://127.0.0.1:1")
    vehicle = tmp_path / "vehicle.toml"
    vehicle.write_text("[core.fusion]\nlever_arm_m = [0, 0, 0]\n")
    assert doctor.examine(vehicle) == 1
    assert "lever_arm_body_m" in capsys.readouterr().out
