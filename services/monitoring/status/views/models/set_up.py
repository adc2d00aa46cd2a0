"""The set-up of the unit, step by step."""

from enum import StrEnum

from typing_extensions import TypedDict

from shared.page.answers import Object, Stamp, answer


class StepState(StrEnum):
    """How far a step of the set-up is."""

    NOT_DONE = "not_done"
    MEASURING = "measuring"
    AGREES = "agrees"
    CONTRADICTS = "contradicts"


@answer()
class StepShown(TypedDict):
    """One step."""

    name: str
    state: StepState
    confirmed_ns: Stamp | None
    """when somebody confirmed what cannot be measured"""


@answer()
class DeviceShown(TypedDict):
    """One kind of bytes of a device: whether they come, and what was found at its port."""

    topic: str
    process: str
    rate_hz: float
    fresh: bool
    age_s: float | None
    port: Object | None
    """newest `device/state` of its driver"""
    kinds: list[str]
    """messages that its parser has recognised"""


@answer()
class LevelShown(TypedDict):
    """The IMU while the page looks at it."""

    roll_deg: float
    pitch_deg: float
    force_m_s2: float
    still: bool
    seconds: float
    """length of the samples that the noise is of"""
    force_noise: float | None
    """velocity random walk [m/s/√s]"""
    rate_noise: float | None
    """angle random walk [rad/√s]"""
    grade: str | None
    """proposed for `core.spoofing.grade`"""


@answer()
class SurveyShown(TypedDict):
    """What the newest drive has shown, and the job that computes it."""

    running: bool
    comparing: bool
    """the job solves the drive with the settings as they are and as proposed as well"""
    failed: bool
    result: Object | None
    """as `obu set-up --json` prints it"""
    applied: list[str]
    """quantities whose proposed settings hold by now"""
    recording: str | None
    """that the next job reads"""


@answer()
class SignalShown(TypedDict):
    """A speed of the vehicle's network against that of GNSS."""

    topic: str
    rate_hz: float
    speed_m_s: float | None
    gnss_m_s: float | None
    ratio: float | None
    """mean over the drive"""
    correlation: float | None


@answer()
class SetUpReport(TypedDict):
    """The set-up of this unit."""

    now_ns: Stamp
    steps: list[StepShown]
    speed_m_s: float | None
    moving: bool
    """faster than 5 km/h: only the drive is to be shown"""
    devices: list[DeviceShown]
    level: LevelShown | None
    signals: list[SignalShown]
    corrections: Object | None
    receiver: Object | None
    """newest `gnss/configuration`, or what it sends"""
    values: dict[str, str]
    """settings that the steps are about, as JSON"""
    sets: list[Object]
    """sets of hardware to begin with: name, what they are, and the settings they bring"""
    survey: SurveyShown
