"""The pages GNSS and Charts: normal, stale, empty and alarm, in light, dark and on a phone, within their budget."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from shared.messages.operation import DeviceFound
from tests.browser.test_pages import judge_everywhere
from tests.support.cases import crossed
from tests.support.dashboard.status_server import RunningServer, status_server

PAGE_BYTES = 120_000
FIRST_HEADING = {
    ("gnss", "empty"): "GNSS",
    ("charts", "empty"): "Charts",
    ("gnss", "normal"): "Sky",
    ("charts", "normal"): "Speed",
}


@pytest.mark.parametrize(
    ("state", "path"),
    [*crossed(["normal"], ["gnss", "charts"]), *crossed(["stale", "alarm", "empty"], ["gnss", "charts"])],
)
def test_the_page_is_accessible_and_fits_every_screen_in_every_state(
    units: dict[str, RunningServer], open_page: Callable[..., Page], state: str, path: str
) -> None:
    page = open_page("about:blank")
    sizes: list[int] = []
    page.on("requestfinished", lambda request: sizes.append(request.sizes()["responseBodySize"]))
    requests: list[str] = []
    page.on("request", lambda request: requests.append(request.url))
    page.goto(f"{units[state].address}/#/{path}")
    heading = FIRST_HEADING.get((path, state), FIRST_HEADING[path, "normal"])
    expect(page.get_by_role("heading", level=2, name=heading, exact=True)).to_be_visible()
    if path == "charts" and state != "empty":
        expect(page.locator(".plot canvas").first).to_be_visible()
    assert sum(sizes) <= PAGE_BYTES, sum(sizes)
    judge_everywhere(page, f"{state}-{path}", phone=state == "normal")
    assert all(url.startswith((units[state].address, "data:")) for url in requests if url != "about:blank")


def test_the_sky_shows_used_tracked_and_excluded_satellites_and_the_table_says_why(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["normal"].address, path="gnss")
    sky = page.get_by_role("img", name="Sky plot, north up: 16 satellites used, 7 not used, 1 excluded")
    expect(sky).to_be_visible()
    expect(sky.locator("g.satellite")).to_have_count(24)
    expect(sky.locator("g.satellite.excluded .cross")).to_have_count(1)
    expect(sky.locator("g.satellite.used.galileo rect").first).to_be_attached()
    card = page.get_by_role("region", name="Sky", exact=True)
    card.get_by_role("button", name="Table").click()
    table = card.get_by_role("table")
    expect(table.get_by_role("row")).to_have_count(25)
    for name, reason in (
        ("G05", "excluded by core.cooperative, residual 31.2 m"),
        ("E18", "below the elevation mask of 10°"),
        ("R19", "unhealthy, by its own message"),
        ("C20", "orbit not known yet"),
        ("C24", "searched for, no signal yet"),
    ):
        expect(table.get_by_role("row", name=re.compile(f"^{name} "))).to_contain_text(reason)
    table.get_by_role("button", name="C/N0").click()
    expect(table.get_by_role("row").nth(1)).to_contain_text("44")


def test_signals_fix_interference_and_settings_of_the_receiver_are_shown(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["normal"].address, path="gnss")
    signals = page.get_by_role("region", name="Signals", exact=True)
    galileo = signals.locator("li", has_text="E02")
    expect(galileo.locator(".signal-name")).to_have_text(["E1", "E5a"])
    expect(galileo.locator(".signal .value")).to_have_text(["31", "28"])
    expect(galileo.locator(".signal.used .signal-name")).to_have_text(["E1"])
    expect(galileo).to_contain_text("code tracked, carrier not")
    expect(signals).to_contain_text("E5a: 0 of 6 used")
    expect(signals.locator("li", has_text="G05")).to_contain_text("excluded by core.cooperative")
    fix = page.get_by_role("region", name="Fix and corrections")
    expect(fix).to_contain_text("RTK float")
    expect(fix).to_contain_text("PDOP 1.4 HDOP 0.8")
    expect(fix).to_contain_text("26 s after the receiver's start")
    expect(fix.get_by_role("img", name=re.compile("^Fix over the last 15 minutes: RTK float"))).to_be_visible()
    interference = page.get_by_role("region", name="Jamming and spoofing")
    expect(interference).to_contain_text("none indicated UBX-SEC-SIG")
    receiver = page.get_by_role("region", name="Receiver", exact=True)
    for text in ("ZED-F9P", "HPG 1.32", "automotive", "10°", "UBX NAV-PVT, UBX NAV-SAT", "as requested, read back"):
        expect(receiver).to_contain_text(text)


def test_the_port_and_what_became_of_each_kind_of_message_are_shown(
    tmp_path: Path, open_page: Callable[..., Page]
) -> None:
    with status_server(tmp_path) as server:
        assert server.unit is not None
        page = open_page(server.address, path="gnss")
        receiver = page.get_by_role("region", name="Receiver", exact=True)
        expect(receiver).to_contain_text("UBX, NMEA at 38400 baud, not at the 115200 of the vehicle file")
        expect(receiver).to_contain_text("NMEA GGA, UBX NAV-PVT, UBX NAV-SAT")
        rows = receiver.locator("table.kinds tbody tr")
        expect(rows).to_have_count(3)
        expect(rows.nth(0)).to_contain_text("2 (ubx_date)")
        expect(rows.nth(1)).to_contain_text("known, not used")
        expect(rows.nth(2)).to_contain_text("not known")
        server.unit.port = server.unit.port.model_copy(
            update={"found": DeviceFound.NOISE, "sentence": "bytes that are no message"}
        )
        expect(receiver).to_contain_text("no messages in its bytes")
        expect(receiver).to_contain_text("bytes that are no message")


def test_without_a_receiver_the_page_says_what_to_connect(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["empty"].address, path="gnss")
    expect(page.get_by_text("No message of a GNSS receiver yet")).to_be_visible()
    expect(page.get_by_text("name its port under [sensors.gnss]")).to_be_visible()


def test_any_numeric_field_is_plotted_from_the_inspector_and_all_charts_share_the_cursor(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["normal"].address, path="system?topic=navigation/solution")
    drawer = page.get_by_role("dialog", name="Topic navigation/solution")
    drawer.get_by_label("Find a field").fill("roll")
    drawer.get_by_role("button", name="Plot roll_rad").click()
    expect(drawer.get_by_role("button", name="Plot roll_rad")).to_have_text("Plotted")
    drawer.get_by_label("Find a field").fill("velocity_ned")
    drawer.get_by_role("button", name="Plot velocity_ned_m_s.1").click()
    drawer.get_by_role("link", name="2 fields are on the page Charts").click()
    radians = page.get_by_role("region", name="Chosen fields in rad", exact=True)
    expect(radians.locator("li")).to_contain_text("navigation/solution:roll_rad0.01rad")
    expect(page.get_by_role("region", name="Chosen fields in m/s", exact=True)).to_contain_text(
        "velocity_ned_m_s.1 (east)"
    )
    page.get_by_role("button", name="1 min").click()
    speed = page.get_by_role("region", name="Speed", exact=True)
    chart = speed.get_by_role("img", name=re.compile("Speed over time. Fused 32.4 km"))
    expect(chart.locator("canvas")).to_be_visible()
    speed.locator(".u-over").hover()
    expect(page.locator(".cursor-time")).to_have_text(re.compile(r"At \d\d:\d\d:\d\d UTC"))
    shown = page.locator(".u-cursor-x").evaluate_all("all => all.map((e) => e.style.transform)")
    assert len(shown) > 5 and len(set(shown)) == 1, "a cursor in every chart, at one place"
    chart.focus()
    before = page.locator(".cursor-time").inner_text()
    for _ in range(10):
        page.keyboard.press("ArrowLeft")
    expect(page.locator(".cursor-time")).not_to_have_text(before)
    speed.get_by_role("button", name="Table").click()
    expect(speed.get_by_role("table")).to_contain_text("Fused, km/h")
    radians.get_by_role("button", name="Remove navigation/solution:roll_rad").click()
    expect(page.get_by_role("region", name="Chosen fields")).to_have_count(1)


def test_charts_stand_still_while_the_display_is_paused(
    units: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(units["normal"].address, path="charts")
    expect(page.locator(".plot canvas").first).to_be_visible()
    page.locator(".chart-tools").get_by_role("button", name="Pause").click()
    innovations = page.get_by_role("region", name="Latency", exact=True)
    innovations.get_by_role("button", name="Table").click()
    first = innovations.get_by_role("table").inner_text()
    page.wait_for_timeout(2200)
    assert innovations.get_by_role("table").inner_text() == first
    page.locator(".chart-tools").get_by_role("button", name="Resume").click()
    expect(innovations.get_by_role("table")).not_to_have_text(first)
