"""A running demo with the page open: each process, and the broker, is killed, stopped or hung."""

import os
import re
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page

from shared.processes import Role, running
from tests.integration.test_demo import Demo, start_demo
from tests.support.patience import HANGS_S

pytestmark = [pytest.mark.whole_unit, pytest.mark.broker, pytest.mark.slow]

TABLE = "OBU_FAILURES_TABLE"  # environment variable: the file to which the results are written as a table
BROKER, PAGE, WATCHDOG = "broker", "monitoring.status", "monitoring.health"
PROCESSES = (BROKER, *sorted(row.name for row in running(Role.OBU, ["sensors.simulator"])))
SIGNALS = {"killed": signal.SIGKILL, "stopped": signal.SIGTERM, "hung": signal.SIGSTOP}
CAUSES = {
    "killed": "was lost: it crashed, was killed or lost its connection",
    "stopped": "has ended: it was stopped on request",
    "hung": "is stale: connected, but without heartbeat; it hangs or is overloaded",
}
UNREACHABLE = "the broker is not reachable"
BROKER_CAUSES = {
    "killed": UNREACHABLE, "stopped": UNREACHABLE, "hung": "the broker hangs: it is connected, but delivers nothing",
}  # fmt: skip
WATCHDOG_CAUSES = {
    "killed": "monitoring.health was restarted; nothing was monitored in between",
    "stopped": "monitoring.health was restarted; nothing was monitored in between",
    "hung": "monitoring.health does not report",
}
EVERY = [(name, failure) for name in PROCESSES for failure in SIGNALS]
NEEDED = {"sensors.simulator", "parsers.imu", "core.fusion", "core.trust", BROKER, PAGE}  # for a verdict that is shown
# Each of these fails once, in turn by each kind, and the filter by all three; every pair where the table is asked for.
CHOSEN = [
    pair
    for k, pair in enumerate(EVERY)
    if os.environ.get(TABLE) or pair[0] == "core.fusion" or (pair[0] in NEEDED and k % 3 == k // 3 % 3)
]
VOUCHED = ("SAFE", "CAUTION")  # words of the banner of a unit that works
BRIEF_S = 5.0  # the deadline of trust/state: a verdict holds over a shorter interruption
HUNG_S = 9.0  # the longest deadline is 5 s, that of trust/state
UNWRITTEN_S = 2  # seconds of a chart that were not in the recording yet when its process was killed
NOT_READY = ("lost", "ended", "stale", "late", "restarting", "waiting", "missing", "not known")
LOOK = """(node) => ({
  word: document.querySelector('.banner .word')?.innerText ?? '',
  row: document.getElementById(`node-${node}`)?.innerText ?? '',
  foot: document.querySelector('.foot')?.innerText ?? '',
  outages: [...document.querySelectorAll('section[aria-labelledby=outages] li')].map((li) => ({
    what: li.querySelector('strong')?.innerText ?? '', text: li.innerText, open: li.classList.contains('open') })),
})"""
TIMELINE = "() => [...document.querySelectorAll('.band .segment')].map((s) => s.title)"


@dataclass
class PageReaction:
    """What the page showed after one failure, with the time until it did [s]."""

    banner: dict[str, float] = field(default_factory=dict)  # words other than those of `VOUCHED`
    row: dict[str, float] = field(default_factory=dict)
    outage: dict[str, float] = field(default_factory=dict)  # causes of its new outages
    continued: bool = False  # an outage of before is open again: topics fell silent soon after its end
    timeline: list[str] = field(default_factory=list)  # states from the one before the failure on
    recovered_s: float = 0.0  # when something did not work for the last time


class WatchedSystemPage:
    """The page System of a unit in which one process fails."""

    def __init__(self, page: Page, process: str) -> None:
        self._page, self._process = page, process
        self._begins = {begin_of(outage) for outage in self._look()["outages"]}
        self._started_s = time.monotonic()
        self.seen = PageReaction()

    def _look(self) -> dict[str, Any]:
        found: dict[str, Any] = self._page.evaluate(LOOK, self._process)
        return found

    def look(self) -> bool:
        """Note what is new; return whether everything works."""
        found, seen, elapsed_s = self._look(), self.seen, time.monotonic() - self._started_s
        if found["word"] not in VOUCHED:
            seen.banner.setdefault(found["word"], elapsed_s)
        status = [word for word in NOT_READY if re.search(rf"\b{word}\b", found["row"])]
        for word in status:
            seen.row.setdefault(word, elapsed_s)
        for outage in found["outages"]:
            if outage["what"] != self._process:
                continue
            if begin_of(outage) not in self._begins:
                seen.outage.setdefault(outage["text"].split(" · ")[1], elapsed_s)
            seen.continued |= outage["open"] and begin_of(outage) in self._begins
        if self._process == WATCHDOG and (silent := WATCHDOG_CAUSES["hung"]) in found["foot"]:
            seen.outage.setdefault(silent, elapsed_s)  # a problem in the footer: nothing else could publish an outage
        ready = (bool(found["row"]) and not status) or self._process == BROKER
        works = ready and found["word"] in VOUCHED and not any(outage["open"] for outage in found["outages"])
        if not works:
            seen.recovered_s = elapsed_s
        return works

    def is_shown(self) -> bool:
        """Whether there is an outage, or the page says that it is cut off."""
        self.look()
        return bool(self.seen.outage) or self.seen.continued or "NO CONNECTION" in self.seen.banner

    def is_over(self) -> bool:
        """Whether everything works, longer after the failure than the longest deadline."""
        return self.look() and time.monotonic() - self._started_s > BRIEF_S

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Look ten times a second until something is shown."""
        end_s = time.monotonic() + HANGS_S
        while not condition():
            assert time.monotonic() < end_s, f"not within {HANGS_S} s: {what}; {self.seen} {self._look()}"
            self._page.wait_for_timeout(100)

    def for_s(self, seconds: float) -> None:
        """Look until so long after the failure."""
        while time.monotonic() - self._started_s < seconds:
            self.look()
            self._page.wait_for_timeout(100)
        self.look()

    def recover(self) -> None:
        """Look until everything has worked for two seconds."""
        since_s = time.monotonic() - self._started_s

        def settled() -> bool:
            works = self.look()
            elapsed_s = time.monotonic() - self._started_s
            return works and elapsed_s - max(since_s, self.seen.recovered_s) > 2.0

        self.until(settled, "everything works")


def begin_of(outage: dict[str, Any]) -> str:
    """Time of day at which a listed outage began."""
    found = re.search(r"\d\d:\d\d:\d\d", outage["text"])
    return found[0] if found else ""


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Demo]:
    started = start_demo(tmp_path_factory.mktemp("failures"), "--broker", "mosquitto")
    started.wait(started.all_ready, "every process is ready")
    yield started
    started.process.terminate()
    started.process.communicate(timeout=HANGS_S)


@pytest.fixture(scope="module")
def pages(demo: Demo, browser: Browser) -> Iterator[tuple[Page, Page]]:
    """The page System, and the page Trust with the timeline."""
    opened = [browser.new_page(viewport={"width": 1440, "height": 900}) for _ in range(2)]
    for page, name in zip(opened, ("system", "trust"), strict=True):
        page.goto(f"http://127.0.0.1:{demo.port}/#/{name}")
    opened[0].wait_for_selector(".banner .word:text('SAFE')", timeout=1000 * HANGS_S)
    yield opened[0], opened[1]
    for page in opened:
        page.close()


@pytest.fixture(scope="module")
def results() -> Iterator[dict[tuple[str, str], PageReaction]]:
    """What was seen of each process and failure, written as a table if a file is named."""
    found: dict[tuple[str, str], PageReaction] = {}
    yield found
    if path := os.environ.get(TABLE):
        Path(path).write_text(as_table(found))


@pytest.mark.parametrize(("name", "failure"), CHOSEN)
def test_a_failure_is_shown_by_banner_row_outage_and_timeline(
    name: str, failure: str, demo: Demo, pages: tuple[Page, Page], results: dict[tuple[str, str], PageReaction]
) -> None:
    system, trust = pages
    before = len(trust.evaluate(TIMELINE))
    child = demo.child("mosquitto.conf" if name == BROKER else f"run {name}")
    WatchedSystemPage(system, name).recover()  # from the failure before
    watched = WatchedSystemPage(system, name)
    seen = results[name, failure] = watched.seen
    child.send_signal(SIGNALS[failure])
    try:
        if failure == "hung":
            watched.for_s(HUNG_S)
            assert seen.outage or seen.row or seen.banner, "nothing was shown while it hung"
    finally:
        if failure == "hung":
            child.send_signal(signal.SIGCONT)
    # A process that was stopped on request and is back within its deadline is no outage.
    restarted = watched.is_over if failure == "stopped" else bool
    watched.until(lambda: watched.is_shown() or restarted(), "the failure")
    watched.for_s(3.0)
    watched.recover()
    trust.wait_for_timeout(400)
    seen.timeline = trust.evaluate(TIMELINE)[max(0, before - 1) :]

    brief = seen.recovered_s < BRIEF_S
    assert seen.banner or brief or name not in NEEDED, "the banner must not vouch for a position without this process"
    if name == PAGE:
        assert "NO CONNECTION" in seen.banner
        return
    own = {kind: f"{name} {text}" for kind, text in CAUSES.items()}
    cause = {BROKER: BROKER_CAUSES, WATCHDOG: WATCHDOG_CAUSES}.get(name, own)[failure]
    shown = seen.continued or any(text.startswith(cause) for text in seen.outage)
    assert shown or (failure == "stopped" and brief), seen
    if name not in NEEDED:
        assert not {"UNSAFE", "BROKER LOST", "NO CONNECTION"} & set(seen.banner), seen


def test_after_a_kill_of_the_page_s_process_everything_of_before_is_still_there(demo: Demo) -> None:
    chart = "/api/series?fields=gnss/fix:hdop&seconds=300"
    demo.child("run parsers.can").kill()
    demo.wait(lambda: bool(demo.get("/api/outages").get("closed")), "an outage is over")
    demo.wait(lambda: len(known(demo.get(chart))) > 20, "a chart has values")
    before: dict[str, Any] = {
        path: demo.get(path) for path in ("/api/gnss", "/api/gnss/tracks", "/api/outages", "/api/trust", chart)
    }
    killed = demo.child(f"run {PAGE}")
    killed.kill()
    killed.wait(HANGS_S)
    demo.wait(lambda: bool(demo.get("/api/gnss/tracks").get("gnss0")), "the page is served again")
    after: dict[str, Any] = {path: demo.get(path) for path in before}
    for old, new in pairs_of(before, after):
        assert old and new[: len(old)] == old
    events, events_after = (record["/api/trust"]["events"] for record in (before, after))  # listed newest first
    assert events_after[len(events_after) - len(events) :] == events
    demo.wait(
        lambda: len(lost_of(before[chart], demo.get(chart))) <= UNWRITTEN_S,
        "the chart is read from the recording",
    )


def pairs_of(before: dict[str, Any], after: dict[str, Any]) -> Iterator[tuple[list[Any], list[Any]]]:
    """Tracks in the sky, bands of the page GNSS, changes and events of the verdict, outages: before and after."""
    for name, track in before["/api/gnss/tracks"]["gnss0"].items():
        yield track, after["/api/gnss/tracks"]["gnss0"][name]
    bands = [record["/api/gnss"]["receivers"][0]["bands"] for record in (before, after)]
    yield from ((bands[0][name], bands[1][name]) for name in ("fix", "correction"))
    yield before["/api/trust"]["history"]["changes"], after["/api/trust"]["history"]["changes"]
    yield before["/api/outages"]["closed"][::-1], after["/api/outages"]["closed"][::-1]


def known(series: dict[str, Any]) -> set[int]:
    """Collect the times [ns] at which the chart has a value."""
    values = series.get("values", {}).get("gnss/fix:hdop", ())
    return {time_ns for time_ns, value in zip(series.get("time_ns", ()), values, strict=True) if value is not None}


def lost_of(before: dict[str, Any], after: dict[str, Any]) -> set[int]:
    """Find the times at which the chart had a value that it has not any more, of the span that it shows now."""
    oldest_ns = min(after.get("time_ns", ()), default=0)
    return {time_ns for time_ns in known(before) - known(after) if time_ns >= oldest_ns}


def as_table(results: dict[tuple[str, str], PageReaction]) -> str:
    """Write the results as a Markdown table."""

    def times(found: dict[str, float]) -> str:
        return ", ".join(f"{what} {seconds:.1f} s" for what, seconds in found.items()) or "-"

    lines = ["| process | failure | banner | row | outage | timeline | as before |", "|---|---|---|---|---|---|---|"]
    for (name, failure), seen in results.items():
        outage = "the one before continues" if seen.continued and not seen.outage else times(seen.outage)
        cells = times(seen.banner), times(seen.row), outage, " → ".join(seen.timeline)
        lines.append(f"| `{name}` | {failure} | {' | '.join(cells)} | {seen.recovered_s:.0f} s |")
    return "\n".join(lines) + "\n"
