"""The state as Prometheus metrics, made at each scrape."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from shared.messages.gnss import FixType, GnssFix
from shared.messages.navigation import NavigationSolution
from shared.messages.operation import RecordingState
from shared.messages.trust import Outcome, TrustState

from ..state import State
from .banner import MONITORS_MAXIMUM, Trust, ratio_of
from .geometry import ellipse_95
from .snapshot import RUNNING

# As NMEA and gpsd count: 1 no fix, 2 two dimensions, 3 three.
FIX_MODES = {FixType.TWO_D: 2, FixType.THREE_D: 3, FixType.GNSS_DEAD_RECKONING: 3}


class StateCollector(Collector):
    """Turns the state into metric families; what is not live is left out rather than repeated."""

    def __init__(self, state: State, now_ns: Callable[[], int], lock: AbstractContextManager[object], version: str):
        self._state, self._now_ns, self._lock, self._version = state, now_ns, lock, version

    def collect(self) -> Iterator[Metric]:
        """Give all families, read at one moment."""
        with self._lock:
            now_ns = self._now_ns()
            families = [
                InfoMetricFamily("obu_build", "Version of the software.", {"version": self._version}),
                *_position(self._state, now_ns),
                *_trust(self._state, now_ns),
                *_traffic(self._state, now_ns),
                *_recording(self._state, now_ns),
                *_series(self._state),
            ]
        yield from families


def registry_of(collector: Collector) -> CollectorRegistry:
    """Make a registry of our own, with nothing in it but this."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(collector)
    return registry


def text(registry: CollectorRegistry) -> bytes:
    """Print a registry in the text format 0.0.4."""
    return generate_latest(registry)


def _position(state: State, now_ns: int) -> Iterator[Metric]:
    if fix := state.newest(GnssFix, "gnss/fix", now_ns, live=True):
        mode = FIX_MODES.get(fix.fix_type, 1)
        yield GaugeMetricFamily("obu_gnss_fix_mode", "1 no fix, 2 two dimensions, 3 three dimensions.", mode)
        if fix.satellites_used is not None:
            yield GaugeMetricFamily("obu_gnss_satellites_used", "Satellites in the fix.", fix.satellites_used)
        if fix.utc_ns is not None:
            offset_s = (fix.sampled_ns - fix.utc_ns) * 1e-9
            yield GaugeMetricFamily("obu_clock_offset_seconds", "Time line of the unit minus UTC by GNSS.", offset_s)
    if solution := state.newest(NavigationSolution, "navigation/solution", now_ns, live=True):
        semi_major_m = ellipse_95(solution.position_cov_ned_m2).semi_major_m
        yield GaugeMetricFamily(
            "obu_position_error_ellipse_95_meters", "Major semi-axis of the 95 % error ellipse.", semi_major_m
        )
        for name, axis, level_m in (
            ("hpl", "Horizontal", solution.protection_level_horizontal_m),
            ("vpl", "Vertical", solution.protection_level_vertical_m),
        ):
            if level_m is not None:
                yield GaugeMetricFamily(f"obu_position_{name}_meters", f"{axis} protection level.", level_m)
        if solution.integrity_risk is not None:
            help_text = "Probability with which the error is beyond a protection level."
            yield GaugeMetricFamily("obu_position_integrity_risk", help_text, solution.integrity_risk)


def _trust(state: State, now_ns: int) -> Iterator[Metric]:
    verdict = GaugeMetricFamily("obu_integrity_state", "1 for the state that holds.", labels=["state"])
    for trust in Trust:
        verdict.add_metric([trust], 1.0 if state.verdict.state is trust else 0.0)
    yield verdict
    statistic = GaugeMetricFamily(
        "obu_monitor_statistic", "Newest statistic over its limit; above 1 it alarms.", labels=["monitor"]
    )
    alarms = CounterMetricFamily("obu_monitor_alarms", "Alarms of a monitor.", labels=["monitor"])
    for kind, (update, _) in state.aiding.items():
        statistic.add_metric([f"innovation_{kind}"], update.test_ratio)
        alarms.add_metric([f"innovation_{kind}"], state.rejections.get(kind, 0))
    outcomes = GaugeMetricFamily(
        "obu_monitor_outcome", "1 for the outcome that holds of an integrity monitor.", labels=["monitor", "outcome"]
    )
    newest = state.newest(TrustState, "trust/state", now_ns, live=True)
    for m in newest.monitors[:MONITORS_MAXIMUM] if newest else ():
        if (ratio := ratio_of(m.outcome, m.statistic, m.threshold)) is not None:
            statistic.add_metric([m.monitor], ratio)
        for outcome in Outcome:
            outcomes.add_metric([m.monitor, outcome], 1.0 if m.outcome is outcome else 0.0)
    probability = GaugeMetricFamily(
        "obu_hypothesis_probability", "Probability that this is what is wrong.", labels=["hypothesis"]
    )
    survives = GaugeMetricFamily(
        "obu_hypothesis_survives", "1 while the protection level reaches to its solution.", labels=["hypothesis"]
    )
    for belief in newest.beliefs if newest else ():
        probability.add_metric([belief.hypothesis], belief.probability)
        survives.add_metric([belief.hypothesis], 1.0 if belief.survives else 0.0)
    yield from (statistic, alarms, outcomes, probability, survives)


def _traffic(state: State, now_ns: int) -> Iterator[Metric]:
    age = GaugeMetricFamily("obu_topic_age_seconds", "Age of the newest message.", labels=["topic"])
    count = CounterMetricFamily("obu_topic_messages", "Messages seen.", labels=["topic"])
    for name, flow in state.topics.items():
        if (age_s := flow.age_s(now_ns)) is not None:
            age.add_metric([name], age_s)
            count.add_metric([name], flow.count)
    up = GaugeMetricFamily("obu_process_up", "1 while its heartbeat is in time.", labels=["process"])
    restarts = CounterMetricFamily("obu_process_restarts", "Restarts seen.", labels=["process"])
    rejects = CounterMetricFamily("obu_parser_rejects", "Discarded input.", labels=["proto", "reason"])
    for name, process in state.processes.items():
        if process.health is None:
            continue
        up.add_metric([name], 1.0 if state.judgement.statuses[name] in RUNNING else 0.0)
        restarts.add_metric([name], state.judgement.restarts.get(name, 0))
        for reason, number in process.health.rejects.items():
            rejects.add_metric([name, reason], number)
    yield from (age, count, up, restarts, rejects)


def _recording(state: State, now_ns: int) -> Iterator[Metric]:
    if recording := state.newest(RecordingState, "recording/state", now_ns, live=True):
        yield CounterMetricFamily("obu_recorder_bytes", "Bytes recorded.", recording.bytes_written)
        yield GaugeMetricFamily("obu_disk_free_bytes", "Free room where recordings go.", recording.free_bytes)


def _series(state: State) -> Iterator[Metric]:
    yield GaugeMetricFamily("obu_series_fields", "Fields whose last hour is kept.", len(state.series))
    yield CounterMetricFamily("obu_series_refused", "Fields that could not be kept.", state.series.refused)
