"""Each page, in light, dark and on a phone, while the unit works, is silent, alarms, or has said nothing yet."""

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Page, expect

from shared.messages.operation import Mode, ModeState
from tests.browser.conftest import THEMES
from tests.support.cases import crossed
from tests.support.dashboard.chromium import AXE
from tests.support.dashboard.status_server import RunningServer, eventually

PLAIN_FRAMES = "delete window.DecompressionStream"  # so that a test can change them
WORDS: dict[str, str | re.Pattern[str]] = {
    "normal": "SAFE",
    "stale": "NO POSITION",
    "alarm": "UNSAFE",
    "empty": re.compile("STARTING|NO DATA"),
}  # the latter after two minutes
SENTENCES: dict[str, str | re.Pattern[str]] = {
    "normal": "The position can be used.",
    "stale": "No position: core.fusion does not answer.",
    "alarm": "The position must not be used: GNSS",
    "empty": re.compile(
        "Nothing is known yet: waiting for the first verdict of core.trust"
        "|Trust is not evaluated: (no verdict of core.trust|core.trust is missing)"
    ),
}
COLOUR_RULES = ("color-contrast", "link-in-text-block")
FIRST_PAINT_BYTES, FIRST_PAINT_REQUESTS = 80_000, 15


def faults(page: Page, *rules: str) -> list[str]:
    """Let axe-core judge the page, by all its rules or some; what it calls minor does not count."""
    if not page.evaluate("'axe' in window"):
        page.evaluate(AXE.read_text())
    options = {"resultTypes": ["violations"], **({"runOnly": list(rules)} if rules else {})}
    found: dict[str, Any] = page.evaluate("options => axe.run(document, options)", options)
    return [
        f"{v['id']} ({v['impact']}): {v['nodes'][0]['html'][:160]} {v['nodes'][0].get('failureSummary', '')[:200]}"
        for v in found["violations"]
        if v["impact"] != "minor"
    ]


def judge_everywhere(page: Page, name: str, *, phone: bool = True) -> None:
    """Hold the page to axe-core and to its width, wide and as on a phone, in light and in dark.

    In dark only colours are judged: all else is as in light. By axe-core a phone is judged in one state of a page:
    a state changes neither the colours of a theme nor the order of a layout.
    """
    for theme, viewport in THEMES.items():
        if theme == "phone-dark" and not phone:
            continue
        dark = theme.endswith("dark")
        page.emulate_media(color_scheme="dark" if dark else "light")
        page.set_viewport_size(viewport)
        keep_picture(page, f"{name}-{theme}")
        if phone or theme != "phone":
            assert faults(page, *(COLOUR_RULES if dark else ())) == [], theme
        # Charts take their new width in the frame after that of the page: what stays too wide ends this in an error.
        # Asked from here: the page's own policy lets no text be evaluated that Playwright would repeat there.
        eventually(lambda: page.evaluate("document.documentElement.scrollWidth <= innerWidth"))


def keep_picture(page: Page, name: str) -> None:
    """Keep a screenshot where OBU_SCREENSHOTS names a folder, for people to look at."""
    if folder := os.environ.get("OBU_SCREENSHOTS"):
        page.screenshot(path=Path(folder) / f"{name}.png")


@pytest.mark.parametrize(
    ("state", "path"),
    [
        *crossed(["normal"], ["now", "trust", "system"]),
        *crossed(["stale", "alarm", "empty"], ["now", "trust", "system"]),
    ],
)
def test_a_page_is_right_accessible_and_asks_nobody_else(
    units: dict[str, RunningServer], open_page: Callable[..., Page], state: str, path: str
) -> None:
    requests: list[str] = []
    page = open_page("about:blank")
    page.on("request", lambda request: requests.append(request.url))
    page.goto(f"{units[state].address}/#/{path}")
    banner = page.get_by_role("region", name="Can the position be trusted?")
    expect(banner.locator(".word")).to_have_text(WORDS[state])
    expect(banner.locator(".sentence")).to_contain_text(SENTENCES[state])
    expect(page.get_by_role("heading", level=2).first).to_be_visible()
    judge_everywhere(page, f"{state}-{path}", phone=state == "normal")
    hosts = {urlsplit(url).netloc for url in requests if not url.startswith("data:")}
    assert hosts == {urlsplit(units[state].address).netloc}


def test_the_first_paint_keeps_to_its_budget(units: dict[str, RunningServer], open_page: Callable[..., Page]) -> None:
    page = open_page("about:blank")
    sizes: list[int] = []
    page.on("requestfinished", lambda request: sizes.append(request.sizes()["responseBodySize"]))
    page.goto(units["normal"].address)
    expect(page.locator(".plot canvas")).to_be_visible()
    expect(page.locator("svg.closeup")).to_be_visible()
    assert len(sizes) <= FIRST_PAINT_REQUESTS
    assert sum(sizes) <= FIRST_PAINT_BYTES


def test_numbers_on_the_page_are_those_of_the_unit(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["normal"].address)
    position = page.get_by_role("region", name="Position", exact=True)
    expect(position).to_contain_text("32.4 km/h")
    expect(position).to_contain_text("3-D, RTK float")
    expect(position).to_contain_text("17 of 24 used")
    expect(position).to_contain_text("± 2.1 m 95 % radius")
    speed = position.locator(".row", has_text="Speed").locator("dd")
    assert "kilometres per hour" in speed.inner_text(), "a screen reader says the unit in full"
    picture = page.get_by_role("img", name="Close-up view from above")
    expect(picture).to_have_attribute("aria-label", re.compile("95 % error ellipse: 2.1 m × 1.1 m"))
    expect(page.locator(".origin")).to_have_text("SIMULATEDcity-loop")


def test_the_unsafe_state_is_shouted_once(units: dict[str, RunningServer], open_page: Callable[..., Page]) -> None:
    page = open_page("about:blank")
    page.add_init_script(PLAIN_FRAMES)

    def alarm(route: Any) -> None:
        server = route.connect_to_server()

        def pass_on(text: str) -> None:
            frame = json.loads(text)
            if "banner" in frame["state"] or frame["kind"] == "snapshot":
                frame["state"].setdefault("banner", {}).update(
                    state="unsafe",
                    row=4,
                    word="UNSAFE",
                    sentence="Position must not be used: GNSS and odometer disagree.",
                )
            route.send(json.dumps(frame))

        server.on_message(pass_on)

    page.route_web_socket("**/ws", alarm)
    page.goto(units["normal"].address)
    expect(page.get_by_role("alert")).to_have_text("UNSAFE. Position must not be used: GNSS and odometer disagree.")
    keep_picture(page, "unsafe")
    assert faults(page) == []


def test_a_topic_between_neighbours_of_a_layer_is_a_line_below_them(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page("about:blank")
    page.add_init_script(PLAIN_FRAMES)

    def connect(route: Any) -> None:
        def pass_on(text: str) -> None:
            frame = json.loads(text)
            if frame["kind"] == "snapshot":
                frame["contract"]["topics"]["imu/sample"]["consumers"].append("parsers.gnss")
            route.send(json.dumps(frame))

        route.connect_to_server().on_message(pass_on)

    page.route_web_socket("**/ws", connect)
    page.goto(f"{units['normal'].address}/#/system")
    consumer = page.locator("[id='node-parsers.gnss']")
    consumer.hover()
    line = page.locator(".edges g.edge", has_text="imu/sample").locator("path")
    expect(line).to_have_count(1)
    keep_picture(page, "neighbours")
    nodes = [consumer, *(page.locator(f"[id='node-{name}']") for name in ("parsers.imu", "sensors.simulator"))]
    box, left, right, below = (locator.bounding_box() for locator in (line, *nodes))
    assert box and left and right and below
    assert left["y"] + left["height"] == pytest.approx(box["y"], abs=12), "it leaves at the lower edge"
    assert box["y"] + box["height"] < below["y"] + 6, "it stays above the layer below"
    assert left["x"] < box["x"] < left["x"] + left["width"]
    assert right["x"] < box["x"] + box["width"] < right["x"] + right["width"]


def test_a_narrow_window_and_large_text_do_not_scroll_sideways(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    for path in ("now", "trust", "system"):
        page = open_page(units["alarm"].address, path=path, viewport={"width": 320, "height": 640})
        expect(page.get_by_role("heading", level=2).first).to_be_visible()
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), path
    page = open_page(units["alarm"].address)
    expect(page.get_by_role("heading", level=2).first).to_be_visible()
    page.evaluate("document.documentElement.style.fontSize = '30px'")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), "text at 200 %"


def test_whoever_wants_no_motion_sees_none(units: dict[str, RunningServer], open_page: Callable[..., Page]) -> None:
    page = open_page(units["normal"].address, reduced_motion="reduce")
    ground = page.locator(".ground")
    expect(ground).to_be_attached()
    assert ground.evaluate("element => getComputedStyle(element).transitionDuration") == "0s"


def test_text_of_a_message_cannot_become_part_of_the_page(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    bus = units["empty"].bus
    text = "<img src=x onerror=alert(1)>"
    state = ModeState(sampled_ns=bus.now_ns(), mode=Mode.DEGRADED, since_ns=bus.now_ns(), reason=text)
    bus.feed(state, "controller.mode")
    page = open_page(units["empty"].address, path="system")
    expect(page.get_by_role("region", name="Unit")).to_contain_text(text)
    assert page.locator("img[src=x]").count() == 0
