"""What a unit publishes while a sensor is missing: the rows of docs/reference/missing-sensors.md."""

from dataclasses import dataclass

from .messages.navigation import NavigationPhase
from .messages.trust import TrustLevel

NO_INERTIAL_UNIT = "trust.no_inertial_unit"
NO_GNSS_YET = "trust.no_gnss_yet"
SOLUTION_OLD = "trust.solution_old"


@dataclass(frozen=True)
class MissingSensors:
    """One combination of sensors that are missing."""

    sensors: str
    published: str
    uncertainty: str  # covariance and protection level
    phases: tuple[NavigationPhase, ...]  # of `navigation/state`
    verdicts: tuple[TrustLevel, ...]  # in the order in which they follow
    code: str  # of the first reason of the last verdict
    cost: str


MISSING_COMBINATIONS = (
    MissingSensors(
        "none", "position, velocity and attitude, ten times a second", "of the filter",
        (NavigationPhase.NAVIGATING,), (TrustLevel.SAFE,), "trust.safe", "nothing",
    ),
    MissingSensors(
        "CAN (odometer, wheel speeds)", "the same", "of the filter; without GNSS it grows faster",
        (NavigationPhase.NAVIGATING,), (TrustLevel.SAFE, TrustLevel.CAUTION), "trust.safe",
        "`motion` and `motion_fast` are not evaluated; of GNSS and inertial sensors that contradict each other it "
        "cannot be said which is wrong",
    ),
    MissingSensors(
        "IMU: none received for 5 s after the first fix, or silent for more than 1 s",
        "each fix at its own stamp: position and velocity of GNSS, course as heading; roll, pitch, rates and biases "
        "are zero and not measured",
        "of the receiver, times the learned scale of its errors where that is above 1; heading as of the course, "
        "unknown before the first motion",
        (NavigationPhase.GNSS_ONLY,), (TrustLevel.CAUTION,), NO_INERTIAL_UNIT,
        "no position between fixes or in a tunnel; nothing is compared with GNSS; CAM without yaw rate and curvature",
    ),
    MissingSensors(
        "IMU for up to 25 s, then received again",
        "fixes as above, then the filter at the newest fix with the kept heading (followed by the course of GNSS) and "
        "biases",
        "heading as of the course, or worse with the distance driven; tilt within 0.05 rad; biases by their random "
        "walk",
        (NavigationPhase.GNSS_ONLY, NavigationPhase.NAVIGATING), (TrustLevel.CAUTION, TrustLevel.SAFE),
        NO_INERTIAL_UNIT,
        "the same for that time; after a longer gap the filter is aligned anew, and fixes are published until then",
    ),
    MissingSensors(
        "GNSS, from the start on",
        "nothing; after 30 s (`alignment.without_gnss_s`) dead reckoning from the saved position, if the vehicle was "
        "parked there and has not moved since",
        "of the saved position and heading, growing by the inertial sensors and the odometer",
        (NavigationPhase.WAITING_FOR_GNSS, NavigationPhase.COASTING),
        (TrustLevel.INITIALISING, TrustLevel.DEAD_RECKONING), NO_GNSS_YET,
        "no start on the move; a vehicle that was towed while switched off is not noticed before the first fix",
    ),
    MissingSensors(
        "GNSS, lost on the way", "dead reckoning", "growing by the inertial sensors and the odometer",
        (NavigationPhase.COASTING,), (TrustLevel.DEAD_RECKONING, TrustLevel.UNSAFE), "trust.gnss_missing",
        "above the alert limit the verdict is UNSAFE",
    ),
    MissingSensors(
        "IMU and GNSS", "nothing", "none", (NavigationPhase.WAITING_FOR_IMU, NavigationPhase.GNSS_ONLY),
        (TrustLevel.NO_FIX,), SOLUTION_OLD, "everything; the odometer alone gives no position",
    ),
    MissingSensors(
        "IMU, while GNSS is excluded by `core.trust`", "nothing", "none", (NavigationPhase.WAITING_FOR_IMU,),
        (TrustLevel.NO_FIX,), SOLUTION_OLD, "dead reckoning needs inertial samples",
    ),
)  # fmt: skip
