"""Judges what the GNSS receiver says of jamming, spoofing, its signals and its clock."""

from collections import Counter
from collections.abc import Iterator

from shared.chosen import ChosenSource, receiver_choice, receiver_of
from shared.messages.base import Tick
from shared.messages.gnss import GnssFix, GnssSatellites, GnssSignalQuality
from shared.messages.operation import HostClock, ModeState
from shared.messages.trust import MonitorTest, Outcome, TrustMonitor

from .monitor import EvidenceMonitor
from .settings import Settings

In = GnssSignalQuality | GnssSatellites | GnssFix | HostClock | ModeState | Tick
RESTART_NS = 5_000_000_000  # by which an arrival is earlier than the newest one where a time line starts again
OWN_TESTS = ("spoofing_flag", "jamming_flag", "gain", "cn0_level", "cn0_spread", "clock")
NOTHING = "the receiver states nothing of its status, clock, satellites, radio paths or signal security"


class Config(Settings):
    """Settings of core.evidence."""


class Process:
    """Publishes the statement `evidence` once a second.

    A receiver that never sends evidence is not evaluated, with a current stamp. Once it has sent some, the stamp is
    that of the newest: when it stops, the statement becomes stale, which core.trust takes for a monitor without input.
    """

    def __init__(self, config: Config) -> None:
        self.rejects: Counter[str] = Counter()
        self._config, self._monitor = config, EvidenceMonitor(config)
        self._receivers = ChosenSource(receiver_choice)
        self._newest_ns: int | None = None  # arrival of the newest message of the receiver in use

    def handle(self, message: In) -> Iterator[TrustMonitor]:
        """Use a message of the receiver; publish with each tick."""
        if isinstance(message, Tick):
            yield self._statement(message.now_ns)
        elif isinstance(message, HostClock):
            self._monitor.host_clock(message)
        elif isinstance(message, ModeState):
            self._receivers.follow(message)
        elif self._is_chosen(receiver_of(message.source), message.received_ns):
            match message:
                case GnssSignalQuality():
                    self._monitor.quality(message)
                case GnssSatellites():
                    self._monitor.satellites(message)
                case GnssFix() if message.utc_ns is not None:
                    self._monitor.time(message.received_ns, message.utc_ns)

    def _is_chosen(self, source: str, now_ns: int) -> bool:
        if not self._receivers.takes(source, now_ns):
            self.rejects["second receiver"] += 1
            return False
        if self._newest_ns is not None and now_ns < self._newest_ns - RESTART_NS:
            self.rejects["time line started again"] += 1
            self._monitor = EvidenceMonitor(self._config)
        self._newest_ns = now_ns
        return True

    def _statement(self, now_ns: int) -> TrustMonitor:
        tests = self._monitor.results(now_ns)
        newest_ns = self._monitor.newest_ns
        outcome = _outcome(tests)
        deciding = max((test for test in tests if test.outcome is outcome), key=_ratio, default=None)
        accuses = outcome is Outcome.ACCUSES
        return TrustMonitor(
            sampled_ns=now_ns if newest_ns is None or accuses else min(newest_ns, now_ns), monitor="evidence",
            outcome=outcome, reason=_reason(tests, outcome, never=newest_ns is None),
            accused=("gnss",) if accuses else (), suspect_since_ns=self._monitor.suspect_since_ns(now_ns),
            since_ns=None if deciding is None else deciding.since_ns,
            statistic=None if deciding is None else deciding.statistic,
            threshold=None if deciding is None else deciding.threshold, tests=tuple(tests),
        )  # fmt: skip


def _outcome(tests: list[MonitorTest]) -> Outcome:
    """Accuses if any test does; passes if any test of what the receiver says of itself does."""
    if any(test.outcome is Outcome.ACCUSES for test in tests):
        return Outcome.ACCUSES
    passed = any(test.outcome is Outcome.PASS and test.name in OWN_TESTS for test in tests)
    return Outcome.PASS if passed else Outcome.NOT_EVALUATED


def _reason(tests: list[MonitorTest], outcome: Outcome, *, never: bool) -> str:
    if outcome is Outcome.NOT_EVALUATED:
        return NOTHING if never else "; ".join(test.reason for test in tests if test.name in OWN_TESTS)[:400]
    if outcome is Outcome.ACCUSES:
        return "; ".join(test.reason for test in tests if test.outcome is outcome)[:400]
    missing = [test.name for test in tests if test.outcome is Outcome.NOT_EVALUATED]
    count = f"{len(tests) - len(missing)} of {len(tests)} tests pass"
    return f"{count}; not evaluated: {', '.join(missing)}" if missing else count


def _ratio(test: MonitorTest) -> float:
    return test.statistic / test.threshold if test.statistic is not None and test.threshold else 0.0
