"""Decides when fixes alone are published, because inertial samples are missing, and says so."""

from collections.abc import Sequence
from typing import NamedTuple

from shared.messages.explanation import Explanation, explain

from .aids.base import Measurement
from .codes import Code
from .hypotheses.gnss_only import GnssOnly
from .inertial.filter import ErrorStateFilter
from .settings import Settings
from .solution import Solution

NS = 1_000_000_000
# Silence of the IMU in use after which another one, or none, is used; a gap of that length ends the solution.
SILENCE_TIMEOUT_NS = 1_000_000_000
FIRST_SAMPLE_TIMEOUT_NS = 5 * NS  # from the first fix: inertial units start within a second or two of their driver
OUTAGE_LIMIT_NS = 30 * NS  # silence after which measurements are no longer kept for the filter, which cannot go on then
FAR_NS = 60 * NS
MIN_ARRIVALS = 3  # arrivals far ahead
FAULT_FREE_NS = 3 * NS  # time after a fault-free fix in which the receiver's own fixes are not published


class ImuOutage(NamedTuple):
    """Since when fixes alone are published, and why."""

    since_ns: int
    why: Explanation


class WithoutImu:
    """Follows the arrival of samples and fixes; holds the solution of fixes alone while there is no other one."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.heard_ns: int | None = None  # arrival of the newest inertial samples
        self.missing: ImuOutage | None = None  # while fixes alone are published
        self._first_fix_ns: int | None = None
        self._newest_fix_ns: int | None = None
        self._ahead: list[int] = []  # arrivals far ahead of all others, one after the other
        self._fault_free_ns = -FAULT_FREE_NS
        self._model: GnssOnly | None = None

    def is_silent(self, now_ns: int) -> bool:
        """Whether no inertial samples have come for a second, or none at all."""
        return self.heard_ns is None or now_ns - self.heard_ns > SILENCE_TIMEOUT_NS

    def is_far_ahead(self, received_ns: int) -> bool:
        """Whether an arrival is a minute ahead of everything before, and alone: a stamp that is wrong.

        Arrivals that follow it one after the other, as those after a sleep of the computer do, are believed.
        """
        known_ns = [ns for ns in (self.heard_ns, self._newest_fix_ns) if ns is not None]
        if not known_ns or received_ns - max(known_ns) <= FAR_NS:
            self._newest_fix_ns, self._ahead = max(received_ns, self._newest_fix_ns or received_ns), []
            return False
        if not self._ahead or 0 < received_ns - self._ahead[-1] <= FAR_NS:
            self._ahead.append(received_ns)
        if len(self._ahead) < MIN_ARRIVALS:
            return True
        self._newest_fix_ns, self._ahead = received_ns, []
        return False

    def is_abandoned(self, now_ns: int) -> bool:
        """Whether the filter cannot go on with what is received now."""
        if self.heard_ns is None:
            return self.missing is not None
        return now_ns - self.heard_ns > OUTAGE_LIMIT_NS

    @property
    def rejected(self) -> int:
        """Number of positions that contradicted those before."""
        return 0 if self._model is None else self._model.rejected

    def solve(
        self, measurements: Sequence[Measurement], received_ns: int, running: ErrorStateFilter | None
    ) -> Solution | None:
        """Use the measurements of a fix; returns its solution while inertial samples are missing.

        Parameters
        ----------
        measurements : sequence of Measurement
            Of one epoch.
        received_ns : int
            When it arrived at the driver.
        running : ErrorStateFilter, optional
            Filter that ran until the samples were missing.
        """
        self._first_fix_ns = received_ns if self._first_fix_ns is None else self._first_fix_ns
        if self.missing is None:
            self._begin(received_ns, running)
        if self._model is None:
            return None
        for measurement in measurements:
            if measurement.left_out:
                self._fault_free_ns = max(self._fault_free_ns, measurement.time_ns)
            elif 0 <= measurement.time_ns - self._fault_free_ns <= FAULT_FREE_NS:
                continue
            self._model.use(measurement)
        return self._model.take() if self.missing is not None else None

    def interrupted(self, received_ns: int, running: ErrorStateFilter | None) -> None:
        """Publish fixes alone after a gap between two samples, until the filter has a solution again."""
        if self.heard_ns is not None and self.missing is None:
            self._begin(received_ns, running)

    def _begin(self, received_ns: int, running: ErrorStateFilter | None) -> None:
        """Begin to publish fixes alone where samples are missing; before it is certain, only learn from fixes."""
        if not self.is_silent(received_ns):
            self._model = None
            return
        if self._model is None:
            self._model = GnssOnly(self._settings, running)
        if self.heard_ns is not None:
            self.missing = ImuOutage(self.heard_ns, explain(Code.NO_SAMPLES))
        elif self._first_fix_ns is not None and received_ns - self._first_fix_ns >= FIRST_SAMPLE_TIMEOUT_NS:
            self.missing = ImuOutage(received_ns, explain(Code.NO_INERTIAL_UNIT))

    def end(self) -> None:
        """End it, because the filter has a solution."""
        self.missing = self._model = None
