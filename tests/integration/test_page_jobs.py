"""Replay and solution from the page Recordings of a whole unit, in a real browser."""

import re
from collections.abc import Iterator

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.integration.test_demo import Demo, start_demo
from tests.support.chromium import chromium
from tests.support.golden import record_golden_drive

pytestmark = [pytest.mark.whole_unit, pytest.mark.broker, pytest.mark.browser]


@pytest.fixture
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Demo]:
    running = start_demo(tmp_path_factory.mktemp("demo"))
    running.wait(lambda: running.solutions() > 100, 90.0, "the drive has begun")
    yield running
    running.process.terminate()
    running.process.communicate(timeout=10.0)


def test_the_drive_so_far_is_replayed_and_solved_from_the_page(demo: Demo) -> None:
    broken = demo.folder / "recordings" / "20200101T000000Z_broken.mcap"
    broken.write_bytes(b"this is no recording")
    half_a_minute = record_golden_drive(demo.folder / "recordings" / "20200102T000000Z_demo.mcap")
    address = f"http://127.0.0.1:{demo.port}"
    with chromium() as browser:
        page = browser.new_page()
        page.goto(f"{address}/#/recordings")
        ours = page.locator(".recording", has_text="being recorded")
        ours.get_by_role("button", name="Replay").click()
        opens = page.get_by_role("link", name="Open the replay")
        expect(opens).to_be_visible(timeout=40_000)
        expect(ours.get_by_role("button", name="Solve")).to_be_disabled()
        second = httpx.post(f"{address}/api/recordings", json={"action": "solve", "name": broken.name}, timeout=5.0)
        assert (second.status_code, second.json()["detail"]) == (409, "another job runs; stop it first")
        with page.expect_popup() as popup:
            opens.click()
        replay_and_scrub(popup.value)
        page.get_by_role("button", name="Stop").click()
        job = page.locator(".job")
        expect(job).to_contain_text("has ended", timeout=15_000)
        short = page.locator(".recording", has=page.get_by_role("button", name=f"Delete {half_a_minute.name}"))
        short.get_by_role("button", name="Solve").click()
        expect(job).to_contain_text("runs")
        report = short.get_by_role("link", name="Report")
        expect(report).to_be_visible(timeout=60_000)
        expect(job).to_contain_text(re.compile("has ended.*Wrote .*report.html"), timeout=10_000)
        with page.expect_popup() as popup:
            report.click()
        expect(popup.value.get_by_role("heading", level=1)).to_be_visible()
        page.locator(".recording", has_text="broken").get_by_role("button", name="Solve").click()
        expect(job).to_contain_text("is no recording, not even a damaged one", timeout=20_000)
        expect(job).to_contain_text("failed")
        expect(page.locator(".recording", has_text="broken")).to_contain_text("cannot be read", timeout=20_000)
    for file in broken, half_a_minute:
        file.unlink()


def replay_and_scrub(page: Page) -> None:
    """Pause, choose a speed and drag to a position: the page shows recorded time as a replay."""
    expect(page.locator(".origin")).to_contain_text("REPLAY", timeout=15_000)
    page.get_by_role("button", name="Pause the replay").click()
    expect(page.get_by_role("button", name="Play", exact=True)).to_be_visible()
    page.get_by_label("Speed of the replay").select_option("10")
    scrubber = page.get_by_role("slider")
    scrubber.fill("12")
    expect(page.locator(".replay-time")).to_contain_text("0:12 of")
    held = page.locator(".replay-time").inner_text()
    page.wait_for_timeout(500)
    assert page.locator(".replay-time").inner_text() == held
    page.get_by_role("button", name="Play", exact=True).click()
    expect(page.locator(".replay-time")).to_contain_text(re.compile("0:(1[5-9]|[2-5])"))
