"""Rules that determine the operating mode and its reason from the facts; the first rule with a reason applies."""

from collections.abc import Callable
from dataclasses import dataclass

from shared.messages.navigation import NavigationPhase
from shared.messages.operation import Mode

BOOT_S = 1.0
IMU_SILENT_S = 3.0
GNSS_SILENT_S = 5.0
FIX_LOST_S = 2.0  # shorter than the time after which core.fusion reports coasting
SOLUTION_SILENT_S = 2.0
FUSION_SILENT_S = 10.0


@dataclass(frozen=True, slots=True)
class Facts:
    """The inputs of the mode decision; an age is None if no such message has been received."""

    uptime_s: float
    imu_age_s: float | None = None
    gnss_age_s: float | None = None  # of any message of a receiver
    fix_age_s: float | None = None  # of a fix with a position
    receiver: str | None = None  # what a receiver sends, by its bytes
    solution_age_s: float | None = None
    fusion_age_s: float | None = None  # of any message of core.fusion
    phase: NavigationPhase | None = None
    phase_reason: str = ""
    configuring: str | None = None  # request to a receiver in progress
    configuration_fault: str | None = None  # reason why the configuration failed
    has_measured: bool = False  # there has been a position

    @property
    def is_gnss_only(self) -> bool:
        """Whether fixes alone are published."""
        return self.phase is NavigationPhase.GNSS_ONLY and not _older(self.solution_age_s, SOLUTION_SILENT_S)


Rule = Callable[[Facts], str | None]

ALIGNING_REASONS = {
    NavigationPhase.WAITING_FOR_IMU: "waiting for inertial samples",
    NavigationPhase.LEVELLING: "stand still for a few seconds",
    NavigationPhase.WAITING_FOR_GNSS: "waiting for a GNSS fix: give the antenna a view of the sky",
    NavigationPhase.WAITING_FOR_HEADING: "waiting for the heading: drive straight ahead for a moment",
}


def decide(facts: Facts) -> tuple[Mode, str]:
    """Determine the mode and its reason."""
    for mode, rule in RULES:
        if reason := rule(facts):
            return mode, reason
    return Mode.ALIGNING, _aligning(facts)


def _measuring(facts: Facts) -> str | None:
    if facts.phase is not NavigationPhase.NAVIGATING or _older(facts.solution_age_s, SOLUTION_SILENT_S):
        return None
    return f"navigating{_not_configured(facts)}"


def _booting(facts: Facts) -> str | None:
    return "starting" if facts.uptime_s < BOOT_S and not facts.has_measured else None


def _detecting(facts: Facts) -> str | None:
    if facts.has_measured:
        return None
    heard = facts.gnss_age_s is not None or facts.receiver is not None
    missing = [name for name, there in (("IMU", facts.imu_age_s is not None), ("GNSS receiver", heard)) if not there]
    if not missing:
        return facts.receiver if facts.gnss_age_s is None and not facts.configuring else None
    text = f"no data from the {' and the '.join(missing)} yet: check its cable and its device in the vehicle file"
    return f"{text}; {facts.receiver}" if facts.receiver and facts.gnss_age_s is None else text


def _configuring(facts: Facts) -> str | None:
    return facts.configuring if not facts.has_measured else None


def _gnss_only(facts: Facts) -> str | None:
    """Reason while fixes alone are published."""
    if not facts.is_gnss_only:
        return None
    missing = f"no IMU samples{_for(facts.imu_age_s)}" if _older(facts.imu_age_s, IMU_SILENT_S) else "IMU not aligned"
    return f"position of GNSS alone: {missing}{_not_configured(facts)}"


def _no_imu(facts: Facts) -> str | None:
    if not _older(facts.imu_age_s, IMU_SILENT_S):
        return None
    gnss = f", and no GNSS fix{_for(facts.fix_age_s)}: no position" if _older(facts.fix_age_s, FIX_LOST_S) else ""
    return f"no IMU samples{_for(facts.imu_age_s)}{gnss}"


def _no_fusion(facts: Facts) -> str | None:
    age_s = facts.uptime_s if facts.fusion_age_s is None else min(facts.fusion_age_s, facts.uptime_s)
    if _older(age_s, FUSION_SILENT_S):
        return f"no message from core.fusion{_for(age_s)}"
    if facts.has_measured and facts.phase in SOLVING and _older(facts.solution_age_s, SOLUTION_SILENT_S):
        return f"no navigation solution{_for(facts.solution_age_s)}"
    return None


def _no_gnss(facts: Facts) -> str | None:
    """Reason for a loss of GNSS fixes or for coasting."""
    if not facts.has_measured:
        return None
    coasting = ": coasting" if facts.phase is NavigationPhase.COASTING else ""
    if _older(facts.gnss_age_s, GNSS_SILENT_S):
        return f"no data from the GNSS receiver{_for(facts.gnss_age_s)}{coasting}"
    if _older(facts.fix_age_s, FIX_LOST_S):
        return f"no GNSS fix{_for(facts.fix_age_s)}{coasting}"
    return f"coasting: {facts.phase_reason}" if coasting else None


def _aligning(facts: Facts) -> str:
    if facts.phase in ALIGNING_REASONS:
        return ALIGNING_REASONS[facts.phase]
    return "waiting for the navigation filter"


def _not_configured(facts: Facts) -> str:
    return f"; receiver not configured: {facts.configuration_fault}" if facts.configuration_fault else ""


def _older(age_s: float | None, limit_s: float) -> bool:
    return age_s is None or age_s > limit_s


def _for(age_s: float | None) -> str:
    return "" if age_s is None else f" for {age_s:.0f} s"


SOLVING = (NavigationPhase.NAVIGATING, NavigationPhase.COASTING, NavigationPhase.GNSS_ONLY)
# SHUTTING_DOWN has no rule: the process publishes it on a stop request, and when the battery is nearly empty.
RULES: tuple[tuple[Mode, Rule], ...] = (
    (Mode.MEASURING, _measuring),
    (Mode.BOOT, _booting),
    (Mode.DEGRADED, _gnss_only),
    (Mode.DETECTING, _detecting),
    # Root cause first: without an IMU there is no solution either.
    (Mode.DEGRADED, _no_imu),
    (Mode.CONFIGURING, _configuring),
    (Mode.DEGRADED, _no_fusion),
    (Mode.DEGRADED, _no_gnss),
)
