"""A page whose program fails, and pages while processes are killed: the others go on, and the unit is told."""

import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.browser.test_pages import PLAIN_FRAMES, faults, keep_picture
from tests.support.dashboard.fake_unit import EVIDENCE_TESTS, SIMULATED
from tests.support.dashboard.status_server import RunningServer, eventually, status_server

FAILED = "This part of the page cannot be shown"
PAGES = ("now", "map", "gnss", "charts", "trust", "recordings", "system", "settings", "set_up")
KILLED = tuple(name for name in SIMULATED if name != "monitoring.status")  # which serves the pages
STATUS = """async (process) => {
  const { state } = await import(new URL("store.js", document.baseURI));
  return state.value.processes[process].status;
}"""
BROKEN = {
    "drawing": "export function GnssPage() { throw new TypeError('broken for a test'); }",
    "loading": "throw new TypeError('broken for a test');",
    "effect": """import { useEffect } from "preact/hooks";
        const fail = () => { throw new TypeError('broken for a test'); };
        export function GnssPage() { useEffect(fail, []); return 'x'; }""",
}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    with status_server(tmp_path_factory.mktemp("unit")) as running:
        yield running


@pytest.mark.parametrize("broken", BROKEN)
def test_a_page_that_fails_says_so_and_the_others_go_on(
    server: RunningServer, open_page: Callable[..., Page], no_page_fails: list[str], broken: str
) -> None:
    server.bus.rejects.clear()
    page = open_page("about:blank", expected=("broken for a test",))
    page.route("**/gnss/gnss.js", lambda route: route.fulfill(body=BROKEN[broken], content_type="text/javascript"))
    page.goto(f"{server.address}/#/gnss")
    content = page.get_by_role("main")
    expect(content.get_by_role("alert")).to_contain_text(FAILED)
    expect(content.get_by_role("button", name="Reload")).to_be_visible()
    expect(page.locator(".banner .word")).to_have_text("SAFE")
    eventually(lambda: server.bus.rejects["page error"])
    assert re.match(r"page 'gnss': 'TypeError: broken for a test' at 'gnss/gnss.js:\d+", server.bus.last_error or "")
    assert faults(page) == []
    page.get_by_role("link", name="Charts", exact=True).click()
    expect(page.locator(".charts-page canvas").first).to_be_visible()
    expect(page.get_by_text(FAILED)).to_have_count(0)
    page.unroute("**/gnss/gnss.js")
    page.get_by_role("link", name="GNSS").click()
    content.get_by_role("button", name="Reload").click()
    expect(page.get_by_role("heading", name="Sky")).to_be_visible()
    assert server.bus.rejects["page error"] == 1, "each text is reported once in the life of a page"
    assert no_page_fails and all("broken for a test" in text for text in no_page_fails)
    no_page_fails.clear()


def test_a_part_of_the_shell_that_fails_leaves_the_page_and_the_verdict(
    server: RunningServer, open_page: Callable[..., Page], no_page_fails: list[str]
) -> None:
    page = open_page("about:blank", expected=("of null", "of undefined"))
    page.add_init_script(PLAIN_FRAMES)

    def connect(route: Any) -> None:
        def pass_on(text: str) -> None:
            route.send(text.replace('"problems":[', '"no_problems":['))

        route.connect_to_server().on_message(pass_on)

    page.route_web_socket("**/ws", connect)
    page.goto(server.address)
    expect(page.get_by_text(FAILED)).to_have_count(2)  # navigation and footer count the problems
    expect(page.locator(".banner .word")).to_have_text("SAFE")
    expect(page.locator("svg.closeup")).to_be_visible()
    keep_picture(page, "failed-parts")
    assert no_page_fails
    no_page_fails.clear()


def test_the_page_gnss_stands_the_loss_of_its_tests(tmp_path: Path, open_page: Callable[..., Page]) -> None:
    with status_server(tmp_path) as running:
        assert running.unit
        page = open_page(running.address, path="gnss")
        rows = page.get_by_role("region", name="Jamming and spoofing").locator("tbody tr")
        expect(rows).to_have_count(len(EVIDENCE_TESTS))
        running.unit.kill("core.evidence")
        expect(rows).to_have_count(0)
        page.get_by_role("link", name="Charts", exact=True).click()
        expect(page.locator(".charts-page canvas").first).to_be_visible()
        expect(page.locator(".foot")).to_have_count(1)


@pytest.mark.slow
def test_pages_in_turn_stand_the_loss_of_one_process_after_the_other(
    tmp_path: Path, open_page: Callable[..., Page]
) -> None:
    with status_server(tmp_path) as running:
        assert running.unit
        page = open_page(running.address)
        expect(page.locator(".banner .word")).to_have_text("SAFE")
        for place, name in enumerate(PAGES):
            show(page, name)
            for process in KILLED[place :: len(PAGES)]:
                running.unit.kill(process)
            stands(page, name, process)
        expect(page.locator(".banner .word")).not_to_have_text("SAFE")
        for name in PAGES:
            show(page, name)
            stands(page, name, KILLED[-1])


@pytest.mark.slow
def test_every_page_stands_the_loss_of_every_process(tmp_path: Path, open_page: Callable[..., Page]) -> None:
    with status_server(tmp_path) as running:
        assert running.unit
        pages = {name: open_page(running.address, path=name) for name in PAGES}
        for process in KILLED:
            for page in pages.values():
                eventually(partial(is_ready, page, process))
            running.unit.kill(process)
            for name, page in pages.items():
                stands(page, name, process)
            running.unit.revive(process)


def show(page: Page, name: str) -> None:
    page.evaluate("name => { location.hash = `#/${name}`; }", name)
    expect(page.locator(f"nav a[href='#/{name}']")).to_have_attribute("aria-current", "page")


def stands(page: Page, name: str, process: str) -> None:
    """Wait until a page knows that a process is lost, and hold it to showing its content."""
    eventually(lambda: status_of(page, process) not in ("ready", "late"))
    expect(page.get_by_text(FAILED), f"{name} without {process}").to_have_count(0)
    expect(page.get_by_role("main").get_by_role("heading", level=2).first).to_be_visible()


def is_ready(page: Page, process: str) -> bool:
    return status_of(page, process) == "ready"


def status_of(page: Page, process: str) -> object:
    return page.evaluate(STATUS, process)
