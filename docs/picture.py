"""Takes the pictures of the dashboard from running demos: docs/dashboard.png, and docs/pages."""

import io
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
from PIL import Image
from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright

from benchmarks.long_drive import write
from tests.support.dashboard.chromium import WEBGL, program

HERE = Path(__file__).parent
PATIENCE_S = 120.0
DRIVE_S = 35.0  # the speed plot and the trail fill in this time
PAGE_S = 6.0  # a page draws itself in this time
SUMMARY_S = 30.0  # the summary of the earlier drive is computed in this time
COLOURS = (256, 128, 64, 32)  # of a picture: the most that stay below the limit
LARGEST = 150_000  # bytes
LIMIT_MS = 120_000  # for a screenshot, in software and on a busy machine
WIDE: ViewportSize = {"width": 1360, "height": 850}
PHONE: ViewportSize = {"width": 390, "height": 844}
UNKNOWN = (
    "",
    "STARTING",
    "INITIALISING",
    "NO POSITION",
    "NO DATA",
    "NO CONNECTION",
    "BROKER LOST",
)  # words of the banner
MORE = ("now", "map")  # pages that are shown dark and on a phone as well
EARLIER = ("20260921T141320Z_demo.mcap", 120.0)  # a drive of this length [s] for the page Recordings
DEMOS = (  # arguments, the topic that is waited for, the pages
    (
        ("--scenario", "urban"),
        "navigation/solution",
        ("now", "map", "gnss", "charts", "trust", "recordings", "system", "settings", "set_up"),
    ),
    (("--role", "rsu"), "toll/tracks", ("toll",)),
)


def main() -> None:
    """Write the pictures."""
    chromium = program()
    if chromium is None:
        raise SystemExit("Chromium is not installed: `make picture` needs it")
    (HERE / "pages").mkdir(exist_ok=True)
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        earlier = write(Path(folder) / EARLIER[0], EARLIER[1])
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", *WEBGL])
        for arguments, awaited, names in DEMOS:
            with demo(arguments, awaited, earlier) as base:
                photograph(browser, base, names)
        browser.close()


@contextmanager
def demo(arguments: tuple[str, ...], awaited: str, earlier: Path) -> Iterator[str]:
    """Run a demo with the recording of an earlier drive, and give its address when a topic has a message."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "cli", "demo", "--port", "0", *arguments]
        process = subprocess.Popen(command, env=os.environ | {"OBU_STATE": folder})
        try:
            base = address(process, Path(folder), awaited)
            shutil.copy2(earlier, Path(folder) / "demo" / "recordings")
            yield base
        finally:
            process.terminate()
            process.wait()


def address(process: subprocess.Popen[bytes], folder: Path, awaited: str) -> str:
    """Wait until the demo publishes a topic, and say where its dashboard is."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.5)
        for file in folder.glob("*/status.address"):
            base = file.read_text().strip().rstrip("/")
            answer = httpx.get(f"{base}/api/topics/{awaited}")
            if answer.is_success and answer.json()["message"] is not None:
                return base
    raise SystemExit(f"the demo ended, or published no {awaited} in {PATIENCE_S:.0f} s")


def photograph(browser: Browser, base: str, names: tuple[str, ...]) -> None:
    """Open the pages, wide and light, and some of them dark and as on a phone."""
    page = browser.new_page(viewport=WIDE, reduced_motion="reduce")
    page.set_default_timeout(LIMIT_MS)
    page.goto(base)
    page.wait_for_timeout(DRIVE_S * 1000)
    wait_for_verdict(page)
    if "now" in names:
        keep(page, HERE / "dashboard.png")
    for name in names:
        page.goto(f"{base}/#/{name}")
        for suffix, viewport in ("", WIDE), ("-dark", WIDE), ("-phone", PHONE):
            if suffix and name not in MORE:
                continue
            page.set_viewport_size(viewport)
            page.emulate_media(color_scheme="dark" if suffix == "-dark" else "light")
            page.wait_for_timeout((SUMMARY_S if name == "recordings" else PAGE_S) * 1000)
            wait_for_verdict(page)
            keep(page, HERE / "pages" / f"{name}{suffix}.png")
        page.set_viewport_size(WIDE)
        page.emulate_media(color_scheme="light")
    page.close()


def wait_for_verdict(page: Page) -> None:
    """Wait until the position is known: a machine that was too busy for a moment shows NO POSITION."""
    word = page.locator(".banner .word")
    while word.inner_text() in UNKNOWN:
        page.wait_for_timeout(500)


def keep(page: Page, path: Path) -> None:
    """Save a screenshot with as many colours as its size allows."""
    picture = Image.open(io.BytesIO(page.screenshot(animations="disabled"))).convert("RGB")
    for colours in COLOURS:
        picture.quantize(colours, dither=Image.Dither.NONE).save(path, optimize=True)
        if path.stat().st_size < LARGEST:
            return


if __name__ == "__main__":
    main()
