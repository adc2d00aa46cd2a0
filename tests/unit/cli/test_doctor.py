"""`obu doctor` reports faults with their remedies."""

from pathlib import Path

import pytest

from cli import doctor
from tests.support.bus import brokers


def test_a_missing_broker_is_reported_with_its_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    monkeypatch.setenv("OBU_BROKER", "mqtt://127.0.0.1:1")
    assert doctor.examine(None) == 1
    printed = capsys.readouterr().out
    assert "NO  broker at 127.0.0.1:1" in printed and "OBU_BROKER" in printed
    assert "ok  [core.fusion]" in printed


def test_a_broker_without_a_unit_is_reported_with_its_remedy(
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


def test_an_invalid_setting_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    monkeypatch.setenv("OBU_BROKER", "mqtt://127.0.0.1:1")
    vehicle = tmp_path / "vehicle.toml"
    vehicle.write_text("[core.fusion]\nlever_arm_m = [0, 0, 0]\n")
    assert doctor.examine(vehicle) == 1
    assert "gnss.lever_arm_" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("sections", "faults"),
    [
        ("", set()),
        ("[sensors.v2x]\n[parsers.v2x]\n", set()),
        ("[sensors.v2x]\n", {"CAM codec"}),
        ("[sensors.v2x]\n[parsers.v2x]\n[controller.cam]\n", {"own CAM is sent"}),
        ('[sensors.v2x]\nsend_to = "udp://127.0.0.1:5"\n[parsers.v2x]\n[controller.cam]\n', set()),
        ('[sensors.v2x]\ndevice = "mqtt://127.0.0.1:5/a"\n[parsers.v2x]\n[controller.cam]\n', set()),
        ("[controller.cam]\n", {"CAM codec", "own CAM is sent"}),
    ],
)
def test_sections_of_v2x_that_do_not_fit_together_are_reported(
    sections: str,
    faults: set[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    monkeypatch.setenv("OBU_BROKER", "mqtt://127.0.0.1:1")
    vehicle = tmp_path / "vehicle.toml"
    vehicle.write_text(sections)
    doctor.examine(vehicle)
    printed = capsys.readouterr().out.splitlines()
    assert {what for what in ("CAM codec", "own CAM is sent") if f"NO  {what}" in printed} == faults


def test_a_store_that_the_broker_set_aside_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    monkeypatch.setenv("OBU_BROKER", "mqtt://127.0.0.1:1")
    (tmp_path / "broker").mkdir()
    (tmp_path / "broker" / "mosquitto.db.unreadable").write_bytes(bytes(8))
    assert doctor.examine(None) == 1
    assert "NO  the broker could not read its store, and started without it" in capsys.readouterr().out
