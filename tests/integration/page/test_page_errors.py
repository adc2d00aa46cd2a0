"""Reports of pages whose program failed: counted and bounded, and their text stays on one line of the log."""

from collections.abc import Iterator
from pathlib import Path
from typing import cast

import httpx
import pytest

from services.monitoring.status.web.page_errors import MAX_PENDING, REJECT, PageErrorsApi, count
from shared.bus.bus import Bus
from shared.page.page_error import PageError
from tests.support.dashboard.fake_unit import FakeBus
from tests.support.dashboard.status_server import RunningServer, change, eventually, status_server
from tests.support.patience import HANGS_S

REPORT = {"page": "gnss", "message": "TypeError: x is null", "place": "gnss/gnss.js:231:5"}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    with status_server(tmp_path_factory.mktemp("unit"), unit=False) as running:
        yield running


def test_a_report_is_counted_in_the_health_of_the_process(server: RunningServer) -> None:
    assert change(server.address, "/api/page-error", REPORT).status_code == 202
    eventually(lambda: server.bus.rejects[REJECT] == 1)
    assert server.bus.last_error == "page 'gnss': 'TypeError: x is null' at 'gnss/gnss.js:231:5'"


TOO_LONG = ({**REPORT, "message": "x" * 401}, {**REPORT, "page": "x" * 3000})


@pytest.mark.parametrize("bad", [*TOO_LONG, {**REPORT, "more": 1}, {"page": "gnss"}, []])
def test_what_is_no_report_is_refused(server: RunningServer, bad: object) -> None:
    before = server.bus.rejects[REJECT]
    assert change(server.address, "/api/page-error", bad).status_code in (413, 422)
    assert server.bus.rejects[REJECT] == before


def test_a_page_from_elsewhere_reports_nothing(server: RunningServer) -> None:
    answer = httpx.post(f"{server.address}/api/page-error", json=REPORT, timeout=HANGS_S)
    assert answer.status_code == 403


def test_a_text_cannot_begin_a_line_of_the_log_and_fits_into_a_heartbeat(tmp_path: Path) -> None:
    bus, errors = FakeBus(tmp_path), PageErrorsApi()
    for _ in range(MAX_PENDING):
        errors.reports.put_nowait(PageError(page="a\nERROR b", message="\x1b[2J\u202e" * 66, place="\r" * 400))
    count(errors, cast(Bus, bus))
    assert bus.rejects[REJECT] == MAX_PENDING
    assert bus.last_error is not None and len(bus.last_error) <= 400 and bus.last_error.isprintable()
