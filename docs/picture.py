"""Takes the pictures of the dashboard from running demos: docs/dashboard.png, and every page of both roles."""

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
from playwright.sync_api import Browser, Page, sync_playwright

HERE = Path(__file__).parent
PATIENCE_S = 120.0
DRIVE_S = 35.0  # the speed plot and the trail fill in this time
PAGE_S = 6.0  # a page draws itself in this time
COLOURS = 256  # of a picture: a third of the bytes
WEBGL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")  # the map, without a graphics card
SIZES = {"": {"width": 1360, "height": 850}, "-phone": {"width": 390, "height": 844}}
DEMOS = {"obu": (("--scenario", "urban"), "navigation/solution"), "rsu": (("--role", "rsu"), "toll/tracks")}


def main() -> None:
    """Write the pictures."""
    chromium = shutil.which("chromium")
    if chromium is None:
        raise SystemExit("Chromium is not installed: `make picture` needs it")
    (HERE / "pages").mkdir(exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", *WEBGL])
        for role, (arguments, awaited) in DEMOS.items():
            with demo(arguments, awaited) as base:
                photograph(browser, base, role)
        browser.close()


@contextmanager
def demo(arguments: tuple[str, ...], awaited: str) -> Iterator[str]:
    """Run a demo and give the address of its dashboard when a topic has a message."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "cli", "demo", "--port", "0", *arguments]
        process = subprocess.Popen(command, env=os.environ | {"OBU_STATE": folder})
        try:
            yield address(process, Path(folder), awaited)
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


def photograph(browser: Browser, base: str, role: str) -> None:
    """Open every page that the dashboard names, wide and as on a phone, in light and in dark."""
    page = browser.new_page(viewport={"width": 1360, "height": 850}, reduced_motion="reduce")
    page.goto(base)
    page.wait_for_timeout(DRIVE_S * 1000)
    names = [str(link.get_attribute("href")).removeprefix("#/") for link in page.locator("nav.pages a").all()]
    if role == "obu":
        keep(page, HERE / "dashboard.png")
    for name in names:
        page.goto(f"{base}/#/{name}")
        for suffix, viewport in SIZES.items():
            page.set_viewport_size(viewport)  # type: ignore[arg-type]  # two numbers
            page.emulate_media(color_scheme="dark" if suffix else "light")
            page.wait_for_timeout(PAGE_S * 1000)
            keep(page, HERE / "pages" / f"{role}-{name}{suffix}.png")
    page.close()


def keep(page: Page, path: Path) -> None:
    """Save a screenshot with few colours."""
    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    picture.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)


if __name__ == "__main__":
    main()
