"""Exclusion and readmission of a receiver that the gate rejects."""

from typing import NamedTuple

from ...settings import Settings

FAULT_MEMORY_S = 60.0  # time without a fault after which earlier faults are not counted


class FaultStatus(NamedTuple):
    """Fault status of a receiver for one kind of observation."""

    rejected_since_ns: int | None = None  # since when all observations have been rejected
    agreeing_since_ns: int | None = None  # since when all observations of an excluded receiver have agreed
    faults: int = 0
    fault_ns: int = 0  # begin or end of the newest fault
    excluded: bool = False

    def after(self, time_ns: int, agrees: bool, settings: Settings) -> "FaultStatus":
        """Status after one more observation, which is within the gate or not.

        A receiver that is rejected for `gating.fault_after_s` is excluded until all its observations have agreed for
        `gating.readmission_s`, twice as long after each further fault within a minute, at most
        `gating.readmission_max_s`.
        """
        if not agrees:
            since = time_ns if self.rejected_since_ns is None else self.rejected_since_ns
            if self.excluded or time_ns - since < settings.gating.fault_after_s * 1e9:
                return self._replace(rejected_since_ns=since, agreeing_since_ns=None)
            recent = time_ns - self.fault_ns < FAULT_MEMORY_S * 1e9
            return FaultStatus(since, None, 1 + (self.faults if recent else 0), time_ns, excluded=True)
        if not self.excluded:
            return self if self.rejected_since_ns is None else self._replace(rejected_since_ns=None)
        since = time_ns if self.agreeing_since_ns is None else self.agreeing_since_ns
        needed_s = min(settings.gating.readmission_s * 2.0 ** (self.faults - 1), settings.gating.readmission_max_s)
        if time_ns - since >= needed_s * 1e9:
            return FaultStatus(faults=self.faults, fault_ns=time_ns)
        return self._replace(rejected_since_ns=None, agreeing_since_ns=since)
