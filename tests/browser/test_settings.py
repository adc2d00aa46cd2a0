"""The page Settings, in a real browser: find, change, check, apply, confirm, take back."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from shared.messages.explanation import explain, topic
from shared.messages.settings import (
    SettingsAction,
    SettingsAnswer,
    SettingsCatalogue,
    SettingsChange,
    SettingsCommand,
    SettingsStage,
    SettingsState,
    SettingsVersion,
)
from shared.runtime.config import parse_vehicle
from shared.settings.check import answer, digests, rows
from shared.settings.question import Question
from tests.browser.test_pages import judge_everywhere
from tests.support.dashboard.status_server import RunningServer, eventually, status_server

TEXT = '[vehicle]\nname = "car"\n[sensors.gnss]\ndevice = "serial:///dev/ttyACM0"\n'
PORT = "sensors.gnss.device"
NS = 1_000_000_000


@pytest.fixture
def server(tmp_path: Path) -> Iterator[RunningServer]:
    with status_server(tmp_path) as running:
        yield running


def tell(server: RunningServer, text: str, change: SettingsChange | None = None) -> None:
    """What controller.settings publishes of a text that holds."""
    file, now_ns = parse_vehicle(text), server.bus.now_ns()
    server.bus.feed(SettingsCatalogue(sampled_ns=now_ns, settings=tuple(rows(file))), "controller.settings")
    versions = (SettingsVersion(number=1, replaced_ns=now_ns, differing=2),) if change else ()
    state = SettingsState(sampled_ns=now_ns, digests=digests(file), change=change, versions=versions)
    server.bus.feed(state, "controller.settings")


def commands(server: RunningServer) -> list[SettingsCommand]:
    return [message for message in server.bus.published if isinstance(message, SettingsCommand)]


def test_without_a_statement_the_page_says_what_it_waits_for(
    server: RunningServer, open_page: Callable[..., Page]
) -> None:
    page = open_page(server.address, path="settings")
    expect(page.get_by_text("The settings are not known yet")).to_be_visible()
    judge_everywhere(page, "settings-empty")


def test_the_port_of_the_receiver_is_found_changed_confirmed_and_taken_back(
    server: RunningServer, open_page: Callable[..., Page]
) -> None:
    tell(server, TEXT)
    page = open_page(server.address, path="settings")
    expect(page.locator(".settings-section").first).to_be_visible()
    page.get_by_label("Find a setting").fill("port or address of the")
    page.get_by_label("Find a setting").fill(PORT)
    field = page.get_by_label("device", exact=True)
    expect(field).to_have_value("serial:///dev/ttyACM0")
    field.fill("serial:///dev/ttyACM1")
    expect(page.get_by_text("1 value is edited")).to_be_visible()
    page.get_by_role("button", name="See what changes").click()
    eventually(lambda: commands(server))
    command = commands(server)[-1]
    assert (command.action, command.changes) == (SettingsAction.CHECK, {PORT: '"serial:///dev/ttyACM1"'})

    found = answer(Question(path="car.toml", text=TEXT, changes=command.changes))
    change = SettingsChange(
        request_id=command.request_id, by="local", stage=SettingsStage.CHECKED, begun_ns=server.bus.now_ns(),
        differences=found.differences, touched=found.touched,
    )  # fmt: skip
    server.bus.feed(SettingsAnswer(sampled_ns=server.bus.now_ns(), change=change), "controller.settings")
    expect(page.get_by_text("These processes start again: sensors.gnss, monitoring.status.")).to_be_visible()
    judge_everywhere(page, "settings-checked")
    page.get_by_role("button", name="Apply").click()
    eventually(lambda: commands(server)[-1].action is SettingsAction.APPLY)

    update = {"request_id": commands(server)[-1].request_id, "stage": SettingsStage.WATCHED, "confirmation": True}
    watched = change.model_copy(update={**update, "until_ns": server.bus.now_ns() + 60 * NS})
    tell(server, found.text, watched)
    newest = page.get_by_role("region", name="Change is being watched")
    expect(newest).to_contain_text("decided in")
    expect(page.get_by_text("1 value is edited")).to_have_count(0)
    expect(field).to_have_value("serial:///dev/ttyACM1")
    newest.get_by_role("button", name="I can reach the page").click()
    eventually(lambda: commands(server)[-1].action is SettingsAction.CONFIRM)
    newest.get_by_role("button", name="Take it back").click()
    eventually(lambda: commands(server)[-1].action is SettingsAction.TAKE_BACK)

    silent = explain("settings.topic_silent", topic("gnss/raw"))
    back = watched.model_copy(update={"stage": SettingsStage.TAKEN_BACK, "until_ns": None, "reasons": (silent,)})
    tell(server, TEXT, back)
    expect(page.get_by_role("region", name="Change was taken back")).to_contain_text("gnss/raw came before the change")
    expect(field).to_have_value("serial:///dev/ttyACM0")
    judge_everywhere(page, "settings-taken-back")


def test_what_is_refused_says_why_and_only_what_differs_is_shown_on_request(
    server: RunningServer, open_page: Callable[..., Page]
) -> None:
    tell(server, TEXT)
    page = open_page(server.address, path="settings")
    page.get_by_label("Only what differs from its default").check()
    expect(page.locator(".setting")).to_have_count(
        len([row for row in rows(parse_vehicle(TEXT)) if row.value != row.default])
    )
    page.get_by_label("Only what differs from its default").uncheck()
    page.get_by_label("Find a setting").fill("core.fusion.gnss.delay_s")
    page.get_by_label("gnss delay s", exact=True).fill("")
    expect(page.get_by_label("gnss delay s", exact=True)).to_have_value("")
    page.get_by_label("gnss delay s", exact=True).fill("99")
    page.get_by_role("button", name="See what changes").click()
    eventually(lambda: commands(server))
    command = commands(server)[-1]
    found = answer(Question(path="car.toml", text=TEXT, changes=command.changes))
    change = SettingsChange(
        request_id=command.request_id, by="local", stage=SettingsStage.REFUSED, begun_ns=server.bus.now_ns(),
        reasons=found.refusals,
    )  # fmt: skip
    server.bus.feed(SettingsAnswer(sampled_ns=server.bus.now_ns(), change=change), "controller.settings")
    expect(page.get_by_text("Not changed: the value cannot be used:")).to_contain_text("less than or equal to 2")
    page.get_by_role("button", name="Discard").click()
    expect(page.get_by_label("gnss delay s", exact=True)).to_have_value("0.0")
