"""Takes the README's picture: starts the demo, waits until the car drives, and photographs the dashboard."""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import httpx
from playwright.sync_api import sync_playwright

HERE = Path(__file__).parent
PATIENCE_S = 120.0
DRIVE_S = 35.0  # the speed plot and the trail fill in this time


def main() -> None:
    """Write docs/dashboard.png."""
    chromium = shutil.which("chromium")
    if chromium is None:
        raise SystemExit("Chromium is not installed: `make picture` needs it")
    with tempfile.TemporaryDirectory() as folder:
        demo = subprocess.Popen(
            [sys.executable, "-m", "cli", "demo", "--port", "0"], env=os.environ | {"OBU_STATE": folder}
        )
        try:
            photograph(chromium, address(demo, Path(folder) / "demo" / "status.address"))
        finally:
            demo.terminate()
            demo.wait()


def address(demo: subprocess.Popen[bytes], file: Path) -> str:
    """Wait until the unit navigates, and say where its dashboard is."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline and demo.poll() is None:
        time.sleep(0.5)
        if file.exists():
            base = file.read_text().strip()
            if httpx.get(f"{base.rstrip('/')}/api/topics/navigation/solution").is_success:
                return base
    raise SystemExit(f"the demo ended, or gave no position in {PATIENCE_S:.0f} s")


def photograph(chromium: str, base: str) -> None:
    """Open the dashboard, let it draw, and save what it shows."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1360, "height": 850})
        page.goto(base)
        page.wait_for_timeout(DRIVE_S * 1000)
        page.screenshot(path=HERE / "dashboard.png")
        browser.close()


if __name__ == "__main__":
    main()
