"""Failures of parts of a unit: what `monitoring.health` reports, `monitoring.status` shows, and what continues.

A unit runs as `make demo` starts it, under its supervisor. Every failure is one outage with one root cause, and nothing
else is accused. Failures of the broker, and the end of a unit, are tested with each broker.
"""

import math
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from services.core.fusion.start.warm_start import MAX_GAP_S
from services.monitoring.health.watch import RETURN_NS, SETTLE_NS
from shared.bus.bus import Bus
from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.messages.navigation import NavigationSolution, NavigationState, TruthState
from shared.runtime.config import BrokerAddress
from shared.topics import TOPICS
from tests.integration.test_demo import KINDS, Demo, start_demo
from tests.support.bus import intruder
from tests.support.patience import HANGS_S

pytestmark = [pytest.mark.whole_unit, pytest.mark.broker]

BROKER_PROCESS = {"mosquitto": "mosquitto.conf", "simulated": "broker.simulated"}
Outage = dict[str, Any]


@dataclass
class Unit:
    """A unit on one kind of broker, with all that its API has shown since the last failure."""

    kind: str
    demo: Demo
    before: set[tuple[str, int]] = field(default_factory=set)  # outages before the last failure
    sentences: set[str] = field(default_factory=set)
    problems: set[str] = field(default_factory=set)
    causes: set[str] = field(default_factory=set)
    states: dict[str, float] = field(default_factory=dict)  # of the banner, with the time until it was first shown [s]
    failed_s: float = 0.0

    def poll(self) -> dict[str, object]:
        """Request the state once, and store it."""
        health = self.demo.get("/api/health")
        if health:
            position = health["position"]
            assert isinstance(position, dict)
            self.sentences.add(str(position["sentence"]))
            self.states.setdefault(str(position["state"]), time.monotonic() - self.failed_s)
            new = [p for p in listed(health["problems"]) if (p["what"], p["since_ns"]) not in self.before]
            self.problems |= {problem["text"] for problem in new}
            self.causes |= {problem["what"] for problem in new}
        return health

    def fail(self, mark: str, number: signal.Signals) -> psutil.Process:
        """Send a signal to one of the unit's processes, and discard what was shown before."""
        [child] = self.fail_together([mark], number)
        return child

    def fail_together(self, marks: Sequence[str], number: signal.Signals) -> list[psutil.Process]:
        """Send a signal to several processes at once."""
        children = [self.demo.child(mark) for mark in marks]
        self.sentences, self.problems, self.causes, self.states = set(), set(), set(), {}
        self.before |= {(outage["what"], outage["since_ns"]) for outage in self.outages()}
        self.failed_s = time.monotonic()
        for child in children:
            child.send_signal(number)
        return children

    @contextmanager
    def suspend(self, mark: str) -> Iterator[None]:
        """Suspend one of the unit's processes for the length of a block."""
        child = self.fail(mark, signal.SIGSTOP)
        try:
            yield
        finally:
            resume(child)

    def until(self, condition: Callable[[dict[str, object]], bool], what: str) -> None:
        """Poll the API five times a second until a condition holds."""
        deadline = time.monotonic() + HANGS_S
        while not condition(self.poll()):
            late = time.monotonic() > deadline
            assert not late, f"{self.kind}: not within {HANGS_S} s: {what}; {self.problems} {self.outages()}"
            time.sleep(0.2)

    def timeline(self) -> set[str]:
        """List the states in the timeline since the last failure."""
        changes = self.demo.get("/api/trust")["history"]["changes"]  # type: ignore[index]
        elapsed_ns = (time.monotonic() - self.failed_s) * 1e9
        return {change["state"] for change in changes if change["since_ns"] > time.time_ns() - elapsed_ns}

    def until_well(self) -> None:
        """Wait until everything is ready and no outage is open."""

        def over(health: dict[str, object]) -> bool:
            return is_well(health) and all(outage["until_ns"] is not None for outage in self.outages())

        self.until(over, "everything is ready again")

    def outages(self) -> list[Outage]:
        """List the outages since the last failure, open ones as well."""
        return [outage for outage in self.every_outage() if (outage["what"], outage["since_ns"]) not in self.before]

    def every_outage(self) -> list[Outage]:
        while not (found := self.demo.get("/api/outages")):
            time.sleep(0.1)
        return [*listed(found["open"]), *listed(found["closed"])]

    def until_settled(self, what: str) -> None:
        """Wait until another failure of something is another outage; the time runs from when the end was noticed."""
        ends_ns = [
            outage["until_ns"] + SETTLE_NS + RETURN_NS for outage in self.every_outage() if outage["what"] == what
        ]
        time.sleep(max([0.0, *((end_ns - time.time_ns()) * 1e-9 for end_ns in ends_ns)]))

    def assert_one_outage(self, what: str, cause: str, *affected: str) -> None:
        """Assert that the failure is one outage, over by now, and that no other root cause was ever shown."""
        self.until(lambda _: bool(self.outages()), f"the outage is listed among {self.every_outage()}")
        outages = self.outages()
        assert [(outage["what"], outage["cause"]) for outage in outages] == [(what, cause)], self.kind
        [outage] = outages
        assert outage["until_ns"] is not None
        assert set(affected) <= {str(topic) for topic in listed(outage["affected"])}
        assert self.causes <= {what}, f"{self.kind}: {self.problems}"


def resume(child: psutil.Process) -> None:
    """Let a stopped process continue, unless its supervisor has killed it as one that hangs."""
    with suppress(psutil.NoSuchProcess):
        child.send_signal(signal.SIGCONT)


def listed(found: object) -> list[Outage]:
    assert isinstance(found, list)
    return found


def is_well(health: dict[str, object]) -> bool:
    processes = health.get("processes")
    ready = isinstance(processes, dict) and all(entry["status"] == "ready" for entry in processes.values())
    return ready and health["state"] == "ok"


@pytest.fixture(scope="module")
def unit(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Unit]:
    kind: str = request.param
    made = Unit(kind, start_demo(tmp_path_factory.mktemp(kind), "--broker", kind))
    try:
        made.until(is_well, "the unit navigates")
        yield made
    finally:
        made.demo.process.terminate()
        made.demo.process.communicate(timeout=HANGS_S)


on_mosquitto = pytest.mark.parametrize("unit", KINDS[:1], indirect=True, scope="module")
on_each_broker = pytest.mark.parametrize(
    "unit", [KINDS[0], pytest.param(KINDS[1], marks=pytest.mark.slow)], indirect=True, scope="module"
)


INVALID = (b"garbage", b"{}", b'{"sampled_ns":1e400}', b"[1,2", b"\xff" * 5000)
SPEAKERS = {
    "gnss/fix": "parsers.gnss", "imu/sample": "parsers.imu", "navigation/last_position": "controller.mode",
    "gnss/raw": "sensors.simulator", "imu/raw": "sensors.simulator", "can/raw": "sensors.simulator",
    "truth/state": "sensors.simulator", "health/core.fusion": "core.fusion",
}  # fmt: skip


def broker_port(demo: Demo) -> int:
    return int((demo.folder / "credentials" / "address").read_text().split()[0].rpartition(":")[2])


@on_mosquitto
def test_invalid_payloads_on_the_bus_are_counted_and_end_no_process(unit: Unit) -> None:
    demo = unit.demo
    children = {child.pid for child in psutil.Process(demo.process.pid).children()}
    port = broker_port(demo)
    intruder.let_in(demo.folder / "rules", demo.child(BROKER_PROCESS[unit.kind]), port)
    for name, speaker in SPEAKERS.items():
        sender = b'{"sender":{"process":"%s","incarnation":1,"sequence":1},' % speaker.encode()
        with intruder.client(port) as client:
            client.connect()
            for payload in INVALID:
                client.publish(f"obu/demo/{name}", payload)
                client.publish(f"obu/demo/{name}", sender + payload[1:])
    time.sleep(2.0)
    demo.wait(demo.all_ready, "every process is ready")
    assert {child.pid for child in psutil.Process(demo.process.pid).children()} == children
    assert demo.process.poll() is None


@on_mosquitto
def test_a_killed_filter_publishes_again_within_two_seconds_and_is_the_cause_until_then(
    unit: Unit, tmp_path: Path
) -> None:
    for attempt in range(3):
        if kill_and_compare(unit.demo, lambda: unit.fail("run core.fusion", signal.SIGKILL), tmp_path / str(attempt)):
            break
        unit.until_well()
    else:
        pytest.fail("three times no process was started anew within the longest gap of a warm start")
    lost = "core.fusion was lost: it crashed, was killed or lost its connection"
    unit.until(lambda _: bool(unit.outages()), "the loss is an outage")
    unit.until_well()
    unit.assert_one_outage("core.fusion", lost, "navigation/solution", "navigation/state")
    again = {text for text in unit.problems if text.startswith("core.fusion was restarted and is starting again")}
    assert unit.problems <= {lost, *again}, "a warm start may be over before the second text is polled"


def kill_and_compare(demo: Demo, kill: Callable[[], psutil.Process], folder: Path) -> bool:
    """Kill the filter: within two seconds solutions continue from the retained state with a consistent covariance.

    False on a machine that is so busy that the start takes longer than a warm start allows: nothing is compared then.
    """
    folder.mkdir()
    bus = Bus("observer", "demo", BrokerAddress(port=broker_port(demo)),
              [t for t in TOPICS if t.name in ("navigation/solution", "navigation/state", "truth/state")],
              demo.folder, observer=True)  # fmt: skip
    solutions: dict[int, list[tuple[float, NavigationSolution]]] = {}  # by the incarnation of their producer
    truth: dict[int, TruthState] = {}
    reasons: list[str] = []

    def listen(until: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + HANGS_S
        while not until():
            assert time.monotonic() < end, f"not within {HANGS_S} s: {what}"
            for envelope in bus.receive(0.05):
                message = envelope.decode()
                if isinstance(message, TruthState):
                    truth[message.sampled_ns] = message
                elif isinstance(message, NavigationSolution):
                    solutions.setdefault(envelope.incarnation, []).append((time.time(), message))
                elif isinstance(message, NavigationState):
                    reasons.append(message.reason)

    listen(lambda: len(next(iter(solutions.values()), ())) > 30, "the filter has aligned")
    lives = set(solutions)
    kill()
    listen(lambda: set(solutions) > lives, "there is a solution again")
    started_s = demo.child("run core.fusion").create_time()
    (after,) = [solutions[life] for life in solutions if life not in lives]
    listen(lambda: len(after) > 30, "solutions go on")
    bus.close()
    gap_s = (after[0][1].sampled_ns - max(s.sampled_ns for life in lives for _, s in solutions[life])) * 1e-9
    if gap_s > MAX_GAP_S:
        return False
    assert after[0][0] - started_s < 2.0 * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1)), "2 s of a free machine"
    assert any(reason.startswith("warm start") for reason in reasons), reasons
    known = [solution for _, solution in after if min(truth) <= solution.sampled_ns <= max(truth)]
    assert len(known) > 20
    for solution in known:
        north_m, east_m, down_m = error_ned_m(solution, truth)
        nn, _, _, ee, _, dd = solution.position_cov_ned_m2
        assert math.hypot(north_m, east_m) < 3.0 * math.sqrt(nn + ee)
        assert abs(down_m) < 3.5 * math.sqrt(dd)
        assert math.hypot(north_m, east_m) < (solution.protection_level_horizontal_m or 0.0)
    return True


def error_ned_m(solution: NavigationSolution, truth: dict[int, TruthState]) -> tuple[float, float, float]:
    """Estimated position minus the true one [m, NED], which is interpolated between its stamps."""
    stamps = sorted(truth)
    rows = [(truth[t].latitude_deg, truth[t].longitude_deg, truth[t].height_ellipsoid_m) for t in stamps]
    times_s = [(t - solution.sampled_ns) * 1e-9 for t in stamps]
    latitude, longitude, height = (float(np.interp(0.0, times_s, column)) for column in zip(*rows, strict=True))
    there = Geodetic(math.radians(latitude), math.radians(longitude), height)
    here = Geodetic(
        math.radians(solution.latitude_deg), math.radians(solution.longitude_deg), solution.height_ellipsoid_m
    )
    return ned_from_geodetic_difference(here, there)


@on_each_broker
def test_a_killed_broker_is_one_outage(unit: Unit) -> None:
    unit.fail(BROKER_PROCESS[unit.kind], signal.SIGKILL)
    unit.until(lambda _: "broker" in unit.causes, "the loss is shown")
    unit.until_well()
    unit.assert_one_outage("broker", "the broker is not reachable", "imu/raw", "navigation/solution")


@on_mosquitto
def test_a_killed_parser_is_the_cause_of_its_topics_and_of_what_depends_on_them(unit: Unit) -> None:
    unit.fail("run parsers.imu", signal.SIGKILL)
    unit.until(lambda _: "parsers.imu" in unit.causes, "the loss is shown")
    unit.until_well()
    unit.assert_one_outage(
        "parsers.imu", "parsers.imu was lost: it crashed, was killed or lost its connection", "imu/sample"
    )


@on_mosquitto
def test_a_simulator_that_hangs_is_the_cause_of_everything_downstream(unit: Unit) -> None:
    cause = "sensors.simulator is stale: connected, but without heartbeat; it hangs or is overloaded"
    with unit.suspend("run sensors.simulator"):
        unit.until(
            lambda _: "No position: sensors.simulator does not answer." in unit.sentences,
            "the banner names the cause",
        )
    unit.until_well()
    unit.assert_one_outage("sensors.simulator", cause, "imu/raw", "imu/sample", "navigation/solution")


@on_mosquitto
@pytest.mark.parametrize(
    ("mark", "what", "cause"),
    [
        (
            "run parsers.can",
            "parsers.can",
            "parsers.can is stale: connected, but without heartbeat; it hangs or is overloaded",
        ),
        (BROKER_PROCESS["mosquitto"], "broker", "the broker hangs: it is connected, but delivers nothing"),
    ],
    ids=["process", "broker"],
)
def test_what_stays_stopped_is_killed_and_runs_again(unit: Unit, mark: str, what: str, cause: str) -> None:
    unit.until_settled(what)
    stopped = unit.fail(mark, signal.SIGSTOP)
    unit.demo.wait(lambda: not stopped.is_running(), "the supervisor has killed it")
    unit.demo.wait(lambda: runs_again(unit.demo, mark, stopped.pid), "and started it again")
    unit.until_well()
    unit.assert_one_outage(what, cause)


def runs_again(demo: Demo, mark: str, before: int) -> bool:
    """Whether another process of a command line runs."""
    try:
        return demo.child(mark).pid != before
    except (AssertionError, psutil.Error):
        return False


@on_each_broker
def test_a_hung_broker_is_one_outage(unit: Unit) -> None:
    hangs = "the broker hangs: it is connected, but delivers nothing"
    unit.until_settled("broker")
    with unit.suspend(BROKER_PROCESS[unit.kind]):
        stopped = time.monotonic()
        unit.until(
            lambda _: "Nothing is known: the broker delivers nothing." in unit.sentences, "the banner names the broker"
        )
        health = unit.poll()
        assert (health["state"], health["topics"]) == ("failed", {})
        assert unit.states["broker_lost"] >= 1.9, "two seconds without the own heartbeat"
        assert {entry["status"] for entry in health["processes"].values()} == {"unknown"}  # type: ignore[attr-defined]
        time.sleep(max(0.0, stopped + 8.0 - time.monotonic()))
    unit.until_well()
    unit.assert_one_outage("broker", hangs, "imu/raw")
    assert "broker_lost" in unit.timeline()
    [outage] = unit.outages()
    assert outage["until_ns"] - outage["since_ns"] > 7 * 10**9


TOGETHER = (
    "controller.mode", "core.motion_conflict", "core.spoofing", "core.cooperative", "core.evidence", "core.trust",
    "monitoring.recorder", "parsers.can", "parsers.gnss",
)  # fmt: skip
NO_VERDICT = {"starting", "stale"}


@on_mosquitto
def test_processes_that_are_killed_together_are_an_outage_each_and_no_verdict_is_shown_without_core_trust(
    unit: Unit, record_property: Callable[[str, object], None]
) -> None:
    unit.fail_together([f"run {name}" for name in TOGETHER], signal.SIGKILL)
    unit.until(lambda _: {o["what"] for o in unit.outages()} >= set(TOGETHER), "every loss is an outage")
    unit.until(lambda _: bool(NO_VERDICT & unit.states.keys()), "the verdict of before is withdrawn")
    unit.until_well()
    for outage in unit.outages():
        if outage["what"] in TOGETHER:
            assert outage["cause"] == f"{outage['what']} was lost: it crashed, was killed or lost its connection"
    assert NO_VERDICT & unit.timeline()
    record_property(f"{unit.kind}: banner after killing nine processes, s", unit.states)


@on_mosquitto
def test_processes_that_hang_together_are_shown_in_their_rows(
    unit: Unit, record_property: Callable[[str, object], None]
) -> None:
    children = unit.fail_together([f"run {name}" for name in TOGETHER], signal.SIGSTOP)
    seen: set[str] = set()

    def each_was_shown(_: object) -> bool:
        seen.update(hung(unit.demo.statuses()))  # each until the supervisor has killed it, 14 s after it stopped
        return set(TOGETHER) <= seen

    try:
        unit.until(each_was_shown, f"every row of {TOGETHER} says stale or lost")
        rows_s = time.monotonic() - unit.failed_s
        unit.until(lambda _: "stale" in unit.states, "no verdict is shown after the deadline of trust/state")
    finally:
        for child in children:
            resume(child)
    assert unit.states["stale"] >= 3.9, "five seconds from the last verdict, which is at most a second old"
    unit.until_well()
    assert "stale" in unit.timeline()
    record_property(f"{unit.kind}: rows after {rows_s:.1f} s; banner after hanging nine processes, s", unit.states)


def hung(statuses: dict[str, str]) -> set[str]:
    """List who is stale, or lost: Mosquitto ends a connection 7.5 to 12.5 s after its last packet."""
    return {name for name, status in statuses.items() if status in ("stale", "lost")}


@on_mosquitto
def test_a_killed_watchdog_ends_the_outage_that_it_interrupted(unit: Unit) -> None:
    unit.until_settled("parsers.can")
    with unit.suspend("run parsers.can"):
        unit.until(lambda _: "parsers.can" in unit.causes, "the suspended parser is shown")
        [before] = unit.outages()
        unit.demo.child("run monitoring.health").kill()
    unit.until(lambda _: len(unit.outages()) == 2, "the interruption is listed")
    unit.until_well()
    after = {outage["what"]: outage for outage in unit.outages()}
    assert set(after) == {"parsers.can", "monitoring.health"}
    assert after["monitoring.health"]["cause"] == ("monitoring.health was restarted; nothing was monitored in between")
    assert after["parsers.can"]["since_ns"] == before["since_ns"]
    assert all(outage["until_ns"] is not None for outage in after.values())


@on_mosquitto
def test_a_hung_watchdog_leaves_the_rest_unknown_and_the_position_shown(unit: Unit) -> None:
    text = "monitoring.health does not report, so the state of processes and topics is unknown"
    with unit.suspend("run monitoring.health"):
        unit.until(lambda _: text in unit.problems, "the page shows that the watchdog is silent")
        state = unit.poll()["position"]["state"]  # type: ignore[index]
        assert state not in ("starting", "stale", "broker_lost"), "the verdict of core.trust is shown as before"
    unit.until_well()
    assert unit.causes == {"monitoring.health"}


@on_each_broker
def test_sigterm_ends_all_processes(unit: Unit) -> None:
    """The last test of a unit: it ends it."""
    demo = unit.demo
    children = psutil.Process(demo.process.pid).children(recursive=True)
    demo.process.terminate()
    output, errors = demo.process.communicate(timeout=HANGS_S)
    assert "Traceback" not in output + errors
    assert not [child for child in children if child.is_running() and child.status() != psutil.STATUS_ZOMBIE]
    for log in (demo.folder / "logs").glob("*.log"):
        assert "Traceback" not in log.read_text(), log.name
