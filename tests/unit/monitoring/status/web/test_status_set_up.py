"""The set-up over the web: what is confirmed outlives the process, and surveys run one at a time."""

import json
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from fastapi import HTTPException

from services.monitoring.status.web.set_up import KEPT_FILE, RESULT_FILE, applied, drawn_code, enrolment_page
from tests.support.cases import each
from tests.support.dashboard.status_server import RunningServer, change, eventually, status_server


@pytest.fixture
def server(tmp_path: Path) -> Iterator[RunningServer]:
    with status_server(tmp_path, unit=False) as running:
        yield running


def report(server: RunningServer) -> dict[str, object]:
    found: dict[str, object] = httpx.get(f"{server.address}/api/set-up?step=imu", timeout=30).json()
    return found


def states(server: RunningServer) -> dict[str, str]:
    steps = report(server)["steps"]
    assert isinstance(steps, list)
    return {step["name"]: step["state"] for step in steps}


def test_a_confirmed_step_is_kept_by_the_unit(tmp_path: Path) -> None:
    with status_server(tmp_path, unit=False) as running:
        assert states(running)["unit"] == "not_done"
        assert change(running.address, "/api/set-up", {"action": "confirm", "step": "unit"}).status_code == 202
        assert states(running)["unit"] == "agrees"
    with status_server(tmp_path, unit=False) as running:
        assert states(running)["unit"] == "agrees"


@each(
    ("body", "status"),
    [
        ({"action": "confirm", "step": "drive"}, 422),
        ({"action": "confirm"}, 422),
        ({"action": "erase"}, 422),
        ({"action": "measure", "recording": "/etc/passwd"}, 422),
        ([], 422),
        ({"action": "measure"}, 404),
    ],
)
def test_what_cannot_be_done_is_refused(body: object, status: int, tmp_path: Path) -> None:
    with status_server(tmp_path, unit=False) as running:
        assert change(running.address, "/api/set-up", body).status_code == status


def test_a_recording_that_cannot_be_surveyed_is_said_and_the_result_before_stays(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    folder.mkdir()
    (folder / "20260101T000000Z_car.mcap").write_bytes(b"no recording")
    (tmp_path / "jobs").mkdir()
    (tmp_path / "jobs" / RESULT_FILE).write_text(json.dumps({"findings": [{"verdict": "contradicts"}]}))
    with status_server(tmp_path, unit=False) as running:

        def survey() -> dict[str, object]:
            found = report(running)["survey"]
            assert isinstance(found, dict)
            return found

        eventually(lambda: survey()["recording"] is not None)
        assert change(running.address, "/api/set-up", {"action": "measure"}).status_code == 202
        assert change(running.address, "/api/set-up", {"action": "measure"}).status_code in (202, 409)
        eventually(lambda: not survey()["running"])
        assert survey()["failed"] is True and survey()["result"] is not None
        assert states(running)["drive"] == "contradicts"


@each("text", ["", "{", "[1]", '{"findings": 3}', '{"unit": "yes", "else": 1}', "\x00" * 50, '{"a":' * 5000])
def test_files_that_somebody_has_spoilt_are_as_none(text: str, tmp_path: Path) -> None:
    (tmp_path / "jobs").mkdir(exist_ok=True)
    for path in (tmp_path / KEPT_FILE, tmp_path / "jobs" / RESULT_FILE):
        path.write_text(text)
    with status_server(tmp_path, unit=False) as running:
        found = states(running)
    assert found["unit"] == "not_done" and found["drive"] == "not_done"


def test_a_finding_is_applied_when_all_its_settings_hold() -> None:
    result: dict[str, object] = {
        "findings": [
            {"quantity": "delay", "changes": {"core.fusion.gnss.delay_s": 0.2}},
            {"quantity": "mounting", "changes": {}},
            {"quantity": "lever_arm", "changes": {"vehicle.gnss.lever_arm_body_m": [0.3, 0.0, -1.0]}},
        ]
    }
    held = {"core.fusion.gnss.delay_s": "0.2", "vehicle.gnss.lever_arm_body_m": "[0.3, 0.0, 0.0]"}
    assert applied(result, held) == ["delay"]
    assert applied({}, held) == applied(None, held) == []


def test_a_working_unit_shows_its_devices_level_and_speeds(tmp_path: Path) -> None:
    with status_server(tmp_path) as running:
        eventually(lambda: report(running)["level"] is not None)
        found = report(running)
        assert found["moving"] is True
        eventually(lambda: report(running)["signals"])
        signals = report(running)["signals"]
        assert isinstance(signals, list) and signals[0]["topic"] == "vehicle/wheel_speed"


def test_a_code_holds_the_name_of_the_unit_and_no_secret() -> None:
    assert enrolment_page("https://centre.example:8090/", "van-3") == "https://centre.example:8090/#/enrolment/van-3"
    assert drawn_code("https://centre.example/#/enrolment/van-3").startswith(b"<?xml")


@each(
    ("centre", "name"),
    [
        ("http://centre.example", "van"), ("https://", "van"), ("https://a@b", "van"), ("https://a/x", "van"),
        ("https://a?b=c", "van"), ("https://a#b", "van"), ("https://a:x", "van"), ("https://[", "van"), ("", "van"),
        ("https://a", "my van"), ("https://a", "-van"), ("https://a", ""),
    ],
)  # fmt: skip
def test_what_leads_to_no_centre_is_drawn_as_no_code(centre: str, name: str) -> None:
    with pytest.raises(HTTPException) as refused:
        enrolment_page(centre, name)
    assert refused.value.status_code == 422


def test_without_the_drive_that_was_surveyed_there_is_no_certificate(tmp_path: Path) -> None:
    (tmp_path / "jobs").mkdir()
    (tmp_path / "jobs" / RESULT_FILE).write_text(json.dumps({"recording": "../../etc/passwd", "findings": []}))
    with status_server(tmp_path, unit=False) as running:
        for form, status in (("pdf", 404), ("json", 404), ("exe", 422)):
            assert httpx.get(f"{running.address}/api/set-up/certificate?form={form}").status_code == status


def test_a_drive_that_cannot_be_read_gives_no_certificate_and_leaves_no_folder(tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()
    name = "20260101T000000Z_car.mcap"
    (tmp_path / "recordings" / name).write_bytes(b"no recording")
    (tmp_path / "jobs").mkdir()
    (tmp_path / "jobs" / RESULT_FILE).write_text(json.dumps({"recording": name, "findings": []}))
    with status_server(tmp_path, unit=False) as running:
        eventually(lambda: report(running)["survey"]["recording"] is not None)  # type: ignore[index]
        answer = httpx.get(f"{running.address}/api/set-up/certificate", timeout=60)
    assert answer.status_code == 500 and name in answer.json()["detail"]
    assert not list((tmp_path / "jobs").glob("made-*"))
