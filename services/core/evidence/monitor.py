"""The tests of the monitor `evidence`: what a receiver says of itself, each with its threshold.

None of them proves anything: a receiver's flags depend on its firmware, and signal levels on the sky. Therefore an
accusation is evidence, which lowers the verdict to CAUTION at most.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees

import numpy as np

from shared.messages.gnss import GnssSatellites, GnssSignalQuality, InterferenceState, RadioPath, ReceiverClock
from shared.messages.operation import HostClock
from shared.messages.trust import MonitorTest, Outcome

from .baselines import NS, RECENT_S, ClockPrediction, SlowMean, TimeOffset
from .settings import Settings

SEVERITY = {InterferenceState.NONE: 0.0, InterferenceState.INDICATED: 1.0, InterferenceState.SEVERE: 2.0}
FLAG_LIMIT = 0.5
PERSISTENT = 2  # successive evaluations above the threshold, of what varies from epoch to epoch


@dataclass(frozen=True)
class Finding:
    """One evaluation of one test."""

    time_ns: int
    statistic: float
    threshold: float
    unit: str
    reason: str

    @property
    def above(self) -> bool:
        """Whether the statistic is above the threshold."""
        return self.statistic > self.threshold


class EvidenceTest:
    """Latest evaluation of one test, and whether it accuses."""

    def __init__(self, name: str, missing: str, *, count: int, latency_s: float, hold_s: float) -> None:
        self.suspect_since_ns: int | None = None  # last evaluation before the accusation that was below the threshold
        self._name, self._missing, self._count, self._hold_ns = name, missing, count, round(hold_s * NS)
        self._latency_ns = round(latency_s * NS)
        self._newest: Finding | None = None
        self._above, self._until_ns = 0, -1
        self._clear_ns: int | None = None
        self._outcome, self._since_ns = Outcome.NOT_EVALUATED, 0

    def evaluated(self, finding: Finding) -> None:
        """Use an evaluation; what accuses is kept until the accusation ends."""
        self._above = self._above + 1 if finding.above else 0
        accusing = self.accuses(finding.time_ns)
        if self._above >= self._count:
            if not accusing:
                clear_ns = finding.time_ns if self._clear_ns is None else self._clear_ns
                self.suspect_since_ns = clear_ns - self._latency_ns
            self._until_ns = finding.time_ns + self._hold_ns
        elif not accusing and self._above == 0:
            self._clear_ns = finding.time_ns
        if self._above >= self._count or not accusing:
            self._newest = finding

    def accuses(self, time_ns: int) -> bool:
        """Whether the last cause of an accusation is not older than the hold."""
        return time_ns <= self._until_ns

    def result(self, time_ns: int, stale_after_s: float) -> MonitorTest:
        """Result at a time."""
        found, outcome = self._newest, Outcome.PASS
        if self.accuses(time_ns):
            outcome = Outcome.ACCUSES
        elif found is None or time_ns - found.time_ns > stale_after_s * NS:
            outcome = Outcome.NOT_EVALUATED
        if outcome is not self._outcome or not self._since_ns:
            self._outcome, self._since_ns = outcome, time_ns
        if found is None or outcome is Outcome.NOT_EVALUATED:
            age = "" if found is None else f" for {(time_ns - found.time_ns) / NS:.0f} s"
            return MonitorTest(name=self._name, outcome=outcome, reason=self._missing + age, since_ns=self._since_ns)
        return MonitorTest(
            name=self._name, outcome=outcome, reason=found.reason, statistic=found.statistic,
            threshold=found.threshold, unit=found.unit, since_ns=self._since_ns,
        )  # fmt: skip


class EvidenceMonitor:
    """Takes what one receiver publishes, and gives the tests."""

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = s = settings or Settings()
        self.newest_ns: int | None = None  # of flags, levels, gain and clock
        self._gains: dict[int, SlowMean] = {}
        self._level = SlowMean(s.baseline_s, s.learning_s)
        self._clock, self._offset = ClockPrediction(), TimeOffset()
        self._host: HostClock | None = None
        self.tests = {
            name: EvidenceTest(name, missing, count=count, latency_s=latency_s, hold_s=s.hold_s)
            for name, missing, count, latency_s in (
                ("spoofing_flag", "the receiver states nothing of spoofing", 1, 0.0),
                ("jamming_flag", "the receiver states nothing of jamming", 1, 0.0),
                ("gain", "no gain of a radio path, or its mean is still being learned", PERSISTENT, 0.0),
                ("cn0_level", "no C/N0 of enough satellites", PERSISTENT, 0.0),
                ("cn0_spread", "no C/N0 of enough satellites at different elevations", PERSISTENT, 0.0),
                ("clock", "no two successive statements of the receiver's clock", 1, 0.0),
                ("gnss_time", "no UTC of the receiver over 20 s", 1, RECENT_S),
                ("host_time", "no UTC of the receiver, or nothing holds the clock of the host", PERSISTENT, RECENT_S),
            )
        }

    def quality(self, message: GnssSignalQuality) -> None:
        """Use flags, gain, clock and steps of the receiver's time."""
        time_ns = message.sampled_ns
        if message.status or message.security or message.radio_paths or message.clock:
            self.newest_ns = max(self.newest_ns or time_ns, time_ns)
        stated = ("navigation status", message.status), ("signal security", message.security)
        flags = [(name, part) for name, part in stated if part]
        self._flag(time_ns, "spoofing", [(name, part.spoofing) for name, part in flags])
        paths = [(f"radio path {path.number}", path.jamming) for path in message.radio_paths]
        self._flag(time_ns, "jamming", [*((name, part.jamming) for name, part in flags), *paths])
        self._use_gains(time_ns, message.radio_paths)
        if message.clock is not None:
            self._use_clock(time_ns, message.clock)
        if message.time_step_s is not None:
            self._use_time(time_ns, message.time_step_s)

    def satellites(self, message: GnssSatellites) -> None:
        """Use the C/N0 of the used satellites: their median, and their standard deviation."""
        s, time_ns = self.settings, message.sampled_ns
        known = [one for one in message.satellites if one.used and one.cn0_db_hz is not None]
        self.newest_ns = max(self.newest_ns or time_ns, time_ns)
        if len(known) < s.least_satellites:
            return
        cn0 = np.array([one.cn0_db_hz for one in known], dtype=float)
        level, mean = float(np.median(cn0)), self._level.value
        limit = s.level_limit_db_hz if mean is None else min(s.level_limit_db_hz, mean + s.level_rise_db)
        baseline = "" if mean is None else f", mean {mean:.1f}"
        reason = f"median C/N0 of {len(cn0)} satellites is {level:.1f} dB-Hz{baseline}, limit {limit:.1f}"
        self.tests["cn0_level"].evaluated(Finding(time_ns, level, limit, "dB-Hz", reason))
        if not self.tests["cn0_level"].accuses(time_ns):
            self._level.update(time_ns, level)
        elevations = [one.elevation_rad for one in known if one.elevation_rad is not None]
        if elevations and degrees(max(elevations) - min(elevations)) >= s.least_elevation_range_deg:
            spread = max(float(np.std(cn0, ddof=1)), 0.1)
            reason = f"C/N0 of {len(cn0)} satellites differ by {spread:.1f} dB, at least {s.least_spread_db:.1f} dB"
            finding = Finding(time_ns, 1.0 / spread, 1.0 / s.least_spread_db, "1/dB", reason)
            self.tests["cn0_spread"].evaluated(finding)

    def time(self, received_ns: int, utc_ns: int) -> None:
        """Use the arrival of a fix with the receiver's UTC."""
        step_s = self._offset.step(received_ns, utc_ns)
        if step_s is not None:
            self._use_time(received_ns, step_s)
        self._compare_with_host(received_ns)

    def host_clock(self, message: HostClock) -> None:
        """Use a reading of the host's clock."""
        self._host = message

    def results(self, time_ns: int) -> list[MonitorTest]:
        """All tests at a time."""
        return [test.result(time_ns, self.settings.stale_after_s) for test in self.tests.values()]

    def suspect_since_ns(self, time_ns: int) -> int | None:
        """Earliest time from which the evidence may be wrong, None while no test accuses."""
        suspect = [test.suspect_since_ns for test in self.tests.values() if test.accuses(time_ns)]
        return min((since_ns for since_ns in suspect if since_ns is not None), default=None)

    def _flag(self, time_ns: int, name: str, states: Sequence[tuple[str, InterferenceState | None]]) -> None:
        """Use the most severe state; a detector that is off or cannot tell says nothing."""
        known = [(SEVERITY[state], who, state) for who, state in states if state in SEVERITY]
        if known:
            severity, who, state = max(known, key=lambda one: one[0])
            reason = f"{who}: {name} {state}"
            self.tests[f"{name}_flag"].evaluated(Finding(time_ns, severity, FLAG_LIMIT, "-", reason))

    def _use_gains(self, time_ns: int, paths: Sequence[RadioPath]) -> None:
        """Compare each path's gain with its mean, which learns while no test of interference accuses."""
        s, worst = self.settings, None
        for path in paths:
            if path.gain_ratio is None or path.gain_ratio == 0.0:
                continue
            mean = self._gains.setdefault(path.number, SlowMean(s.baseline_s, s.learning_s))
            if mean.value:
                drop = 1.0 - path.gain_ratio / mean.value
                reason = f"gain of path {path.number} is {100.0 * drop:+.1f} % below its mean"
                finding = Finding(time_ns, drop, s.gain_drop_ratio, "-", reason)
                worst = finding if worst is None or drop > worst.statistic else worst
        if worst is not None:
            self.tests["gain"].evaluated(worst)
        if worst is None or not worst.above:
            for path in paths:
                if path.gain_ratio:
                    self._gains[path.number].update(time_ns, path.gain_ratio)

    def _use_clock(self, time_ns: int, clock: ReceiverClock) -> None:
        s = self.settings
        change = self._clock.update(time_ns, clock.bias_s, clock.drift_ratio, clock.bias_sd_s)
        if change is None:
            return
        limit_s = max(s.clock_step_s, s.clock_sd_factor * change.sd_s)
        statistic = max(abs(change.bias_s) / limit_s, abs(change.drift_ratio) / s.drift_step_ratio)
        reason = (
            f"receiver clock departs by {change.bias_s * 1e9:+.0f} ns from its drift, limit {limit_s * 1e9:.0f}; "
            f"the drift changes by {change.drift_ratio * 1e9:+.0f} ns/s, limit {s.drift_step_ratio * 1e9:.0f}"
        )
        self.tests["clock"].evaluated(Finding(time_ns, statistic, 1.0, "-", reason))

    def _compare_with_host(self, time_ns: int) -> None:
        """Compare the receiver's UTC with that of a host whose clock is held, by the arrival with the least delay."""
        s, host, offset_ns = self.settings, self._host, self._offset.recent_ns()
        if host is None or offset_ns is None or not host.synchronised or host.maximum_error_s is None:
            return
        if not -1.0 <= (time_ns - host.sampled_ns) / NS <= s.host_clock_age_s:
            return
        ahead_s = -(offset_ns + host.utc_ns - host.sampled_ns) / NS
        limit_s = s.host_time_s + host.maximum_error_s
        reason = f"GNSS time minus the host's clock is {ahead_s:+.3f} s, limit {limit_s:.3f}"
        self.tests["host_time"].evaluated(Finding(time_ns, abs(ahead_s), limit_s, "s", reason))

    def _use_time(self, time_ns: int, step_s: float) -> None:
        limit_s = self.settings.time_step_s
        reason = f"GNSS time jumped by {step_s:+.3f} s against the OBU time line, limit {limit_s:.3f}"
        self.tests["gnss_time"].evaluated(Finding(time_ns, abs(step_s), limit_s, "s", reason))
