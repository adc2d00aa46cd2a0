"""What begins and ends each kind of event, on the OBU time line."""

from dataclasses import dataclass

from shared.messages.operation import HostClock
from shared.messages.tachograph import TachographKind
from shared.messages.trust import Outcome, TrustState

from ..tachograph import PERIOD_S
from ..verdicts import MotionVerdicts

NS = 1_000_000_000
TIME_LIMIT_S = 60.0  # [s] difference of the clock of the unit against GNSS that is a conflict (86)
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

    def position(self, time_ns: int, utc_ns: int | None) -> None:
        """Use a fix with a position."""
        self.driven_s, self.absent_since_ns = 0.0, None
        if utc_ns is not None:
            self.utc_offset_ns = utc_ns - time_ns

    def speed(self, time_ns: int, speed: float) -> None:
        """Count the driving time without a position."""
        step_s = 0.0 if self.last_speed_ns is None else (time_ns - self.last_speed_ns) / NS
        self.last_speed_ns = time_ns
        if speed > 0.0 and 0.0 < step_s <= LONGEST_STEP_S:
            if self.driven_s == 0.0:
                self.absent_since_ns = time_ns
            self.driven_s += step_s

    def trust(self, state: TrustState) -> None:
        """An anomaly: the receiver itself, or the other sensors, say that GNSS is falsified."""
        accused = state.gnss_excluded or any(
            monitor.monitor == EVIDENCE and monitor.outcome is Outcome.ACCUSES and "gnss" in monitor.accused
            for monitor in state.monitors
        )
        self.anomaly_ns = (self.anomaly_ns or state.suspect_since_ns or state.sampled_ns) if accused else None

    def clock(self, message: HostClock) -> None:
        """Compare the clock of the unit with the time of GNSS."""
        if self.utc_offset_ns is None:
            return
        difference_s = abs(message.utc_ns - message.sampled_ns - self.utc_offset_ns) / NS
        if difference_s > TIME_LIMIT_S:
            self.clock_ns = self.clock_ns or message.sampled_ns
            self.clock_difference_s = max(self.clock_difference_s or 0.0, difference_s)
        else:
            self.clock_ns = self.clock_difference_s = None

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
