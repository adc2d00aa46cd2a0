"""What begins and ends each kind of event, on the OBU time line."""

from dataclasses import dataclass

from shared.messages.operation import HostClock
from shared.messages.tachograph import TachographKind
from shared.messages.trust import Outcome, TrustState

from ..tachograph import PERIOD_S
from ..verdicts import MotionVerdicts

NS = 1_000_000_000
TIME_LIMIT_S = 60.0  # [s] difference of the clock of the unit against GNSS that is a conflict (86)
STEP_LIMIT_NS = NS  # of the time of GNSS, which is followed at once
ABSENCE_S = 3.0 * 3600.0  # [s] of driving without a position that is an event (81)
LONGEST_STEP_S = 2.0  # [s] between two speeds over which driving time is counted
EVIDENCE = "evidence"  # monitor of the receiver's own flags
RULES = ("event", "motion_sensor")  # of the annex; the distance rule is apart while positions are not authenticated


@dataclass
class Conditions:
    """What lasts: begin of each kind [ns, OBU time line], or None."""

    anomaly_ns: int | None = None
    clock_ns: int | None = None
    clock_difference_s: float | None = None
    utc_offset_ns: int | None = None  # UTC by GNSS - OBU time line
    driven_s: float = 0.0  # since the newest position
    last_speed_ns: int | None = None
    absent_since_ns: int | None = None
    absent_since_utc_ns: int | None = None  # of an earlier run, in place of the stamp of another time line
    measured_offset_ns: int | None = None  # newest of GNSS, which may be spoofed
    clock_seen: bool = False  # whether a clock of the unit is compared with GNSS

    def position(self, time_ns: int, utc_ns: int | None) -> None:
        """Use a fix with a position."""
        self.driven_s, self.absent_since_ns, self.absent_since_utc_ns = 0.0, None, None
        if utc_ns is None:
            return
        self.measured_offset_ns = utc_ns - time_ns
        if self.utc_offset_ns is None:
            self.utc_offset_ns = self.measured_offset_ns
        elif not self.clock_seen or abs(self.measured_offset_ns - self.utc_offset_ns) <= STEP_LIMIT_NS:
            self._take_offset()

    def speed(self, time_ns: int, speed: float) -> None:
        """Count the driving time without a position."""
        step_s = 0.0 if self.last_speed_ns is None else (time_ns - self.last_speed_ns) / NS
        self.last_speed_ns = time_ns
        if speed > 0.0 and 0.0 < step_s <= LONGEST_STEP_S:
            if self.driven_s == 0.0:
                self.absent_since_ns = time_ns
            self.driven_s += step_s

    def _take_offset(self) -> None:
        """Follow the time of GNSS, unless it may be false: the log then goes on with the offset before.

        The first offset is taken in any case, as nothing can be dated without one; a step only after the clock of the
        unit has agreed, so that the offset before is that before the step.
        """
        if self.anomaly_ns is None and self.clock_ns is None:
            self.utc_offset_ns = self.measured_offset_ns

    def adopt(self, driven_s: float, since_utc_ns: int | None) -> None:
        """Go on with the drive without a position of an earlier run."""
        if self.driven_s == 0.0 and since_utc_ns is not None:
            self.driven_s, self.absent_since_utc_ns = driven_s, since_utc_ns

    def trust(self, state: TrustState) -> None:
        """An anomaly: the receiver itself, or the other sensors, say that GNSS is falsified."""
        accused = state.gnss_excluded or any(
            monitor.monitor == EVIDENCE and monitor.outcome is Outcome.ACCUSES and "gnss" in monitor.accused
            for monitor in state.monitors
        )
        self.anomaly_ns = (self.anomaly_ns or state.suspect_since_ns or state.sampled_ns) if accused else None

    def clock(self, message: HostClock) -> None:
        """Compare the clock of the unit with the time of GNSS."""
        self.clock_seen = True
        if self.measured_offset_ns is None:
            return
        difference_s = abs(message.utc_ns - message.sampled_ns - self.measured_offset_ns) / NS
        if difference_s > TIME_LIMIT_S:
            self.clock_ns = self.clock_ns or message.sampled_ns
            self.clock_difference_s = max(self.clock_difference_s or 0.0, difference_s)
        else:
            self.clock_ns = self.clock_difference_s = None
            self._take_offset()

    def absent_since(self, offset_ns: int) -> int | None:
        """Begin [ns, UTC] of the drive without a position, which may be of an earlier run."""
        if self.absent_since_utc_ns is not None or self.absent_since_ns is None:
            return self.absent_since_utc_ns
        return self.absent_since_ns + offset_ns

    def begins(self, verdicts: MotionVerdicts, exceeded_s: float, time_ns: int) -> dict[TachographKind, int | None]:
        """Begin of each kind that lasts.

        That of a motion conflict is the time since when the trimmed mean is above its threshold, or the odometer
        stands; of the distance rule that of the position before.
        """
        tests = verdicts.named()
        since = [tests[name].suspect_since_ns for name in RULES if tests[name].accuses]
        conflict = min((ns for ns in since if ns is not None), default=None)
        if tests["event"].accuses and conflict is None:
            conflict = time_ns - round((exceeded_s + PERIOD_S) * NS)
        absent = self.driven_s > ABSENCE_S
        return {
            TachographKind.MOTION_CONFLICT: conflict,
            TachographKind.DISTANCE_UNAUTHENTICATED: (
                tests["distance"].suspect_since_ns if tests["distance"].accuses else None
            ),
            TachographKind.GNSS_ANOMALY: self.anomaly_ns,
            TachographKind.TIME_CONFLICT: self.clock_ns,
            TachographKind.POSITION_ABSENT: self.absent_since_ns if absent else None,
        }
