"""Nothing covers a text or is off the screen, and what is not ready yet cannot be used or waits for it."""

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import pytest
from playwright.sync_api import Page, Route, expect

from tests.browser.test_pages import keep_picture
from tests.support.dashboard.fake_unit import SIMULATED
from tests.support.dashboard.status_server import RunningServer, eventually, status_server
from tests.support.v2x.fake_plaza import FakePlaza

PAGES = ("now", "map", "gnss", "charts", "trust", "recordings", "system", "settings", "set_up")
# Phones, and the narrowest screen of each layout.
SIZES = ((320, 640), (390, 844), (701, 900), (1001, 800), (1241, 800), (1360, 850))
# Texts of the page that something else is drawn over: each is brought to the middle of the screen and looked for there.
COVERED = """() => [...document.querySelectorAll("main *")].filter((element) => {
  const own = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
  if (!own || element.closest(".sr, svg, [hidden], .maplibregl-map, details:not([open]) > :not(summary)")) return false;
  element.scrollIntoView({ block: "center", inline: "nearest" });
  const box = element.getClientRects()[0];
  if (!box || !box.width || !box.height) return false;
  const found = document.elementFromPoint(box.left + Math.min(box.width, 40) / 2, box.top + box.height / 2);
  return !found || !(element.contains(found) || found.contains(element));
}).map((element) => `${element.tagName}.${element.className}: ${element.textContent.slice(0, 60)}`)"""
# What is off the right or left edge of the screen and is not inside a part that scrolls.
OFF_SCREEN = """() => [...document.querySelectorAll("body *")].filter((element) => {
  if (element.closest(".sr, .skip, .scroll, pre, svg, .maplibregl-map, .uplot")) return false;
  const box = element.getBoundingClientRect();
  return box.width && box.height && (box.right > innerWidth + 1 || box.left < -1);
}).map((element) => `${element.tagName}.${element.className}: ${element.textContent.slice(0, 60)}`)"""

BOXES = "(selector) => [...document.querySelectorAll(selector)].map((one) => one.getBoundingClientRect().toJSON())"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    with status_server(tmp_path_factory.mktemp("unit")) as running:
        yield running


@pytest.fixture(scope="module")
def plaza(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    with status_server(tmp_path_factory.mktemp("plaza"), plaza=FakePlaza()) as running:
        yield running


@pytest.mark.parametrize("path", [*PAGES, "toll"])
def test_no_text_is_covered_or_off_the_screen(
    server: RunningServer, plaza: RunningServer, open_page: Callable[..., Page], path: str
) -> None:
    page = open_page("about:blank")
    page.route("**/lib/maplibre*.js", lambda _: None)  # never answered: the tools are there, and no map is drawn
    page.goto(f"{(plaza if path == 'toll' else server).address}/#/{path}")
    expect(page.get_by_role("main").get_by_role("heading", level=2).first).to_be_visible()
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        nothing_is(page, COVERED)
        for details in page.locator("main details:not([open]) > summary").all():
            details.click()
        nothing_is(page, OFF_SCREEN)
        for details in page.locator("main details[open] > summary").all():
            details.click()
        keep_picture(page, f"layout-{path}-{width}")


def test_what_is_not_fitted_is_listed_beside_the_boxes(server: RunningServer, open_page: Callable[..., Page]) -> None:
    page = open_page(server.address, path="system")
    expect(page.locator("a.node").first).to_be_visible()
    for width in (320, 390, 1001, 1101, 1360, 1920):
        page.set_viewport_size({"width": width, "height": 850})
        nodes, absent = boxes_of(page, "a.node"), boxes_of(page, ".absent")
        assert len(nodes) == len(SIMULATED) and len(absent) == 5
        assert not [(text, node) for text in absent for node in nodes if overlap(text, node)], width


@pytest.mark.parametrize("path", ["now", "gnss", "trust", "system"])
def test_drawers_fit_the_screen_of_a_phone(server: RunningServer, open_page: Callable[..., Page], path: str) -> None:
    page = open_page(server.address, path=path, theme="phone")
    expect(page.locator(".banner .word")).to_have_text("SAFE")
    for opens in ("w", "?"):
        page.keyboard.press(opens)
        expect(page.get_by_role("dialog")).to_be_visible()
        nothing_is(page, OFF_SCREEN)
        page.get_by_role("dialog").get_by_role("button", name="Close").click()
    for address in ("node=parsers.gnss", "topic=gnss/fix") if path == "system" else ():
        page.goto(f"{server.address}/#/system?{address}")
        expect(page.get_by_role("dialog")).to_be_visible()
        nothing_is(page, OFF_SCREEN)


def test_a_drawer_that_follows_another_at_once_stays_open(
    server: RunningServer, open_page: Callable[..., Page]
) -> None:
    """The event of a dialog's end comes later than the key."""
    page = open_page(server.address, path="now")
    expect(page.locator(".banner .word")).to_have_text("SAFE")
    page.keyboard.press("w")
    expect(page.get_by_role("dialog")).to_be_visible()
    page.evaluate(
        """() => new Promise((done) => {
          const dialog = document.querySelector("dialog");
          dialog.addEventListener("close", () => setTimeout(done, 0));
          dialog.close();
          dispatchEvent(new KeyboardEvent("keydown", { key: "?" }));
        })"""
    )
    expect(page.get_by_role("dialog", name="Help")).to_be_visible()


def test_names_of_lanes_stand_beside_lines_and_vehicles(plaza: RunningServer, open_page: Callable[..., Page]) -> None:
    page = open_page(plaza.address, path="toll")
    expect(page.locator(".plaza text").first).to_be_visible()
    names, lines = boxes_of(page, ".plaza text"), boxes_of(page, ".plaza line")
    assert len(names) == 6 and len(lines) == 6
    assert not [(name, line) for name in names for line in lines if overlap(name, line)]
    order = page.locator(".plaza > *").evaluate_all("(parts) => parts.map((part) => part.tagName)")
    assert order[-7:] == ["rect", *["text"] * 6], "the names stand on a ground of their own, above the vehicles"


def test_an_account_that_is_not_closed_has_no_mark_of_agreement(
    plaza: RunningServer, open_page: Callable[..., Page]
) -> None:
    page = open_page(plaza.address, path="toll")
    cell = page.locator(".account-card tbody td").last
    expect(cell).to_contain_text("not closed yet: 4")
    expect(cell.locator(".state.initialising")).to_have_count(1)
    expect(cell.locator(".state.safe")).to_have_count(0)
    page.keyboard.press("w")
    check = page.get_by_role("dialog").locator(".checks li", has_text="Reconciliation")
    expect(check.locator(".state.initialising")).to_have_count(1)


def test_nothing_of_a_lost_connection_is_marked_as_good(
    tmp_path_factory: pytest.TempPathFactory, open_page: Callable[..., Page]
) -> None:
    with status_server(tmp_path_factory.mktemp("lost")) as running:
        page = open_page(running.address, path="gnss")
        cards = page.locator(".interference-card, .receiver-card")
        expect(cards.locator(".state.safe")).not_to_have_count(0)
        running.stop()
        expect(page.locator(".banner .word")).to_have_text("NO CONNECTION")
        expect(cards.locator(".state.safe")).to_have_count(0)
        expect(cards.locator(".state.stale")).not_to_have_count(0)


def nothing_is(page: Page, found: str) -> None:
    """Wait until a search finds nothing: plots take a new width in a frame after that of the page."""
    with suppress(AssertionError):
        eventually(lambda: not page.evaluate(found), within_s=20.0)
    assert page.evaluate(found) == [], page.viewport_size


def late(route: Route) -> None:
    """Answer later than somebody presses a key."""
    time.sleep(1.0)
    route.continue_()


@pytest.mark.parametrize("slow", ["**/system/system.js", "**/ws**"])
def test_the_search_has_the_focus_when_its_page_is_there(
    server: RunningServer, open_page: Callable[..., Page], slow: str
) -> None:
    page = open_page("about:blank")
    if slow.endswith(".js"):
        page.route(slow, late)
    else:
        page.route_web_socket(slow, connect_late)
    page.goto(server.address)
    expect(page.locator(".top")).to_be_visible()
    page.keyboard.press("/")
    expect(page.locator("#find")).to_be_focused()
    page.keyboard.type("imu")
    expect(page.locator("#find")).to_have_value("imu")
    page.locator("h1").focus()
    page.keyboard.press("/")
    expect(page.locator("#find")).to_be_focused()
    expect(page.locator("#find")).to_have_value("imu")


def connect_late(route: Any) -> None:
    time.sleep(1.0)
    route.connect_to_server()


def test_tools_of_the_map_wait_for_the_map(server: RunningServer, open_page: Callable[..., Page]) -> None:
    page = open_page("about:blank")
    held: list[Route] = []
    page.route("**/lib/maplibre*.js", lambda route: held.append(route))  # noqa: PLW0108  # playwright wants a function
    page.goto(f"{server.address}/#/map")
    tools = [page.get_by_role("button", name=name) for name in ("Measure", "Zoom in", "Zoom out", "Whole track")]
    for tool in tools:
        expect(tool).to_be_disabled()
    while held:
        held.pop().continue_()
    page.unroute("**/lib/maplibre*.js")
    for tool in tools:
        expect(tool).to_be_enabled()
    tools[0].click()
    page.get_by_role("button", name="Mark centre").click()
    expect(page.locator(".map-message")).to_have_text("Choose the second point.")


def boxes_of(page: Page, selector: str) -> list[dict[str, float]]:
    found: list[dict[str, float]] = page.evaluate(BOXES, selector)
    return found


def overlap(one: dict[str, float], other: dict[str, float]) -> bool:
    """Whether two boxes share an area; a line has at least a pixel."""
    across = min(one["x"] + one["width"], other["x"] + max(other["width"], 1)) - max(one["x"], other["x"])
    down = min(one["y"] + one["height"], other["y"] + max(other["height"], 1)) - max(one["y"], other["y"])
    return across > 0 and down > 0
