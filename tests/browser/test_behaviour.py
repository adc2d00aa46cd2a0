"""What the dashboard does: keys, drawers, lost connections, ages that run out."""

import re
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest
from playwright.sync_api import Browser, Page, expect

from services.core.trust.facts import Monitor
from shared.messages.operation import Crossing, CrossingEnd, ModeCommand, OperatorCommand, Origin, OriginKind
from shared.messages.tachograph import RecordPurpose, TachographEvent, TachographKind, TachographRecords
from shared.messages.uplink import UplinkState
from tests.browser.conftest import THEMES
from tests.browser.test_pages import faults, judge_everywhere, keep_picture
from tests.support.dashboard.fake_unit import SIMULATED
from tests.support.dashboard.status_server import RunningServer, status_server
from tests.support.patience import HANGS_S

DEADLINE_S = 2.0  # of navigation/solution


def test_a_lost_connection_is_said_and_its_return_as_well(tmp_path: Path, open_page: Callable[..., Page]) -> None:
    with status_server(tmp_path) as server:
        page = open_page(server.address)
        expect(page.locator("svg.closeup")).to_be_visible()
        server.stop()
        bar = page.locator(".bar.lost")
        expect(bar).to_be_visible()
        expect(bar).to_contain_text(
            re.compile(r"Connection to the OBU lost \d s ago - showing last data. Retrying ...")
        )
        expect(bar).to_contain_text("The unit cannot be reached")
        expect(page.locator(".banner .word")).to_have_text("NO CONNECTION")
        expect(page.locator(".foot")).to_contain_text("NO CONNECTION")
        expect(page.locator(".clock")).to_contain_text("stopped")
        expect(page.locator(".vehicle.old")).to_be_attached()
        stopped = page.locator(".clock time").inner_text()
        page.wait_for_timeout(1200)
        assert page.locator(".clock time").inner_text() == stopped
        expect(page.locator(".chain .worst")).to_have_text("API: no answer from the unit")
        expect(page.locator(".state.safe")).to_have_count(0)
        page.keyboard.type("gs")
        expect(page.get_by_text("This page has not been loaded yet.")).to_be_visible()
    with status_server(tmp_path, port=urlsplit(server.address).port):
        expect(page.get_by_text(re.compile(r"Reconnected, \d+ s gap"))).to_be_visible()
        expect(bar).to_be_hidden()
        expect(page.locator(".banner .word")).to_have_text("SAFE")
        expect(page.get_by_role("heading", name="Processes by layer")).to_be_visible()


def test_a_position_is_not_shown_as_live_after_its_deadline(tmp_path: Path, open_page: Callable[..., Page]) -> None:
    with status_server(tmp_path) as server:
        assert server.unit is not None
        page = open_page(server.address)
        expect(page.locator("svg.closeup .vehicle:not(.old)")).to_be_attached()
        server.unit.silent.add("core.fusion")
        page.locator("svg.closeup .vehicle.old").wait_for(state="attached")
        position = page.get_by_role("region", name="Position", exact=True)
        expect(position.locator(".age.stale").first).to_have_text(re.compile(r"last message \d\d:\d\d:\d\d, \d s ago"))
        expect(position).to_contain_text("away now")
        first = page.locator("svg.closeup").get_attribute("aria-label")
        page.wait_for_timeout(1500)
        label = page.locator("svg.closeup").get_attribute("aria-label") or ""
        within = re.search(r"could be up to ([\d.]+) m away now", label)
        assert within and float(within[1]) > 2.1 + 9.0 * DEADLINE_S + 1.5 * DEADLINE_S**2, "it may have sped up"
        assert label != first, "and it grows"
        server.unit.silent.clear()
        expect(page.locator("svg.closeup .vehicle:not(.old)")).to_be_attached()


@pytest.mark.parametrize(
    ("kind", "shown"),
    [
        (OriginKind.LIVE, "LIVEtruck"),
        (OriginKind.REPLAY, "REPLAYtruck ×4"),
    ],
)
def test_the_badge_says_where_the_data_are_from(
    units: dict[str, RunningServer], open_page: Callable[..., Page], kind: OriginKind, shown: str
) -> None:
    bus = units["empty"].bus
    page = open_page(units["empty"].address)
    expect(page.locator(".origin")).to_be_visible()
    speed = 4.0 if kind is OriginKind.REPLAY else 1.0
    bus.feed(Origin(now_ns=bus.now_ns(), kind=kind, name="truck", speed=speed), f"sensors.{kind}")
    expect(page.locator(".origin")).to_have_text(shown)


def test_whoever_is_watched_from_a_control_centre_sees_it_on_every_page_while_it_lasts(
    tmp_path: Path, open_page: Callable[..., Page]
) -> None:
    with status_server(tmp_path) as server:
        page = open_page(server.address, theme="phone")
        expect(page.locator(".banner .word")).to_have_text("SAFE")
        expect(page.locator(".watched")).to_have_count(0)
        bus = server.bus
        said = UplinkState(
            now_ns=bus.now_ns(), connected=True, centre="centre.example:8883", tracking="live", watchers=2,
            watched_until_ns=bus.now_ns() + 10**10, backlog_batches=3, backlog_bytes=4096, backlog_refused=1,
            oldest_ns=1_796_000_000 * 10**9, sent=9, receipted=6, sent_bytes=12_000,
        )  # fmt: skip
        bus.feed(said, "monitoring.uplink")
        expect(page.locator(".watched")).to_have_text("WATCHED by 2 people of the control centre")
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")

        page.goto(f"{server.address}/#/system")
        card = page.get_by_role("region", name="Control centre")
        expect(card).to_contain_text("connected to centre.example:8883")
        expect(card).to_contain_text("3 batches, 4.1 kB")
        expect(card).to_contain_text("the oldest of 2026-11-30 00:53 UTC, 1 refused")
        assert faults(page) == []

        ended = said.model_copy(update={"watchers": 0, "connected": False, "offline": "no network"})
        bus.feed(ended, "monitoring.uplink")
        expect(page.locator(".watched")).to_have_count(0)
        expect(card).to_contain_text("not connected no network")


def test_the_reasons_of_the_banner_are_listed_with_what_is_not_evaluated(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["alarm"].address)
    page.get_by_role("button", name="Why?").click()
    drawer = page.get_by_role("dialog", name="Why UNSAFE?")
    expect(drawer).to_contain_text("What to do")
    statement = drawer.locator(".reasons li", has_text="Short inertial window suspects GNSS")
    expect(statement).to_contain_text(re.compile(r"statistic [\d.]+, threshold"))
    expect(page.locator(".banner .sentence")).not_to_contain_text("statistic")
    expect(drawer.locator(".checks li", has_text="Short inertial window")).to_contain_text("suspects GNSS")
    expect(drawer.locator("li", has_text="GNSS velocity residual")).to_contain_text("470 % of limit, discarded")
    warming = drawer.locator(".checks li", has_text="Motion conflict")
    expect(warming).to_contain_text("not evaluated: warming up: 12 of 30 samples")
    expect(warming.locator(".meter")).to_have_count(0)
    drawer.get_by_role("link", name="GNSS fix").click()
    expect(page.get_by_role("dialog", name="Topic gnss/fix")).to_be_visible()


def test_the_keyboard_goes_everywhere_and_can_be_silenced(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["normal"].address)
    expect(page.locator("svg.closeup")).to_be_visible()
    page.keyboard.press("Tab")
    expect(page.get_by_role("link", name="Skip to the content")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", level=1)).to_be_focused()
    page.keyboard.type("gs")
    expect(page.get_by_role("heading", name="Processes by layer")).to_be_visible()
    page.keyboard.press("/")
    expect(page.get_by_role("searchbox", name="Find a topic")).to_be_focused()
    page.keyboard.type("wheel")
    topics = page.get_by_role("region", name="Topics").first
    expect(topics.get_by_role("link")).to_have_text(["vehicle/wheel_speed"])
    page.locator("body").click(position={"x": 5, "y": 400})
    page.keyboard.type("gt")
    expect(page.get_by_role("region", name="Monitors")).to_be_visible()
    page.keyboard.type("gn")
    expect(page.locator("svg.closeup")).to_be_visible()
    page.keyboard.press("?")
    expect(page.get_by_role("dialog", name="Help and shortcuts")).to_be_visible()
    page.get_by_role("checkbox", name="Keyboard shortcuts").uncheck()
    page.keyboard.press("Escape")
    page.keyboard.type("gs")
    page.wait_for_timeout(300)
    expect(page.locator("svg.closeup")).to_be_visible()


def test_the_topic_inspector_shows_pauses_plots_and_copies(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    # By a plain name over HTTP there is no secure context, and so no navigator.clipboard.
    address = units["normal"].address.replace("127.0.0.1", "obu.local")
    page = open_page(address, path="system")
    assert page.evaluate("isSecureContext") is False
    page.get_by_role("link", name="Inspect navigation/solution").click()
    drawer = page.get_by_role("dialog", name="Topic navigation/solution")
    message = drawer.locator("pre")
    expect(message).to_contain_text('"position_cov_ned_m2": [0.6, 0.25, 0.0, 0.35, 0.0, 1.2]')
    expect(drawer).to_contain_text("NavigationSolution")
    first = message.inner_text()
    stamp = re.search(r'"sampled_ns": (\d+)', first)
    assert stamp and not stamp[1].endswith("000"), "nanoseconds are shown as they came, not rounded by the browser"
    expect(message).not_to_have_text(first)
    row = drawer.get_by_role("row", name="longitude_deg")
    expect(row).to_contain_text("°")
    expect(row.get_by_role("button", name="Plot longitude_deg")).to_have_text("Plot")
    drawer.get_by_role("button", name="Pause").click()
    page.wait_for_timeout(700)
    paused = message.inner_text()
    page.wait_for_timeout(1200)
    assert message.inner_text() == paused
    drawer.get_by_role("button", name="Resume").click()
    drawer.get_by_role("button", name="Copy").click()
    expect(drawer.get_by_role("button", name="Copied")).to_be_visible()
    page.keyboard.press("Escape")
    expect(drawer).to_be_hidden()


def test_bytes_of_a_device_are_shown_as_hexadecimal(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["normal"].address, path="system?topic=gnss/raw")
    expect(page.get_by_role("dialog")).to_contain_text('"hexadecimal": "b5 62 01 07')


def test_a_topic_that_never_spoke_says_who_would(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["empty"].address, path="system?topic=gnss/fix")
    expect(page.get_by_role("dialog")).to_contain_text("No message received yet.")
    expect(page.get_by_role("dialog")).to_contain_text("It is published by parsers.gnss")


def test_a_process_shows_its_life_and_its_topics(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["alarm"].address, path="system")
    node = page.get_by_role("link", name="lost: monitoring.recorder")
    expect(node).to_be_visible()
    node.click()
    drawer = page.get_by_role("dialog", name="Process monitoring.recorder")
    expect(drawer).to_contain_text("Its connection ended without a disconnect: it crashed or was killed.")
    expect(drawer.get_by_role("link", name="recording/state")).to_be_visible()
    page.keyboard.press("Escape")
    outages = page.get_by_role("region", name="Outages")
    expect(outages.locator("li", has_text="monitoring.recorder")).to_contain_text("open")
    expect(outages.locator("li", has_text="imu/raw")).to_contain_text("its device sends nothing")


def test_problems_in_the_footer_lead_to_their_place(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["stale"].address)
    # A busy machine may have a problem of its own beside it.
    page.get_by_role("link", name=re.compile(r"problems?: core\.fusion is stale")).click(timeout=HANGS_S * 1000)
    expect(page.get_by_role("dialog", name="Process core.fusion")).to_contain_text("no heartbeat within the deadline")


def test_pictures_have_a_table_that_says_the_same(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["normal"].address)
    for name, heading in (("Close-up", "95 % error ellipse"), ("Speed", "Odometer, km/h")):
        card = page.get_by_role("region", name=name, exact=True).first
        card.get_by_role("button", name="Table").click()
        expect(card.get_by_role("table")).to_contain_text(heading)
    for name, line in (("fused", "solid"), ("gnss", "dashed"), ("odometer", "dotted")):
        key = page.locator(f".legend .key.{name}")
        expect(key).to_have_css("border-top-style", line)
        expect(key).to_have_css("background-color", "rgba(0, 0, 0, 0)")  # a line as in the plot, and no square


def test_the_close_up_zooms_turns_and_fits_again(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["normal"].address)
    scale = page.locator(".scale text")
    fitted = scale.text_content() or ""
    fit = page.get_by_role("button", name="Fit")
    expect(fit).to_have_attribute("aria-pressed", "true")
    for _ in range(3):
        page.get_by_role("button", name="Zoom out").click()
    expect(fit).to_have_attribute("aria-pressed", "false")
    expect(scale).not_to_have_text(fitted)
    fit.click()
    expect(scale).to_have_text(fitted)
    page.get_by_role("button", name="Heading up").click()
    expect(page.locator(".ground")).to_have_attribute("style", re.compile(r"rotate\(-?[1-9]"))


def test_a_paused_page_stands_as_it_was_without_ageing_and_catches_up_on_resuming(
    tmp_path: Path, open_page: Callable[..., Page]
) -> None:
    with status_server(tmp_path) as server:
        page = open_page(server.address)
        latitude = page.locator(".coordinates dd").first
        expect(latitude).to_be_visible()
        expect(page.locator(".banner .word")).to_have_text("SAFE")
        page.keyboard.press("p")
        expect(page.locator(".clock .paused-badge")).to_have_text("PAUSED")
        expect(page.get_by_text(re.compile(r"Paused at \d\d:\d\d:\d\d UTC"))).to_be_visible()
        page.wait_for_timeout(300)
        whole = page.locator("body").inner_text()
        assert server.unit is not None
        server.unit.kill("core.fusion")
        page.wait_for_timeout(3500)
        assert page.locator("body").inner_text() == whole, "not one word, age or figure has changed"
        keep_picture(page, "paused")
        assert faults(page) == []
        page.get_by_role("button", name="Resume").click()
        expect(page.locator(".banner .word")).to_have_text("NO POSITION")
        expect(page.locator(".paused-badge")).to_have_count(0)
        expect(page.locator(".vehicle.old")).to_be_attached()


def test_a_protection_level_above_its_limit_is_said_by_banner_footer_timeline_and_api(
    tmp_path: Path, open_page: Callable[..., Page]
) -> None:
    with status_server(tmp_path) as server:
        assert server.unit is not None
        page = open_page(server.address)
        expect(page.locator(".banner .word")).to_have_text("SAFE")
        expect(page.locator(".foot")).to_contain_text("No problems")
        server.unit.protection_level_m = 25.0
        expect(page.locator(".banner .word")).to_have_text("ABOVE LIMIT")
        expect(page.locator(".banner .sentence")).to_contain_text(
            "The position must not be used: its error may be above the alert limit."
        )
        expect(page.get_by_role("alert")).to_contain_text("ABOVE LIMIT")
        expect(page.locator(".foot")).to_contain_text("ABOVE LIMIT")
        expect(page.locator(".band .segment.above_limit").first).to_be_attached()
        shown = httpx.get(f"{server.address}/api/health", timeout=HANGS_S).json()
        assert (shown["state"], shown["position"]["state"]) == ("degraded", "above_limit")
        judge_everywhere(page, "above-limit")


def test_after_a_restart_of_the_status_process_its_history_is_there_and_nothing_green_is_shown_before_new_values(
    tmp_path: Path, open_page: Callable[..., Page]
) -> None:
    with status_server(tmp_path) as server:
        assert server.unit is not None
        page = open_page(server.address, path="system")
        expect(page.locator(".banner .word")).to_have_text("SAFE")
        server.unit.kill("parsers.can")
        outages = page.get_by_role("region", name="Outages").locator("li")
        expect(outages).to_have_count(1)
        server.unit.revive("parsers.can")
        expect(outages.locator("em")).to_have_count(0)
    with status_server(tmp_path, unit=False, offset_ns=server.bus.offset_ns) as again:
        page = open_page(again.address, path="system")
        expect(page.get_by_role("region", name="Outages").locator("li")).to_contain_text("parsers.can was lost")
        expect(page.locator(".banner .word")).to_have_text("STARTING")
        expect(page.locator(".banner .sentence")).to_contain_text("waiting for the first verdict of core.trust")
        expect(page.locator("main .state.safe")).to_have_count(1)  # the legend's
        page.keyboard.type("gn")
        expect(page.locator(".band .segment.safe").first).to_be_attached()
        expect(page.locator(".band .segment.starting").first).to_be_attached()
        expect(page.locator("main .checks .state.safe")).to_have_count(0)


def test_colours_are_remembered(units: dict[str, RunningServer], open_page: Callable[..., Page]) -> None:
    page = open_page(units["normal"].address)
    page.get_by_role("button", name="Colours: Automatic colours").click()
    page.get_by_role("button", name="Colours: Light colours").click()
    expect(page.locator("html")).to_have_attribute("data-theme", "dark")
    page.reload()
    expect(page.locator("html")).to_have_attribute("data-theme", "dark")


def test_targets_are_large_enough_for_a_thumb(units: dict[str, RunningServer], open_page: Callable[..., Page]) -> None:
    page = open_page(units["normal"].address, theme="phone")
    expect(page.locator("svg.closeup")).to_be_visible()
    small = page.evaluate(
        """[...document.querySelectorAll('button, nav a')].filter((e) => e.offsetParent)
           .filter((e) => e.getBoundingClientRect().height < 47.5).map((e) => e.outerHTML.slice(0, 80))"""
    )
    assert small == []


def test_without_a_broker_the_page_says_so_itself(tmp_path: Path, open_page: Callable[..., Page]) -> None:
    with status_server(tmp_path) as server:
        server.bus.connected = False
        page = open_page(server.address)
        expect(page.locator(".banner .sentence")).to_contain_text("Nothing is known: the broker is not reachable")
        expect(page.locator(".banner .word")).to_have_text("BROKER LOST")
        expect(page.locator(".foot")).to_contain_text("BROKER LOST")
        expect(page.locator(".band .segment.broker_lost").first).to_be_attached()
        expect(page.locator(".chain .worst")).to_have_text("Broker does not answer")
        services = page.get_by_role("region", name="Services")
        expect(services).to_contain_text("not known")
        expect(services.get_by_text(re.compile("stale|running"))).to_have_count(0)
        page.keyboard.type("gs")
        expect(page.locator("[id='node-core.fusion']")).to_contain_text("not known")
        expect(page.locator(".foot .problems:not(.verdict-state)")).to_contain_text(
            "1 problem: the broker is not reachable"
        )
        expect(page.get_by_role("region", name="Outages").locator("li")).to_have_count(1)


def test_without_monitoring_health_the_position_stays_and_the_rest_is_not_known(
    tmp_path: Path, open_page: Callable[..., Page]
) -> None:
    with status_server(tmp_path) as server:
        assert server.unit is not None
        page = open_page(server.address)
        expect(page.locator("svg.closeup .vehicle:not(.old)")).to_be_attached()
        server.unit.kill("monitoring.health")
        problem = page.locator(".foot .problems:not(.verdict-state)")
        expect(problem).to_contain_text("1 problem: monitoring.health does not report")
        expect(page.locator(".banner .word")).to_have_text("SAFE")
        expect(page.locator(".chain li", has_text="Services")).to_have_class("unknown")
        server.unit.revive("monitoring.health")
        expect(page.locator(".foot")).to_contain_text("No problems")


def test_a_process_that_was_killed_is_the_cause_until_its_topics_are_back(
    tmp_path: Path, open_page: Callable[..., Page]
) -> None:
    with status_server(tmp_path) as server:
        assert server.unit is not None
        page = open_page(server.address)
        expect(page.locator("svg.closeup .vehicle:not(.old)")).to_be_attached()
        server.unit.kill("core.fusion")
        banner = page.locator(".banner .sentence")
        expect(banner).to_contain_text("No position: ")
        expect(banner).to_contain_text("core.fusion was lost")
        server.unit.aligning = True
        server.unit.revive("core.fusion")
        expect(banner).to_contain_text("core.fusion is starting again")
        page.keyboard.type("gs")
        expect(page.locator("[id='node-core.fusion']")).to_contain_text("restarting")
        outages = page.get_by_role("region", name="Outages").locator("li")
        expect(outages).to_have_count(1)
        expect(outages).to_contain_text("core.fusion was lost")
        expect(outages).to_contain_text("affected: navigation/solution, navigation/state")
        server.unit.aligning = False
        expect(page.locator(".foot")).to_contain_text("No problems")
        expect(outages).to_have_count(1)


def test_beyond_the_limit_a_page_says_how_many_watch_and_nothing_else(
    tmp_path: Path, open_page: Callable[..., Page]
) -> None:
    with status_server(tmp_path, clients_maximum=1) as server:
        first = open_page(server.address)
        expect(first.locator("svg.closeup")).to_be_visible()
        second = open_page(server.address, theme="phone")
        page = second.locator("main")
        expect(page).to_contain_text("Too many viewers: 1 is connected.")
        expect(page).to_contain_text("tries again every 10 s")
        expect(second.locator(".banner .sentence")).to_have_text("Too many viewers: 1 is connected.")
        second.wait_for_timeout(3500)
        expect(second.locator(".bar.lost")).to_have_count(0)
        assert "does not answer" not in second.locator("body").inner_text()
        assert "Connecting" not in second.locator("body").inner_text()
        keep_picture(second, "too-many-viewers")
        assert faults(second) == []
        first.close()
        second.get_by_role("button", name="Try again now").click()
        expect(second.locator("svg.closeup")).to_be_visible()


def test_protection_levels_are_described_in_plain_words(tmp_path: Path, open_page: Callable[..., Page]) -> None:
    with status_server(tmp_path) as server:
        page = open_page(server.address)
        ring = page.locator("svg.closeup circle.level")
        expect(ring).to_be_attached()
        ellipse = page.locator("svg.closeup ellipse.ellipse")
        assert float(ring.get_attribute("r") or 0) > float(ellipse.get_attribute("ry") or 0) > 0
        assert "Protection level: 3.1 m horizontal" in (page.locator("svg.closeup").get_attribute("aria-label") or "")
        position = page.get_by_role("region", name="Position", exact=True)
        expect(position).to_contain_text("3.1 m horizontal, 4.3 m vertical")
        expect(position).to_contain_text("The probability of a larger error is at most 1 in 1,000.")
        page.set_viewport_size(THEMES["phone"])
        expect(page.locator(".glance")).to_contain_text("Protection level")
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


def test_an_old_protection_level_is_not_shown_as_one_of_now(tmp_path: Path, open_page: Callable[..., Page]) -> None:
    with status_server(tmp_path) as server:
        assert server.unit is not None
        page = open_page(server.address)
        expect(page.locator("svg.closeup circle.level:not(.old)")).to_be_attached()
        server.unit.silent.add("core.fusion")
        page.locator("svg.closeup circle.level.old").wait_for(state="attached")
        expect(page.get_by_role("region", name="Position", exact=True)).to_contain_text("not valid now")
        expect(page.locator(".glance")).not_to_contain_text("Protection level")


def test_figures_lines_and_states_of_the_system_page_are_explained(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["normal"].address, path="system")
    layers = page.get_by_role("region", name="Processes by layer")
    expect(layers.locator(".key-card")).to_contain_text("n/s in a box: messages published a second")
    expect(layers.locator(".key-card .lines li")).to_have_text(
        ["fresh; thicker is faster", "late", "stale", "event-driven"]
    )
    topics = page.get_by_role("region", name="Topics").first
    expect(topics.locator(".legend")).to_contain_text("event-driven: published when something happens")
    event = topics.locator("tr", has_text="outage/event")
    expect(event).to_contain_text("no event yet")
    expect(event.locator(".state.info")).to_be_visible()
    page.set_viewport_size({"width": 390, "height": 844})
    expect(layers.locator(".lines")).to_be_hidden()  # as the lines are
    expect(layers.locator(".key-figures")).to_be_visible()
    expect(topics.locator(".legend")).to_have_count(0)  # a phone shows the title, until it is pressed
    topics.get_by_role("button", name="Topics", expanded=False).click()
    expect(topics.locator(".legend")).to_be_visible()
    expect(event.get_by_text("events", exact=True)).to_be_visible()


def test_a_silent_topic_and_one_of_events_look_different(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["alarm"].address, path="system")
    topics = page.get_by_role("region", name="Topics").first
    silent = topics.locator("tr", has_text="imu/raw")
    expect(silent).to_contain_text("0 /s")  # the rate is that of the last ten seconds
    expect(silent.locator(".state.stale")).to_be_visible()


def test_a_unit_that_has_just_started_is_not_called_well(tmp_path: Path, open_page: Callable[..., Page]) -> None:
    with status_server(tmp_path, unit=False) as server:
        page = open_page(server.address)
        services = page.locator(".chain li", has_text="Services")
        expect(services).to_contain_text(f"0/{len(SIMULATED)}")
        expect(services).to_have_class("unknown")
        expect(page.locator(".banner .word")).to_have_text("STARTING")
        expect(page.locator(".foot")).to_contain_text(f"{len(SIMULATED)} processes have not started yet")
        expect(page.locator(".foot")).not_to_contain_text("CPU")
        assert faults(page) == []


def test_the_page_trust_shows_statistics_against_thresholds_and_unfolds_the_tests(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["alarm"].address, path="trust")
    verdict = page.get_by_role("region", name="Verdict", exact=True)
    expect(verdict.locator(".chip")).to_contain_text("UNSAFE")
    expect(verdict.locator(".reasons li", has_text="Short inertial window suspects GNSS")).to_have_count(1)
    monitors = page.get_by_role("region", name="Monitors", exact=True)
    accusing = monitors.get_by_role("row").filter(has_text="GNSS motion against inertial")
    expect(accusing).to_contain_text(re.compile(r"suspects GNSS.*2[34](\.\d)? of 11.3", re.DOTALL))
    expect(accusing).to_contain_text("1 × 10⁻⁵")
    expect(accusing.locator(".meter.over")).to_have_count(1)
    warming = monitors.get_by_role("row").filter(has_text="by the rules of the smart tachograph")
    expect(warming).to_contain_text("not evaluated")
    expect(warming.locator(".state.off")).to_have_count(1)
    expect(warming.locator(".meter, .state.safe, .state.unsafe")).to_have_count(0)
    fold = monitors.get_by_role("button", name="Motion conflict")
    expect(fold).to_have_attribute("aria-expanded", "false")
    fold.focus()
    page.keyboard.press("Enter")
    tests = monitors.get_by_role("group", name="Tests of Motion conflict")
    expect(tests.get_by_role("row", name="held speed")).to_contain_text("0 of 4 s")
    expect(tests.get_by_role("row", name="trimmed mean")).to_contain_text("threshold 10 km/h")
    events = page.get_by_role("region", name="Changes of the verdict")
    expect(events.locator("li").first).to_contain_text("UNSAFE")
    expect(events.locator("li").first).to_contain_text("Short inertial window suspected GNSS: statistic 2")
    history = page.get_by_role("region", name="History")
    expect(history.get_by_role("img", name=re.compile("Short inertial window: .*above 1 for"))).to_be_visible()
    expect(history.get_by_role("img", name="Motion conflict: not evaluated in the last 15 minutes")).to_be_visible()
    history.get_by_role("button", name="Table").click()
    expect(history.get_by_role("row", name=re.compile("^UNSAFE")).first).to_be_visible()


def test_without_core_trust_the_page_says_that_trust_is_not_evaluated(
    tmp_path: Path, open_page: Callable[..., Page]
) -> None:
    with status_server(tmp_path) as server:
        assert server.unit is not None
        page = open_page(server.address, path="trust")
        monitors = page.get_by_role("region", name="Monitors", exact=True)
        expect(page.locator(".banner .word")).to_have_text("SAFE")
        expect(monitors.locator(".state.safe").first).to_be_visible()
        server.unit.kill("core.trust")
        expect(page.locator(".banner .sentence")).to_contain_text("Trust is not evaluated: core.trust was lost.")
        expect(page.locator(".banner .word")).to_have_text("NO DATA")
        expect(page.get_by_role("region", name="Verdict", exact=True)).to_contain_text("Trust is not evaluated")
        expect(monitors.locator("tr.old")).to_have_count(len(Monitor))
        expect(monitors.locator(".state.safe, .state.unsafe, .state.off")).to_have_count(0)
        judge_everywhere(page, "without-trust")


def test_the_page_trust_without_any_verdict_is_empty_and_says_why(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["empty"].address, path="trust")
    expect(page.get_by_text("No outcome of any monitor yet")).to_be_visible()
    expect(page.get_by_text("No change of the verdict recorded.")).to_be_visible()
    expect(page.locator(".chip")).to_have_text(re.compile("STARTING|NO DATA"))  # by its age


def test_an_attack_is_started_and_stopped_from_the_page(tmp_path: Path, open_page: Callable[..., Page]) -> None:
    with status_server(tmp_path) as server:
        page = open_page(server.address, path="trust")
        card = page.get_by_role("region", name="Attacks")
        expect(card.get_by_text("No attack is active.")).to_be_visible()
        expect(card.get_by_text("Yes: SAFE, and the error is within the alert limits")).to_be_visible()
        card.get_by_label("Attack").select_option("drag_off")
        card.get_by_label("speed").fill("1")
        card.get_by_role("button", name="Start drag off").click()
        expect(card.get_by_role("status")).to_have_text("Done.")
        expect(card.get_by_role("listitem")).to_contain_text("acceleration 0.3, speed 1, direction 0")
        for theme in ("light", "dark"):
            page.emulate_media(color_scheme=theme)
            keep_picture(page, f"attacks-{theme}")
        page.set_viewport_size(THEMES["phone"])
        card.get_by_role("button", name="Attacks", expanded=False).click()
        expect(card.get_by_role("listitem")).to_contain_text("acceleration 0.3, speed 1, direction 0")
        keep_picture(page, "attacks-phone")
        assert not faults(page)
        card.get_by_role("button", name="Stop drag off").click()
        expect(card.get_by_text("No attack is active.")).to_be_visible()
        expect(card.get_by_text("Ended: drag off")).to_be_visible()
        card.get_by_label("Attack").select_option("jam")
        card.get_by_label("power").fill("61")
        card.get_by_role("button", name="Start jam").click()
        expect(card.get_by_text("Ended: drag off")).to_be_visible()
        expect(card.get_by_text("No attack is active.")).to_be_visible()


def test_a_crossing_is_entered_and_ended_on_the_page_and_records_are_listed(
    tmp_path: Path, open_page: Callable[..., Page]
) -> None:
    with status_server(tmp_path) as server:
        page = open_page(server.address, path="trust")
        card = page.get_by_role("region", name="Ferry or train")
        expect(card.get_by_text("No crossing is entered")).to_be_visible()
        expect(page.get_by_text("No event is recorded.")).to_be_visible()
        card.get_by_role("button", name="Begin a crossing").click()
        expect(card.get_by_role("status")).to_have_text("")
        now_ns = server.bus.now_ns()
        server.bus.feed(Crossing(sampled_ns=now_ns, is_open=True, since_ns=now_ns), "controller.mode")
        expect(card.get_by_text("Crossing entered, since")).to_be_visible()
        card.get_by_role("button", name="End the crossing").click()
        ended = Crossing(sampled_ns=now_ns, is_open=False, since_ns=now_ns, ended_by=CrossingEnd.WHEELS)
        server.bus.feed(ended, "controller.mode")
        expect(card.get_by_text("the wheels have turned for 100 m")).to_be_visible()
        kinds = [message.command for message in server.bus.published if isinstance(message, ModeCommand)]
        assert kinds == [OperatorCommand.CROSSING_BEGIN, OperatorCommand.CROSSING_END]
        event = TachographEvent(
            kind=TachographKind.MOTION_CONFLICT, begin_utc_ns=1_700_000_000 * 10**9, similar_that_day=2,
            end_utc_ns=1_700_000_060 * 10**9, purposes=(RecordPurpose.LONGEST_OF_DAY,),
        )  # fmt: skip
        records = TachographRecords(sampled_ns=now_ns, records=(event,))
        server.bus.feed(records, "core.motion_conflict")
        listed = page.get_by_role("region", name="Records of the tachograph")
        expect(listed.get_by_role("listitem")).to_contain_text("2023-11-14")
        expect(listed.get_by_role("listitem")).to_contain_text("for 1 min 00 s, 2 of this kind on that day")
        page.set_viewport_size(THEMES["phone"])
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert not faults(page)


def test_attacks_are_offered_only_where_the_data_are_simulated(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["empty"].address, path="trust")
    expect(page.get_by_role("region", name="Monitors")).to_be_visible()
    expect(page.get_by_role("region", name="Attacks")).to_have_count(0)


def test_the_viewer_chooses_units_which_this_browser_keeps(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["normal"].address)
    position = page.get_by_role("region", name="Position", exact=True)
    expect(position).to_contain_text("32.4 km/h")
    page.keyboard.press("?")
    page.get_by_label("Speeds in").select_option("mph")
    page.get_by_label("Lengths in").select_option("ft")
    page.keyboard.press("Escape")
    expect(position).to_contain_text("20.1 mph")
    expect(position).to_contain_text(re.compile(r"± \d\.\d ft"))
    page.reload()
    expect(position).to_contain_text("20.1 mph")


@pytest.mark.parametrize("path", ["now", "gnss", "charts", "trust", "system"])
def test_a_phone_page_is_three_screens_long_and_folds(
    units: dict[str, RunningServer], open_page: Callable[..., Page], path: str
) -> None:
    page = open_page(units["normal"].address, path=path)
    page.set_viewport_size({"width": 390, "height": 844})
    expect(page.locator("main .card-fold").first).to_be_visible()
    assert page.evaluate("document.documentElement.scrollHeight") <= 2500
    card = page.locator("main .folds").first
    if path == "now":
        expect(page.locator("[aria-labelledby=speed] header .note")).to_be_visible()
    card.locator(".card-fold").focus()
    page.keyboard.press("Enter")
    expect(card.locator(".card-fold")).to_have_attribute("aria-expanded", "true")
    page.keyboard.press("Enter")
    expect(card.locator(".card-fold")).to_have_attribute("aria-expanded", "false")
    page.set_viewport_size({"width": 1360, "height": 850})
    expect(page.locator("main .card-fold")).to_have_count(0)
    assert not faults(page)


def test_a_card_that_warns_is_not_folded_on_a_phone(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["alarm"].address, path="trust", viewport={"width": 390, "height": 844})
    expect(page.locator("[aria-labelledby=monitors] table")).to_be_visible()
    expect(page.locator("[aria-labelledby=monitors] .card-fold")).to_have_count(0)
    expect(page.locator("[aria-labelledby=events] .card-fold")).to_be_visible()


def test_times_are_those_of_the_browsers_place_where_that_is_chosen(
    units: dict[str, RunningServer], browser: Browser
) -> None:
    context = browser.new_context(timezone_id="Asia/Kolkata")
    page = context.new_page()
    page.goto(units["normal"].address)
    expect(page.locator(".clock")).to_contain_text("UTC")
    before = page.locator(".clock time").inner_text()
    page.keyboard.press("?")
    page.get_by_label("Times in").select_option("local")
    page.keyboard.press("Escape")
    expect(page.locator(".clock")).to_contain_text("UTC+5:30")
    after = page.locator(".clock time").inner_text()
    context.close()
    minutes = [60 * int(text[:2]) + int(text[3:5]) for text in (before, after)]
    assert (minutes[1] - minutes[0]) % 1440 in range(330, 334)
