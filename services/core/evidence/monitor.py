"""The tests of the monitor `evidence`: what a receiver says of itself, each with its threshold.

None of them proves anything: a receiver's flags depend on its firmware, and signal levels on the sky. Therefore an
accusation is evidence, which lowers the verdict to CAUTION at most.
"""

from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from math import degrees

import numpy as np

from shared.messages.explanation import Explanation, explain
from shared.messages.gnss import (
    CarrierDisplacement,
    GnssFix,
    GnssSatellites,
    GnssSignalQuality,
    InterferenceState,
    RadioPath,
    ReceiverClock,
)
from shared.messages.operation import HostClock
from shared.messages.trust import Outcome
from shared.trust.accused import GNSS
from shared.trust.result import Test, judged, lasting

from .baselines import NS, RECENT_S, ClockPrediction, SlowMean, TimeOffset
from .codes import Code
from .drift_over_loss import DriftOverLoss
from .settings import Settings
from .velocities import Difference, VelocityComparison

SEVERITY = {InterferenceState.NONE: 0.0, InterferenceState.INDICATED: 1.0, InterferenceState.SEVERE: 2.0}
FLAG_LIMIT = 0.5
PERSISTENT = 2  # successive evaluations above the threshold, of what varies from epoch to epoch


class Part(StrEnum):
    """Part of a receiver that detects jamming or spoofing, beside the radio paths."""

    NAVIGATION_STATUS = "navigation_status"
    SIGNAL_SECURITY = "signal_security"


class EvidenceTest:
    """Latest evaluation of one test, and whether it accuses."""

    def __init__(self, name: str, missing: Code, *, count: int, latency_s: float, hold_s: float) -> None:
        self._suspect_since_ns: int | None = None  # last evaluation before the accusation that was below the threshold
        self._name, self._missing = name, explain(missing)
        self._count, self._hold_ns = count, round(hold_s * NS)
        self._latency_ns = round(latency_s * NS)
        self._newest: tuple[int, Test] | None = None
        self._above, self._until_ns = 0, -1
        self._clear_ns: int | None = None
        self._known: Test | None = None  # result at the time before

    def evaluated(self, time_ns: int, found: Test) -> None:
        """Use an evaluation; what accuses is kept until the accusation ends."""
        self._above = self._above + 1 if found.accuses else 0
        accusing = self.accuses(time_ns)
        if self._above >= self._count:
            if not accusing:
                clear_ns = time_ns if self._clear_ns is None else self._clear_ns
                self._suspect_since_ns = clear_ns - self._latency_ns
            self._until_ns = time_ns + self._hold_ns
        elif not accusing and self._above == 0:
            self._clear_ns = time_ns
        if self._above >= self._count or not accusing:
            self._newest = time_ns, found

    def accuses(self, time_ns: int) -> bool:
        """Whether the last cause of an accusation is not older than the hold."""
        return time_ns <= self._until_ns

    def result(self, time_ns: int, stale_after_s: float) -> Test:
        """Result at a time."""
        self._known = lasting(self._result(time_ns, stale_after_s), self._known, time_ns)
        return self._known

    def _result(self, time_ns: int, stale_after_s: float) -> Test:
        if self._newest is None:
            return Test(Outcome.NOT_EVALUATED, self._missing)
        found_ns, found = self._newest
        if self.accuses(time_ns):
            return replace(found, outcome=Outcome.ACCUSES, suspect_since_ns=self._suspect_since_ns)
        if time_ns - found_ns > stale_after_s * NS:
            why = explain(Code.SILENT, test=self._name, age_s=round((time_ns - found_ns) / NS))
            return Test(Outcome.NOT_EVALUATED, why)
        return replace(found, outcome=Outcome.PASS)


def evaluation(statistic: float, threshold: float, unit: str, why: Explanation) -> Test:
    """One evaluation of one test."""
    return judged(Test(Outcome.NOT_EVALUATED, why, unit, accused=(GNSS,)), statistic, threshold)


class EvidenceMonitor:
    """Takes what one receiver publishes, and gives the tests."""

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = s = settings or Settings()
        self.newest_ns: int | None = None  # of flags, levels, gain and clock
        self._gains: dict[int, SlowMean] = {}
        self._level = SlowMean(s.baseline_s, s.learning_s)
        self._clock, self._drift, self._offset = ClockPrediction(), DriftOverLoss(), TimeOffset()
        self._host: HostClock | None = None
        self._source = ""
        self._velocities = VelocityComparison(s.velocities_m_s)
        self.tests = {
            name: EvidenceTest(name, missing, count=count, latency_s=latency_s, hold_s=s.hold_s)
            for name, missing, count, latency_s in (
                ("spoofing_flag", Code.NO_SPOOFING_STATE, 1, 0.0),
                ("jamming_flag", Code.NO_JAMMING_STATE, 1, 0.0),
                ("gain", Code.NO_GAIN, PERSISTENT, 0.0),
                ("cn0_level", Code.NO_LEVEL, PERSISTENT, 0.0),
                ("cn0_spread", Code.NO_SPREAD, PERSISTENT, 0.0),
                ("clock", Code.NO_CLOCK, 1, 0.0),
                ("gnss_time", Code.NO_GNSS_TIME, 1, RECENT_S),
                ("host_time", Code.NO_HOST_TIME, PERSISTENT, RECENT_S),
                ("velocities", Code.NO_VELOCITIES, PERSISTENT, 5.0),
            )
        }

    def of_receiver(self, source: str) -> None:
        """Note whose messages follow: the oscillators of two receivers differ."""
        if source != self._source:
            self._source, self._drift = source, DriftOverLoss()
            self._velocities = VelocityComparison(self.settings.velocities_m_s)

    def quality(self, message: GnssSignalQuality) -> None:
        """Use flags, gain, clock and steps of the receiver's time."""
        time_ns = message.sampled_ns
        self._drift.heard(time_ns)
        if message.status or message.security or message.radio_paths or message.clock:
            self.newest_ns = max(self.newest_ns or time_ns, time_ns)
        stated = (Part.NAVIGATION_STATUS, message.status), (Part.SIGNAL_SECURITY, message.security)
        flags = [(name, part) for name, part in stated if part]
        self._flag(time_ns, "spoofing_flag", [(name, part.spoofing) for name, part in flags])
        paths = [(path.number, path.jamming) for path in message.radio_paths]
        self._flag(time_ns, "jamming_flag", [*((name, part.jamming) for name, part in flags), *paths])
        self._use_gains(time_ns, message.radio_paths)
        if message.clock is not None:
            self._use_clock(time_ns, message.clock)
        if message.time_step_s is not None:
            self._use_time(time_ns, message.time_step_s)

    def satellites(self, message: GnssSatellites) -> None:
        """Use the C/N0 of the used satellites: their median, and their standard deviation."""
        s, time_ns = self.settings, message.sampled_ns
        self._drift.heard(time_ns)
        self._compare_drift(time_ns, sum(satellite.used for satellite in message.satellites))
        known = [satellite for satellite in message.satellites if satellite.used and satellite.cn0_db_hz is not None]
        self.newest_ns = max(self.newest_ns or time_ns, time_ns)
        if len(known) < s.least_satellites:
            return
        cn0 = np.array([satellite.cn0_db_hz for satellite in known], dtype=float)
        level, mean = float(np.median(cn0)), self._level.value
        limit = s.level_limit_db_hz if mean is None else min(s.level_limit_db_hz, mean + s.level_rise_db)
        code = Code.LEVEL if mean is None else Code.LEVEL_AND_MEAN
        why = explain(code, satellites_count=len(cn0), mean_db_hz=mean)
        self.tests["cn0_level"].evaluated(time_ns, evaluation(level, limit, "dB-Hz", why))
        if not self.tests["cn0_level"].accuses(time_ns):
            self._level.update(time_ns, level)
        elevations = [satellite.elevation_rad for satellite in known if satellite.elevation_rad is not None]
        if elevations and degrees(max(elevations) - min(elevations)) >= s.least_elevation_range_deg:
            spread = max(float(np.std(cn0, ddof=1)), 0.1)
            why = explain(Code.SPREAD, satellites_count=len(cn0), spread_db=spread, least_db=s.least_spread_db)
            found = evaluation(1.0 / spread, 1.0 / s.least_spread_db, "1/dB", why)
            self.tests["cn0_spread"].evaluated(time_ns, found)

    def time(self, received_ns: int, utc_ns: int, late_s: float = 0.0) -> None:
        """Use the arrival of a fix with the receiver's UTC, and by how much that was late."""
        step_s = self._offset.step(received_ns, utc_ns)
        if step_s is not None:
            self._use_time(received_ns, step_s)
        self._compare_with_host(received_ns, late_s)

    def velocity(self, message: GnssFix | CarrierDisplacement) -> None:
        """Compare the velocity that the receiver states, and those by Doppler and by carrier phases."""
        compared = self._velocities
        found = compared.fix(message) if isinstance(message, GnssFix) else compared.displacement(message)
        if found is not None:
            self._use_difference(found)

    def host_clock(self, message: HostClock) -> None:
        """Use a reading of the host's clock."""
        self._host = message

    def results(self, time_ns: int) -> dict[str, Test]:
        """All tests at a time, by name."""
        return {name: test.result(time_ns, self.settings.stale_after_s) for name, test in self.tests.items()}

    def _flag(self, time_ns: int, name: str, states: Sequence[tuple[Part | int, InterferenceState | None]]) -> None:
        """Use the most severe state; a detector that is off or cannot tell says nothing."""
        known = [(SEVERITY[state], who, state) for who, state in states if state in SEVERITY]
        if known:
            severity, who, state = max(known, key=lambda pair: pair[0])
            if isinstance(who, Part):
                why = explain(Code.SPOOFING if name == "spoofing_flag" else Code.JAMMING, part=who, state=state)
            else:
                why = explain(Code.JAMMING_OF_PATH, path_number=who, state=state)
            self.tests[name].evaluated(time_ns, evaluation(severity, FLAG_LIMIT, "-", why))

    def _use_gains(self, time_ns: int, paths: Sequence[RadioPath]) -> None:
        """Compare each path's gain with its mean, which learns while no test of interference accuses."""
        s, worst = self.settings, None  # drop and number of a path
        for path in paths:
            if path.gain_ratio is None or path.gain_ratio == 0.0:
                continue
            mean = self._gains.setdefault(path.number, SlowMean(s.baseline_s, s.learning_s))
            if mean.value:
                drop = 1.0 - path.gain_ratio / mean.value
                worst = (drop, path.number) if worst is None or drop > worst[0] else worst
        found = None
        if worst is not None:
            drop, number = worst
            why = explain(Code.GAIN, path_number=number)
            found = evaluation(drop, s.gain_drop_ratio, "-", why)
            self.tests["gain"].evaluated(time_ns, found)
        if found is None or not found.accuses:
            for path in paths:
                if path.gain_ratio:
                    self._gains[path.number].update(time_ns, path.gain_ratio)

    def _use_clock(self, time_ns: int, clock: ReceiverClock) -> None:
        s = self.settings
        self._drift.clock(time_ns, clock.drift_ratio)
        change = self._clock.update(time_ns, clock.bias_s, clock.drift_ratio, clock.bias_sd_s)
        if change is None:
            return
        limit_s = max(s.clock_step_s, s.clock_sd_factor * change.sd_s)
        statistic = max(abs(change.bias_s) / limit_s, abs(change.drift_ratio) / s.drift_step_ratio)
        why = explain(
            Code.CLOCK, bias_s=change.bias_s, bias_limit_s=limit_s, drift_ratio=change.drift_ratio,
            drift_limit_ratio=s.drift_step_ratio,
        )  # fmt: skip
        self.tests["clock"].evaluated(time_ns, evaluation(statistic, 1.0, "-", why))

    def _compare_drift(self, time_ns: int, satellites: int) -> None:
        """Compare the clock's drift with that before a loss of the signals."""
        change = self._drift.epoch(time_ns, satellites)
        if change is not None:
            why = explain(Code.CLOCK_AFTER_LOSS, drift_m_s=change.drift_m_s, gap_s=change.gap_s)
            self.tests["clock"].evaluated(time_ns, evaluation(abs(change.drift_m_s), change.limit_m_s, "m/s", why))

    def _compare_with_host(self, time_ns: int, late_s: float) -> None:
        """Compare the receiver's UTC with that of a host whose clock is held, by the arrival with the least delay."""
        s, host, offset_ns = self.settings, self._host, self._offset.recent_ns()
        if host is None or offset_ns is None or not host.synchronised or host.maximum_error_s is None:
            return
        if not -1.0 <= (time_ns - host.sampled_ns) / NS <= s.host_clock_age_s:
            return
        ahead_s = late_s - (offset_ns + host.utc_ns - host.sampled_ns) / NS
        limit_s = s.host_time_s + host.maximum_error_s
        why = explain(Code.HOST_TIME, ahead_s=ahead_s)
        self.tests["host_time"].evaluated(time_ns, evaluation(abs(ahead_s), limit_s, "s", why))

    def _use_difference(self, found: Difference) -> None:
        ratio = found.distance_m_s / found.limit_m_s
        why = explain(Code.VELOCITIES_AGREE)
        if ratio > 1.0:
            why = explain(
                Code.VELOCITIES, differs=found.differs, distance_m_s=found.distance_m_s, limit_m_s=found.limit_m_s
            )
        self.tests["velocities"].evaluated(found.time_ns, evaluation(ratio, 1.0, "-", why))

    def _use_time(self, time_ns: int, step_s: float) -> None:
        limit_s = self.settings.time_step_s
        why = explain(Code.GNSS_TIME, step_s=step_s)
        self.tests["gnss_time"].evaluated(time_ns, evaluation(abs(step_s), limit_s, "s", why))
