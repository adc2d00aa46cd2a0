"""Debian's Chromium under playwright, or a skipped test that says what is missing."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright

from services.monitoring.status.page import DASHBOARD

AXE = DASHBOARD / "node_modules" / "axe-core" / "axe.min.js"
PATIENCE_MS = 30_000  # with what a page must show: a machine that also does something else may need seconds
expect.set_options(timeout=PATIENCE_MS)
# WebGL in software; pages are drawn without it, which is far faster where there is no graphics card.
WEBGL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-compositing")

uncaught: list[str] = []  # errors of pages; a test fails while there is one, and one that expects it removes it


def program() -> str | None:
    """Find Chromium; the shell without a window draws the same pages for about half of the processor time."""
    names = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
    return next(filter(None, map(shutil.which, names)), None)


@contextmanager
def chromium(names: str = "MAP obu.local 127.0.0.1") -> Iterator[Browser]:
    """Run a browser for the length of a block; `names` are rules by which it resolves names."""
    path = program()
    if path is None:
        pytest.skip("no Chromium here: `apt-get install chromium-headless-shell`, or chromium")
    if not AXE.exists():
        pytest.skip("the browser tests' libraries are missing: `python deploy/install_dashboard.py --testing`")
    # A name that resolves here makes the page an insecure context, as on a vehicle's own network.
    arguments = [
        f"--host-resolver-rules={names}",
        *WEBGL,
        *(["--no-sandbox"] if os.geteuid() == 0 else []),
    ]
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=path, args=arguments)
        uncaught.clear()
        _note_errors(started)
        yield started
        started.close()
        assert not uncaught, "a page reported an error that its program did not catch"


def _note_errors(browser: Browser) -> None:
    """Let every page note the errors that its program did not catch, whoever opens it and however."""

    def noting(make: Callable[..., BrowserContext | Page]) -> Callable[..., BrowserContext | Page]:
        @wraps(make)
        def made(*arguments: object, **options: object) -> BrowserContext | Page:
            opened = make(*arguments, **options)
            context = opened if isinstance(opened, BrowserContext) else opened.context
            context.on("weberror", lambda web_error: uncaught.append(web_error.error.stack or str(web_error.error)))
            return opened

        return made

    for name in ("new_context", "new_page"):
        setattr(browser, name, noting(getattr(browser, name)))
