"""A real Chromium, and a unit in each of the states that the dashboard must show well."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, ViewportSize

from tests.support.dashboard.chromium import chromium, uncaught
from tests.support.dashboard.status_server import RunningServer, status_server

THEMES: dict[str, ViewportSize] = {
    "light": {"width": 1360, "height": 850},
    "dark": {"width": 1360, "height": 850},
    "phone-dark": {"width": 390, "height": 844},
    "phone": {"width": 390, "height": 844},
}
# Tests that stop a server see refused connections; a test machine's own network may change at any time.
EXPECTED = ("ERR_CONNECTION_REFUSED", "ERR_NETWORK_CHANGED", "WebSocket", "503 (Service Unavailable)")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = str(Path(__file__).parent)
    for item in items:
        if str(item.path).startswith(here):
            item.add_marker(pytest.mark.browser)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as started:
        yield started


@pytest.fixture(autouse=True)
def no_page_fails() -> Iterator[list[str]]:
    """Fail a test in which a page reported an error that its program did not catch; gives these errors."""
    yield uncaught
    found = list(uncaught)
    uncaught.clear()
    assert not found, "a page reported an error that its program did not catch"


class Units(dict[str, RunningServer]):
    """Units in four states, each started when a test first asks for it: one that works, and three that do not."""

    def __init__(self, stack: ExitStack, folder: Callable[[str], Path]) -> None:
        super().__init__()
        self._stack, self._folder = stack, folder

    def __missing__(self, state: str) -> RunningServer:
        """Start the unit of a state."""
        running = self._stack.enter_context(
            status_server(self._folder(state), unit=state != "empty", allowed_hosts=["obu.local"])
        )
        if state == "stale":
            assert running.unit
            running.unit.fall_silent_after(2.0, "core.fusion")
        if state == "alarm":
            assert running.unit
            running.unit.rejecting = True
            running.unit.fall_silent_after(2.0, "imu")
            running.unit.kill_after(2.0, "monitoring.recorder")
        self[state] = running
        return running


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Units]:
    with ExitStack() as stack:
        yield Units(stack, tmp_path_factory.mktemp)


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Callable[..., Page]]:
    """Open pages of which the test fails on any error in the console."""
    contexts, errors = [], []

    def note(message: ConsoleMessage, expected: tuple[str, ...]) -> None:
        if message.type == "error" and not any(part in message.text for part in expected):
            errors.append(message.text)

    def opener(
        address: str, *, theme: str = "light", path: str = "", expected: tuple[str, ...] = (), **options: object
    ) -> Page:
        scheme = "dark" if theme.endswith("dark") else "light"
        settings = {"viewport": THEMES[theme], "color_scheme": scheme, **options}
        context = browser.new_context(**settings)  # type: ignore[arg-type]  # the options are playwright's own
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: note(message, (*EXPECTED, *expected)))
        page.goto(f"{address}/#/{path}")
        return page

    yield opener
    for context in contexts:
        context.close()
    assert not errors
