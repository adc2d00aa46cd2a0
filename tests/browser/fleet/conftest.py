"""The pages of a centre in a real Chromium, with a real database, a real bus and vehicles that report."""

import time
from collections.abc import Callable, Iterator

import psycopg
import pytest
from playwright.sync_api import Page

from tests.support.fleet.database import database, emptied
from tests.support.fleet.reports import Unit
from tests.support.fleet.web import RunningWeb, bus, tenant, web

VERDICTS = {"car-safe": 0, "car-caution": 1, "car-tunnel": 2, "car-start": 3, "car-lost": 4, "car-unsafe": 5}


@pytest.fixture(scope="module")
def centre() -> Iterator[RunningWeb]:
    """A centre with a vehicle of each verdict, an old one, an alarm, a gap and events."""
    with database() as postgres, bus() as nats_url:
        dsn = emptied(postgres)
        tenant(dsn)
        with web(dsn, nats_url) as running:
            fill(running)
            yield running


def fill(running: RunningWeb) -> None:
    now_ms = time.time_ns() // 1_000_000
    for number, (name, verdict) in enumerate(VERDICTS.items()):
        unit = Unit(name, number + 1, now_ms - 5000)
        unit.next = number * 400_000  # the place follows from the number: 4.4 km from the next one
        unit.enter(running.dsn)
        running.report(unit, 0, verdict, verdict)
    old = Unit("car-old", 90, now_ms - 3_600_000)
    old.next = 3_000_000
    old.enter(running.dsn)
    running.report(old, 1)
    tail = Unit("car-unsafe", 6, now_ms - 1000)
    running.send("car-unsafe", tail.events("trust/event"))
    running.send("car-unsafe", tail.gap(tail.next, 25))
    running.wait_for("SELECT 1 FROM gap WHERE vehicle = 'car-unsafe'")
    with psycopg.connect(running.dsn) as db:
        db.execute(
            "INSERT INTO alarm (tenant_id, vehicle, kind, since_ms, detail) VALUES "
            "(1, 'car-unsafe', 'unsafe', %s, '{}'), (1, 'car-old', 'silent', %s, '{}')", (now_ms, now_ms - 3_000_000),
        )  # fmt: skip


@pytest.fixture
def open_centre(centre: RunningWeb, open_page: Callable[..., Page]) -> Callable[..., Page]:
    """Open a page of the centre as somebody who has logged in."""

    def opener(path: str, name: str = "anna", **options: object) -> Page:
        page = open_page("about:blank", **options)
        cookie = centre.visitor(name).http.cookies["obu-centre"]
        page.context.add_cookies([{"name": "obu-centre", "value": cookie, "url": centre.address}])
        page.goto(f"{centre.address}/{path}")
        return page

    return opener
