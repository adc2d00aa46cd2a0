"""The page Set up, in a real browser: steps, the antenna in cm, a drive whose findings one press applies."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from services.monitoring.status.web.set_up import KEPT_FILE, RESULT_FILE
from shared.messages.settings import SettingsAction, SettingsCatalogue, SettingsCommand, SettingsState
from shared.runtime.config import parse_vehicle
from shared.settings.check import digests, rows
from tests.browser.test_pages import judge_everywhere
from tests.support.dashboard.status_server import RunningServer, eventually, status_server

TEXT = '[vehicle]\nname = "car"\n[sensors.gnss]\ndevice = "serial:///dev/ttyACM0"\n[core.fusion]\n'
ARM, SCALE = "vehicle.gnss.lever_arm_body_m", "core.fusion.odometer.scale"
RESULT = {
    "recording": "a.mcap", "arcs": 20, "bends": 9,
    "findings": [
        {"quantity": "mounting", "verdict": "agrees", "difference": 0.1, "sd": 0.1, "limit": 0.5, "unit": "deg",
         "known": 1.0, "changes": {}},
        {"quantity": "lever_arm", "verdict": "unknown", "difference": 0.3, "sd": 0.2, "limit": 0.05, "unit": "m",
         "known": 0.25, "changes": {}},
        {"quantity": "odometer_scale", "verdict": "contradicts", "difference": -0.04, "sd": 0.0004, "limit": 0.0025,
         "unit": "-", "known": 1.0, "changes": {SCALE: 0.96}},
    ],
    "innovations": {"before": {"odometer": 0.4}, "after": {"odometer": 0.05}},
}  # fmt: skip


@pytest.fixture
def server(tmp_path: Path) -> Iterator[RunningServer]:
    (tmp_path / "jobs").mkdir()
    (tmp_path / "jobs" / RESULT_FILE).write_text(json.dumps(RESULT))
    with status_server(tmp_path, unit=False) as running:
        tell(running, TEXT)
        yield running


def tell(server: RunningServer, text: str) -> None:
    """What controller.settings publishes of a text that holds."""
    file, now_ns = parse_vehicle(text), server.bus.now_ns()
    server.bus.feed(SettingsCatalogue(sampled_ns=now_ns, settings=tuple(rows(file))), "controller.settings")
    server.bus.feed(SettingsState(sampled_ns=now_ns, digests=digests(file)), "controller.settings")


def commands(server: RunningServer) -> list[SettingsCommand]:
    return [message for message in server.bus.published if isinstance(message, SettingsCommand)]


def newest(server: RunningServer) -> dict[str, object]:
    eventually(lambda: commands(server))
    command = commands(server)[-1]
    assert command.action is SettingsAction.APPLY
    return {name: json.loads(value or "null") for name, value in command.changes.items()}


def test_a_lever_arm_in_centimetres_is_written_in_metres_and_confirmed(
    server: RunningServer, open_page: Callable[..., Page], tmp_path: Path
) -> None:
    page = open_page(server.address, theme="phone", path="set_up?step=antenna")
    page.get_by_label("forward [cm]").fill("30")
    page.get_by_label("right [cm]").fill("-12,5")
    page.get_by_label("down [cm]").fill("-120")
    page.get_by_label("Measured to within [cm]").fill("2")
    expect(page.get_by_role("img", name="forward 0.30 m, right -0.13 m, down -1.20 m").first).to_be_visible()
    judge_everywhere(page, "set-up-antenna")
    page.get_by_role("button", name="Apply").click()
    assert newest(server) == {ARM: [0.3, -0.125, -1.2], "vehicle.gnss.lever_arm_sd_m": 0.02}
    page.get_by_role("button", name="This is right").click()
    eventually((tmp_path / KEPT_FILE).exists)
    expect(page.locator("summary", has_text="Antenna")).to_contain_text("confirmed")
    page.reload()
    expect(page.locator("summary", has_text="Antenna")).to_contain_text("measuring, confirmed")


@pytest.mark.parametrize("text", ["", "1e3", "twelve", "9999999"])
def test_what_is_no_length_cannot_be_applied(server: RunningServer, open_page: Callable[..., Page], text: str) -> None:
    page = open_page(server.address, path="set_up?step=antenna")
    page.get_by_label("forward [cm]").fill(text)
    expect(page.get_by_role("button", name="Apply")).to_be_disabled()


def test_one_press_applies_what_a_drive_has_shown_and_what_is_unknown_changes_nothing(
    server: RunningServer, open_page: Callable[..., Page]
) -> None:
    page = open_page(server.address, theme="phone", path="set_up?step=drive")
    expect(page.get_by_text("25 % known")).to_be_visible()
    expect(page.locator(".differences")).to_contain_text(SCALE)
    expect(page.get_by_text("wheel speed").or_(page.get_by_text("odometer: 0.400"))).to_be_visible()
    judge_everywhere(page, "set-up-drive")
    page.get_by_role("button", name="Apply 1 finding").click()
    assert newest(server) == {SCALE: 0.96}
    tell(server, TEXT + "[core.fusion.odometer]\nscale = 0.96\n")
    expect(page.get_by_text("applied", exact=False).first).to_be_visible()
    expect(page.get_by_role("button", name="Apply 1 finding")).to_have_count(0)


def test_the_last_step_offers_the_certificate_and_a_code_for_a_centre(
    server: RunningServer, open_page: Callable[..., Page]
) -> None:
    page = open_page(server.address, theme="phone", path="set_up?step=drive", expected=("404",))
    page.get_by_role("button", name="Download as PDF").click()
    expect(page.get_by_text("Not made: the drive that was surveyed is not there")).to_be_visible()
    address = page.get_by_label("Address of the centre's pages")
    address.fill("http://centre.example")
    expect(page.get_by_text("An address begins with https://")).to_be_visible()
    address.fill("https://centre.example:8090")
    expect(page.get_by_role("img", name="Opens the enrolment of car")).to_be_visible()
    judge_everywhere(page, "set-up-centre")


def test_a_phone_in_german_leads_in_german(server: RunningServer, open_page: Callable[..., Page]) -> None:
    page = open_page(server.address, theme="phone", path="set_up?step=imu", locale="de-DE")
    expect(page.get_by_text("Achse x des Geräts zeigt nach vorn, y nach links, z nach oben")).to_be_visible()


def test_while_the_vehicle_moves_nothing_but_the_drive_is_shown(tmp_path: Path, open_page: Callable[..., Page]) -> None:
    with status_server(tmp_path) as moving:
        page = open_page(moving.address, theme="phone", path="set_up?step=antenna")
        expect(page.get_by_text("only the drive is shown")).to_be_visible()
        expect(page.locator(".set-up-page summary strong")).to_have_text(["The drive"])
