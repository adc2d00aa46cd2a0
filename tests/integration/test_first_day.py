"""From a blank Debian to SAFE in a simulated car, by one line and a phone: nothing else is typed on the machine.

It takes some minutes, and fetches packages, so it is slow and of `make containers`; it skips as test_installation.py.
"""

import re
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from cli.demo.local import free_port
from tests.support.blank_machine import blank_machine
from tests.support.dashboard.chromium import chromium

pytestmark = [pytest.mark.container, pytest.mark.slow]

SYSTEM = "debian:bookworm-slim"
PHONE = {"width": 390, "height": 844}
FIRST_DAY_S = 15 * 60.0
SAFE = re.compile(r"\bSAFE\b")
LINK = re.compile(r"http://([^/:\s]+):(\d+)/login#token=\S+")


def test_a_phone_alone_leads_from_a_blank_system_to_safe_in_a_simulated_car(
    tmp_path: Path, record_testsuite_property: Callable[[str, object], None]
) -> None:
    port = free_port()
    with blank_machine(SYSTEM, tmp_path, ("--publish", f"127.0.0.1:{port}:8080")) as machine:
        begun = time.monotonic()
        link = LINK.search(machine.run("sh /src/deploy/install.sh"))
        assert link, "the login is printed"
        installed = time.monotonic()
        # The name that the unit announces is resolved as its network would, to what the container publishes.
        with chromium(f"MAP {link[1]}:{link[2]} 127.0.0.1:{port}") as browser:
            page = browser.new_page(viewport=PHONE)  # type: ignore[arg-type]  # a dictionary as playwright takes it
            page.goto(link[0])
            expect(page.locator(".banner")).to_be_visible()
            _is_used_up(browser.new_page(), link[0])
            page.get_by_role("link", name="Set up this unit").click()
            page.get_by_role("button", name="Use these settings: A simulated car").click()
            expect(page.get_by_text("The change is being watched")).to_be_visible(timeout=90_000)
            page.get_by_role("link", name="Now", exact=True).click()
            expect(page.locator(".banner")).to_contain_text(SAFE, timeout=240_000)
            safe = time.monotonic()
            expect(page.get_by_role("heading", name="Position")).to_be_visible()
            page.get_by_role("link", name="Settings").click()
            expect(page.get_by_text("Change is kept")).to_be_visible(timeout=180_000)
        assert safe - begun < FIRST_DAY_S
        record_testsuite_property("installed_s", round(installed - begun))
        record_testsuite_property("safe_s", round(safe - begun))
        running = machine.services
        assert "obu@sensors.simulator.service" in running and "obu@sensors.gnss.service" not in running
        # No process has got a right over others: each has its own user, and none is root.
        users = machine.run("systemctl show --property User --value 'obu@*'").split()
        assert len(users) == len(running) == len(set(users)) and "root" not in users


def _is_used_up(page: Page, link: str) -> None:
    """A code is used once: another browser is asked for another one."""
    page.goto(link)
    expect(page.get_by_role("alert")).to_contain_text("not valid")
    expect(page.locator(".banner")).to_have_count(0)
    page.close()
