"""A two-hour recording in the browser: `python -m benchmarks.replay [opens scrubs memory]`.

Opens it with `obu replay`, drags the scrubber at ten positions a second, and lets pages take as many frames as in an
hour. Needs Chromium and the libraries of the browser tests, and a machine that does nothing else.
"""

import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import psutil
from playwright.sync_api import Browser, Page

from benchmarks import tables
from benchmarks.long_drive import write
from shared.messages.navigation import NavigationSolution
from shared.recording import Recording
from shared.recording.index import RecordingIndex
from tests.support.dashboard.chromium import chromium
from tests.support.dashboard.status_server import change
from tests.support.data import REPOSITORY

HEAD = """# A two-hour recording in the browser

Printed by `python -m benchmarks.replay`: `obu replay` of a simulated drive of two hours ({size_mb:.0f} MB), in Debian's
Chromium without a graphics card, on a machine with {cores} cores that others use too, most of them at a lower priority.
Times are of a machine as busy as the load says, in runnable processes.

"""
RESULTS = Path(__file__).parent / "results"
FOLDER = REPOSITORY / ".obu" / "benchmarks"
DRIVES = {"two-hours": 7200.0, "hour": 3900.0}  # name of the recording, its length [s]
SMOKE_S = 60.0
LIMIT_MS = 120_000
PAGES = ("now", "map", "gnss", "charts", "trust", "system")
POSITIONS, SCRUB_HZ = 50, 10.0
REPEATED_FRAMES = 1000  # of the page Map after its hour: drawn in software, 18,000 take more than ten minutes
NEAR_DEG = 2e-6  # 0.2 m: that the page shows this position and no other
HOUR_FRAMES, FRAME_HZ, SPEED = 18_000, 5, 60.0
HOUR_S = 3600.0
# Gives the page every frame `window.times` times, numbered anew, one after another, and drops frames
# that come faster than it takes them: on a slow machine they would else be measured as memory of the page.
REPEATED = """(times) => {
  window.times = times;
  delete window.DecompressionStream;
  const waiting = [], { port1, port2 } = new MessageChannel();
  let sequence = 0;
  window.taken = 0;
  const set = Object.getOwnPropertyDescriptor(WebSocket.prototype, "onmessage").set;
  Object.defineProperty(WebSocket.prototype, "onmessage", { set(handler) {
    waiting.length = 0;
    set.call(this, (event) => {
      if (waiting.length > 5) return;
      const frame = JSON.parse(event.data);
      const copies = frame.kind === "difference" ? window.times : 1;
      if (waiting.push({ frame, copies, handler }) === 1) port2.postMessage(0);
    });
  } });
  port1.onmessage = () => {
    const next = waiting[0];
    if (!next) return;
    sequence += 1;
    window.taken += 1;
    next.handler({ data: JSON.stringify({ ...next.frame, sequence }) });
    next.copies -= 1;
    if (next.copies === 0) waiting.shift();
    if (waiting.length) port2.postMessage(0);
  };
}"""
# Samples what the page shows, once per picture: time [ms], latitude, longitude [deg].
SAMPLER = """() => {
  const shown = (window.shown = []);
  const look = () => {
    const texts = [...document.querySelectorAll(".coordinates dd")].map((e) => e.textContent);
    const [latitude, longitude] = texts.map(parseFloat);
    const last = shown.at(-1);
    if (!last || last[1] !== latitude || last[2] !== longitude) shown.push([performance.now(), latitude, longitude]);
    requestAnimationFrame(look);
  };
  look();
  const slider = document.querySelector(".replay-scrubber input");
  window.dragged = [];
  slider.addEventListener("input", () => window.dragged.push([performance.now(), Number(slider.value)]));
}"""
Row = dict[str, Any]


def processor_s() -> float:
    """Processor time of what `obu replay` runs [s]; what the browser takes is left out."""
    children = psutil.Process().children(recursive=True)
    ours = [p for p in children if p.name().startswith(("python", "mosquitto"))]
    return float(sum(sum(p.cpu_times()[:2]) for p in ours))


@contextmanager
def replay_of(drive: Path) -> Iterator[tuple[str, float]]:
    """Run `obu replay`; give the address of the page and the time until it was printed [s]."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "cli", "replay", str(drive), "--port", "0"]
        began = time.monotonic()
        with subprocess.Popen(
            command, env={**os.environ, "OBU_STATE": folder}, stderr=subprocess.PIPE, text=True
        ) as process:
            assert process.stderr is not None
            line = next((line for line in process.stderr if "replayed at" in line), "")
            took_s = time.monotonic() - began
            try:
                yield line.split("replayed at ")[1].split()[0], took_s
            finally:
                process.terminate()
                process.communicate()


def opened(browser: Browser, drive: Path) -> list[Row]:
    """Time the opening: the address, the bar with its scrubber and recorded time, the events on the scrubber."""
    rows: list[Row] = []
    summary = drive.with_name(drive.name + ".summary.json")
    for known in (False, True):
        summary.unlink(missing_ok=True)
        if known:
            subprocess.run([sys.executable, "-m", "shared.recording.summary", str(drive), str(summary)], check=True)
        page = browser.new_page()
        with replay_of(drive) as (address, address_s):
            began = time.monotonic()
            page.goto(address)
            page.locator(".replay-scrubber input").wait_for(timeout=LIMIT_MS)
            page.locator(".replay-time time").wait_for(timeout=LIMIT_MS)
            page_s, busy_s = time.monotonic() - began, processor_s()
            page.locator(".replay-track .segment").nth(1).wait_for(state="attached", timeout=LIMIT_MS)
            events_s = time.monotonic() - began
        page.close()
        rows.append({
            "summary_known": known, "address_s": address_s, "page_s": page_s, "events_s": address_s + events_s,
            "opens_s": address_s + page_s, "processor_s": busy_s,
        })  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def scrubbed(browser: Browser, drive: Path) -> Row:
    """Drag the scrubber over the drive; time from each movement to the picture that shows its position [ms]."""
    page = browser.new_page(viewport={"width": 1360, "height": 850})
    with replay_of(drive) as (address, _), Recording(drive) as recording:
        page.goto(address)
        page.get_by_role("button", name="Pause the replay").click(timeout=LIMIT_MS)
        page.get_by_role("button", name="Play", exact=True).wait_for()
        box = page.locator(".replay-scrubber input").bounding_box()
        assert box is not None
        at = [box["x"] + box["width"] * (0.1 + 0.8 * k / POSITIONS) for k in range(POSITIONS)]
        _ask(address, command="seek", position_s=600.0)
        page.locator(".coordinates").wait_for(timeout=LIMIT_MS)  # none before the first solution
        page.evaluate(SAMPLER)
        page.mouse.move(at[0], box["y"] + box["height"] / 2)
        page.mouse.down()
        began = time.monotonic()
        for k, x in enumerate(at):
            page.wait_for_timeout(max(0.0, began + k / SCRUB_HZ - time.monotonic()) * 1000)
            page.mouse.move(x, box["y"] + box["height"] / 2)
        page.wait_for_timeout(1500)
        page.mouse.up()
        dragged, shown = page.evaluate("[window.dragged, window.shown]")
        index = RecordingIndex(recording)
        times_ms = [found for moved in dragged if (found := _shown_after(moved, shown, index)) is not None]
    page.close()
    return {
        "positions": len(dragged), "hz": (len(dragged) - 1) / (dragged[-1][0] - dragged[0][0]) * 1000,
        "shown": len(times_ms), "median_ms": statistics.median(times_ms),
        "p95_ms": sorted(times_ms)[int(0.95 * len(times_ms))], "largest_ms": max(times_ms),
    }  # fmt: skip


def _shown_after(moved: list[float], shown: list[list[float]], index: RecordingIndex) -> float | None:
    """Time from a movement of the scrubber to the picture with the position that was recorded there."""
    at_ms, value_s = moved
    there = next(
        message for envelope in index.newest(index.begin_ns + round(value_s * 1e9))
        if isinstance(message := envelope.decode(), NavigationSolution)
    )  # fmt: skip
    return next((
        t - at_ms for t, latitude, longitude in shown
        if t >= at_ms
        and max(abs(latitude - there.latitude_deg), abs(longitude - there.longitude_deg)) < NEAR_DEG
    ), None)  # fmt: skip


def remembered(browser: Browser, drive: Path, name: str) -> Row:
    """Play the first hour at 60 times its speed, each frame 60 times: what the page's memory is before and after.

    The page Map takes each frame once, so that the track of an hour is there, then `REPEATED_FRAMES` more.
    """
    drawn = name == "map"
    page = browser.new_page(viewport={"width": 1360, "height": 850})
    page.add_init_script(f"({REPEATED})({1 if drawn else SPEED:.0f})")
    with replay_of(drive) as (address, _):
        page.goto(f"{address}/#/{name}")
        page.locator("h2").first.wait_for(timeout=LIMIT_MS)
        page.wait_for_timeout(3000)
        row: Row = {"page": name, "recording": drive.stem, **_named("before", _memory(page))}
        _ask(address, command="speed", speed=SPEED)
        if drawn:
            while _position_s(address) < HOUR_S:
                page.wait_for_timeout(1000)
            row |= {"played_s": _position_s(address), **_named("hour", _memory(page))}
            _ask(address, command="speed", speed=1.0)
            page.evaluate(f"window.times = {SPEED:.0f}")
        taken = page.evaluate("window.taken")
        wanted = taken + REPEATED_FRAMES if drawn else HOUR_FRAMES
        while page.evaluate("window.taken") < wanted:
            page.wait_for_timeout(1000)
        row |= {"frames": page.evaluate("window.taken"), **_named("after", _memory(page))}
        if drawn:
            row["repeated"] = row["frames"] - taken
    page.close()
    print(row, flush=True)
    return row


def _named(when: str, memory: dict[str, float]) -> Row:
    return {f"{key}_{when}_mb": value for key, value in memory.items()}


def _ask(address: str, **command: object) -> None:
    change(address, "/api/replay", command).raise_for_status()


def _position_s(address: str) -> float:
    """Time of the recording that has been played [s]."""
    replay = httpx.get(f"{address}/api/replay", timeout=5.0).raise_for_status().json()["replay"]
    return float(replay["position_ns"] - replay["begin_ns"]) / 1e9


def _memory(page: Page) -> dict[str, float]:
    """Heap of the page's scripts after a collection, and private memory of its process [MB].

    `collected` is the private memory after a collection of the page's workers too, whose heaps have their own.
    """
    session = page.context.new_cdp_session(page)
    session.send("HeapProfiler.collectGarbage")
    session.send("Performance.enable")
    metrics = {metric["name"]: metric["value"] for metric in session.send("Performance.getMetrics")["metrics"]}
    found = {"heap": round(metrics["JSHeapUsedSize"] / 1e6, 1), "process": _private_mb()}
    workers: list[str] = []
    session.on("Target.attachedToTarget", lambda event: workers.append(event["sessionId"]))
    session.send("Target.setAutoAttach", {"autoAttach": True, "waitForDebuggerOnStart": False, "flatten": False})
    page.wait_for_timeout(500)
    collect = json.dumps({"id": 1, "method": "HeapProfiler.collectGarbage"})
    for worker in workers:
        session.send("Target.sendMessageToTarget", {"sessionId": worker, "message": collect})
    if workers:
        page.wait_for_timeout(2000)
        found["collected"] = _private_mb()
    session.detach()
    return found


def _private_mb() -> float:
    renderers = [p for p in psutil.Process().children(recursive=True) if "--type=renderer" in p.cmdline()]
    return round(max((p.memory_full_info().uss for p in renderers), default=0) / 1e6, 1)


def painted(browser: Browser, drive: Path) -> dict[str, float]:
    """First contentful paint of each page [s], in a session of its own."""
    found = {}
    with replay_of(drive) as (address, _):
        for name in PAGES:
            page = browser.new_page()
            page.goto(f"{address}/#/{name}")
            page.locator("h2").first.wait_for(timeout=LIMIT_MS)
            paint_ms = page.evaluate("performance.getEntriesByName('first-contentful-paint')[0].startTime")
            found[name] = round(paint_ms / 1000, 3)
            page.close()
    return found


def main() -> None:
    """Measure, and write the tables; parts that are not named keep their figures.

    Memory after an hour is measured with a recording of 65 minutes: it is made in half the time.
    """
    FOLDER.mkdir(parents=True, exist_ok=True)
    file = RESULTS / "replay.json"
    found: Row = json.loads(file.read_text()) if file.exists() else {}
    parts: dict[str, tuple[str, Callable[[Browser, Path], object]]] = {
        "opens": ("two-hours", opened),
        "paints": ("two-hours", painted),
        "scrubs": ("two-hours", scrubbed),
        **{f"memory-{name}": ("hour", partial(remembered, name=name)) for name in ("now", "charts", "map")},
    }
    if sys.argv[1:] == ["--smoke"]:
        with tempfile.TemporaryDirectory() as folder, chromium() as browser:
            print("opens", opened(browser, write(Path(folder) / "smoke.mcap", SMOKE_S)))
        return
    wanted = tuple(sys.argv[1:] or parts)
    for name in filter(lambda part: part.startswith(wanted), parts):
        recording, measure = parts[name]
        drive = write(FOLDER / f"{recording}.mcap", DRIVES[recording])
        if recording == "two-hours":
            found["size_mb"] = drive.stat().st_size / 1e6
        with chromium() as browser:  # each part with a browser that has shown nothing yet
            found[name] = measure(browser, drive)
        found.setdefault("load", {})[name] = round(os.getloadavg()[0], 1)
        print(name, found[name], flush=True)
        file.write_text(json.dumps(found, indent=1) + "\n")
        text = (
            HEAD.format(size_mb=found.get("size_mb", math.nan), cores=os.cpu_count()) + "\n".join(lines(found)) + "\n"
        )
        tables.publish(RESULTS / "replay.md", text)


def lines(found: Row) -> Iterator[str]:
    """Write the figures as Markdown."""
    yield "- Load: " + ", ".join(f"{value} ({name})" for name, value in found["load"].items()) + "."
    for row in found.get("opens", ()):
        known = "with" if row["summary_known"] else "without"
        yield (
            f"- Opens {known} a summary beside it: address after {row['address_s']:.1f} s, bar with recorded time "
            f"{row['page_s']:.1f} s later ({row['processor_s']:.1f} s of processor time by then, without the browser); "
            f"events after {row['events_s']:.1f} s."
        )
    if "paints" in found:
        yield ("- First contentful paint: " + ", ".join(f"{k} {v:.2f} s" for k, v in found["paints"].items()) + ".")
    if row := found.get("scrubs"):
        yield (
            f"- Scrubber dragged over {row['positions']} positions, {row['hz']:.1f} a second: {row['shown']} shown, "
            f"median {row['median_ms']:.0f} ms, 95 % within {row['p95_ms']:.0f} ms, largest {row['largest_ms']:.0f} ms."
        )
    if rows := [row for name, row in found.items() if name.startswith("memory-")]:
        yield (
            f"\nAn hour at {SPEED:.0f} times its speed, each frame {SPEED:.0f} times ({FRAME_HZ} a second); the page "
            f"map takes each frame of the hour once, then at least {REPEATED_FRAMES} repeated ones. "
            "Private memory is that of the page's process, after a collection of the page's heap:\n"
        )
        yield "| page | recording | frames | heap before, MB | heap after | private before | after the hour | at end |"
        yield "| --- | --- | --- | --- | --- | --- | --- | --- |"
        for row in rows:
            yield (
                f"| {row['page']} | {row.get('recording', 'two-hours')} | {row['frames']} "
                f"| {row['heap_before_mb']} | {row['heap_after_mb']} "
                f"| {row['process_before_mb']} | {row.get('process_hour_mb', '-')} | {row['process_after_mb']} |"
            )
        for row in rows:
            if "repeated" in row:
                growth_mb = (row["collected_after_mb"] - row["collected_hour_mb"]) / row["repeated"] * 1000
                yield (
                    f"\nPage {row['page']}, after a collection of its worker's heap too: "
                    f"{row['collected_hour_mb']} MB after the hour, {row['collected_after_mb']} MB at the end, "
                    f"{growth_mb:+.1f} MB per 1,000 frames over {row['repeated']} repeated frames."
                )


if __name__ == "__main__":
    main()
