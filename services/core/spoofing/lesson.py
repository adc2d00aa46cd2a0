"""What a vehicle teaches about its own sensors: windows of a drive, and the profile that the next one starts with.

Inertial noise against GNSS is learned only while another source vouches for GNSS (redundant satellites, or the
odometer), and never in a conflict: a slow drag would otherwise teach the monitor to pass it. It is adopted at the next
start.
"""

from collections import deque
from collections.abc import Iterable

from shared.inertial.increments import SECOND_NS
from shared.messages.explanation import Explanation, explain
from shared.messages.trust import LearnedGrade, Outcome, TrustState

from .codes import Code
from .profile import LearnedDrive, Origin, Profile, learn
from .windows.metrics import Metric
from .windows.short_window import Window

NEEDED_S = 600  # of windows, one a second
MAX_WINDOWS = 3600  # windows
SILENCE_TIMEOUT_NS = 5 * SECOND_NS  # after which the last verdict says nothing any more
PERIOD_NS = 60 * SECOND_NS
VOUCHING = ("satellites", "motion", "motion_fast")


class WindowCollection:
    """Collects the windows of a drive that is free of conflicts."""

    def __init__(self, stated: Profile) -> None:
        self._stated = stated
        self._windows: deque[Window] = deque(maxlen=MAX_WINDOWS)
        self._long: deque[float] = deque(maxlen=2 * MAX_WINDOWS)
        self._published_ns: int | None = None
        self._quiet = self._vouched = False
        self._heard_ns: int | None = None  # newest verdict

    def heed(self, state: TrustState) -> None:
        """Use the verdict: whether there is a conflict, and whether another source vouches for GNSS."""
        accusing = any(monitor.outcome is Outcome.ACCUSES for monitor in state.monitors)
        self._quiet, self._heard_ns = state.suspect_since_ns is None and not accusing, state.sampled_ns
        suspect_ns = state.suspect_since_ns
        while suspect_ns is not None and self._windows and self._windows[-1].end_ns > suspect_ns:
            self._windows.pop()
        self._vouched = any(
            monitor.monitor in VOUCHING and monitor.outcome is Outcome.PASS for monitor in state.monitors
        )

    def add(self, time_ns: int, window: Window | None, long_statistics: Iterable[float]) -> None:
        """Keep a window, once, if it can be learned from."""
        if self._published_ns is None:
            self._published_ns = time_ns
        known = bool(self._windows) and window is self._windows[-1]
        fresh = self._heard_ns is not None and time_ns - self._heard_ns <= SILENCE_TIMEOUT_NS
        if window is not None and not known and fresh and self._quiet and self._vouched:
            self._windows.append(window)
            self._long += long_statistics

    @property
    def progress(self) -> Explanation:
        """How far the lesson is."""
        learned_s = len(self._windows)  # one a second
        if learned_s >= NEEDED_S:
            return explain(Code.LEARNED, learned_s=learned_s)
        code = Code.LEARNING if self._vouched else Code.LEARNING_UNVOUCHED
        return explain(code, learned_s=learned_s, needed_s=NEEDED_S)

    def is_due(self, time_ns: int) -> bool:
        """Whether there is enough, and a minute has passed since the last result."""
        if len(self._windows) < NEEDED_S or time_ns - (self._published_ns or 0) < PERIOD_NS:
            return False
        self._published_ns = time_ns
        return True

    def result(self, time_ns: int, origin: Origin) -> LearnedGrade:
        """What has been learned of this device."""
        profile = learn(
            self._windows, provenance="this drive", long_statistics=self._long,
            stated=self._stated,
        )  # fmt: skip
        return LearnedGrade(
            sampled_ns=time_ns, imu=origin.imu, gnss=origin.gnss, imu_rate_hz=origin.imu_rate_hz,
            gnss_rate_hz=origin.gnss_rate_hz, configuration=origin.configuration, windows=len(self._windows),
            metrics=tuple(metric.value for metric in profile.sigma),
            sigma=tuple((a, b, c, d) for a, b, c, d in profile.sigma.values()),
            threshold=profile.threshold, long_factor=min(profile.long_factor, 100.0),
            false_alarm_rate=profile.false_alarm_rate,
        )  # fmt: skip


def profile_of_learned(learned: LearnedGrade) -> Profile:
    """Profile of a message of an earlier drive."""
    drive = LearnedDrive(
        file="earlier drive", sha256="0" * 64, date=str(learned.sampled_ns), duration_s=float(learned.windows),
        windows=learned.windows,
    )  # fmt: skip
    origin = Origin(
        imu=learned.imu, gnss=learned.gnss, imu_rate_hz=learned.imu_rate_hz, gnss_rate_hz=learned.gnss_rate_hz,
        configuration=learned.configuration, code="", drives=(drive,),
    )  # fmt: skip
    sigma = {Metric(name): values for name, values in zip(learned.metrics, learned.sigma, strict=True)}
    return Profile(
        sigma=sigma, threshold=learned.threshold, long_factor=learned.long_factor,
        false_alarm_rate=learned.false_alarm_rate, provenance=f"learned by this unit in {learned.windows} s of driving",
        origin=origin,
    )  # fmt: skip
