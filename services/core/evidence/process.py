"""Judges what the GNSS receiver says of jamming, spoofing, its signals and its clock."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace

from shared.chosen import ChosenSource, receiver_choice, receiver_of
from shared.messages.base import Tick
from shared.messages.explanation import Explanation, explain
from shared.messages.gnss import CarrierDisplacement, GnssFix, GnssSatellites, GnssSignalQuality
from shared.messages.operation import HostClock, ModeState
from shared.messages.trust import Outcome, TrustMonitor
from shared.trust.result import Test, statement

from .codes import Code
from .monitor import EvidenceMonitor
from .settings import Settings

In = GnssSignalQuality | GnssSatellites | GnssFix | CarrierDisplacement | HostClock | ModeState | Tick
RESTART_NS = 5_000_000_000  # by which an arrival is earlier than the newest one where a time line starts again
OWN_TESTS = ("spoofing_flag", "jamming_flag", "gain", "cn0_level", "cn0_spread", "clock")


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
            self._monitor.of_receiver(receiver_of(message.source))
            match message:
                case GnssSignalQuality():
                    self._monitor.quality(message)
                case GnssSatellites():
                    self._monitor.satellites(message)
                case GnssFix():
                    self._monitor.velocity(message)
                    if message.utc_ns is not None:
                        self._monitor.time(message.received_ns, message.utc_ns, message.late_s or 0.0)
                case CarrierDisplacement():
                    self._monitor.velocity(message)

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
        newest_ns, outcome = self._monitor.newest_ns, _outcome(tests)
        decides = max((test for test in tests.values() if test.outcome is outcome), key=lambda test: test.weight)
        suspect = [test.suspect_since_ns for test in tests.values() if test.accuses]
        decides = replace(
            decides, why=_why(tests, decides, never=newest_ns is None),
            suspect_since_ns=min((since_ns for since_ns in suspect if since_ns is not None), default=None),
        )  # fmt: skip
        current = newest_ns is None or decides.accuses
        return statement("evidence", decides, now_ns if current else min(newest_ns or now_ns, now_ns), tests)


def _outcome(tests: Mapping[str, Test]) -> Outcome:
    """Accuses if any test does; passes if any test of what the receiver says of itself does."""
    if any(test.accuses for test in tests.values()):
        return Outcome.ACCUSES
    passed = any(tests[name].outcome is Outcome.PASS for name in OWN_TESTS)
    return Outcome.PASS if passed else Outcome.NOT_EVALUATED


def _why(tests: Mapping[str, Test], decides: Test, *, never: bool) -> Explanation:
    """Why the monitor has its outcome: an accusation by the test that decides."""
    if decides.accuses:
        return decides.why
    missing = tuple(name for name, test in tests.items() if not test.evaluated)
    if not decides.evaluated:
        return explain(Code.NOTHING_STATED) if never else explain(Code.NOTHING_EVALUATED, missing=missing)
    passed = len(tests) - len(missing)
    if not missing:
        return explain(Code.PASSES, passed_count=passed, tests_count=len(tests))
    return explain(Code.PASSES_PARTLY, passed_count=passed, tests_count=len(tests), missing=missing)
