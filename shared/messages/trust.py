"""Statements of the integrity monitors, and the verdict that `core.trust` makes of them."""

from enum import StrEnum
from typing import Annotated

from pydantic import Field, model_validator

from .base import (
    Count,
    Deviation,
    Height,
    Latitude,
    Longitude,
    Message,
    Name,
    Nanoseconds,
    Persistent,
    Ratio,
    Reason,
    Seconds,
    Statistic,
    Symmetric3,
    Vector3,
    Velocity3,
    unit,
)
from .explanation import Explanation, Explanations

Sigma = Annotated[float, Field(gt=0.0, le=1e6), unit("of the metric: rad/s, m/s2, m/s")]


OMITTED_IF_EMPTY = Field(
    exclude_if=lambda value: not value
)  # is not encoded: tests are half of the traffic of a verdict


class Outcome(StrEnum):
    """Result of a test or of a monitor: "not evaluated" is neither passed nor failed."""

    PASS = "pass"
    ACCUSES = "accuses"
    NOT_EVALUATED = "not_evaluated"


class MonitorTest(Message):
    """One test of a monitor: it accuses when the statistic is greater than the threshold."""

    name: Name
    outcome: Outcome
    reason: Annotated[Reason, OMITTED_IF_EMPTY] = ""  # for people, where there is no code
    reason_code: Explanation | None = None
    statistic: Annotated[Statistic, unit("of the test")] | None = None
    threshold: Annotated[Statistic, unit("of the test")] | None = None
    unit: Annotated[Name, Field(exclude_if=lambda value: value == "-")] = "-"
    false_alarm_rate: Ratio | None = None  # by design, of one evaluation; None where a rule fixes the threshold
    window_s: Seconds | None = None
    since_ns: Nanoseconds | None = None  # when this outcome was reached


class TrustMonitor(Message):
    """Latest result of one integrity monitor, with the tests behind it."""

    sampled_ns: Nanoseconds
    monitor: Name
    outcome: Outcome
    reason: Reason
    reason_code: Explanation | None = None  # of `reason`, where the monitor has codes
    accused: Annotated[
        tuple[Name, ...], OMITTED_IF_EMPTY
    ] = ()  # gnss, odometer, the ID of a satellite or of a neighbour
    suspect_since_ns: Nanoseconds | None = None  # earliest time from which the evidence may be wrong
    doubtful: Annotated[bool, OMITTED_IF_EMPTY] = False  # near its limit, or a question: the position deserves caution
    since_ns: Nanoseconds | None = None  # when this outcome was reached
    statistic: Annotated[Statistic, unit("of the test")] | None = None
    threshold: Annotated[Statistic, unit("of the test")] | None = None
    false_alarm_rate: Ratio | None = None
    window_s: Seconds | None = None
    tests: Annotated[tuple[MonitorTest, ...], OMITTED_IF_EMPTY] = ()


class LearnedGrade(Message):
    """What a vehicle's own drives have taught about its IMU and receiver, for the next start of core.spoofing.

    Each metric has standard deviations for four classes of dynamics.
    """

    sampled_ns: Nanoseconds
    imu: Name  # source of the inertial samples
    gnss: Name  # source of the fixes
    imu_rate_hz: Annotated[float, Field(gt=0.0, le=1e5)]
    gnss_rate_hz: Annotated[float, Field(gt=0.0, le=1e3)]
    configuration: Name  # digest of the settings that the metrics depend on
    windows: Count  # of 5 s, one a second
    metrics: Annotated[tuple[Name, ...], Field(max_length=16)]
    sigma: Annotated[tuple[tuple[Sigma, Sigma, Sigma, Sigma], ...], Field(max_length=16)]  # of each metric
    threshold: Annotated[float, Field(gt=0.0, le=100.0), unit("standard deviations")]
    # on the standard deviation of the free propagations
    long_factor: Annotated[float, Field(ge=1.0, le=100.0), unit("1")]
    false_alarm_rate: Annotated[float, Field(ge=0.0, le=1.0), unit("1")]

    @model_validator(mode="after")
    def _complete(self) -> "LearnedGrade":
        if len(self.metrics) != len(self.sigma) or len(set(self.metrics)) != len(self.metrics):
            raise ValueError("each metric needs its own standard deviations")
        return self


Scale = Annotated[float, Field(ge=0.5, le=1.5), unit("1")]


class LearnedScale(Message):
    """What a vehicle's own drives have taught about the scale of its inertial sensors, for core.motion_conflict.

    Scale is the indicated speed over the centripetal speed of accelerometer and gyroscope, over bends.
    """

    sampled_ns: Nanoseconds
    imu: Name  # source of the inertial samples
    bends: Count
    gnss: Scale
    gnss_sd: Annotated[float, Field(gt=0.0, le=0.5), unit("1")]
    odometer: Scale | None = None
    spread: Annotated[float, Field(gt=0.0, le=100.0), unit("1")] = 1.0  # of bends, measured over stated


class TrustLevel(StrEnum):
    """Whether the position can be used."""

    SAFE = "safe"
    CAUTION = "caution"
    UNSAFE = "unsafe"
    DEAD_RECKONING = "dead_reckoning"
    NO_FIX = "no_fix"
    INITIALISING = "initialising"


class Hypothesis(StrEnum):
    """What may be wrong."""

    NOTHING = "nothing"
    GNSS = "gnss"
    IMU = "imu"
    ODOMETER = "odometer"
    GNSS_AND_ODOMETER = "gnss_and_odometer"  # both falsified alike
    RECEIVER_TIME = "receiver_time"
    SATELLITES = "satellites"  # one, or a group


Probability = Annotated[float, Field(ge=0.0, le=1.0), unit("1")]


class HypothesisSolution(Message):
    """Position under one hypothesis: that of the vehicle without the sources that would be wrong."""

    hypothesis: Hypothesis
    left_out: Annotated[tuple[Name, ...], Field(max_length=64)]  # gnss, imu, odometer, or IDs of satellites
    since_ns: Nanoseconds  # since when they are left out
    latitude_deg: Latitude
    longitude_deg: Longitude
    height_ellipsoid_m: Height
    velocity_ned_m_s: Velocity3
    position_cov_ned_m2: Symmetric3
    protection_level_horizontal_m: Deviation
    protection_level_vertical_m: Deviation
    apart_ned_m: Vector3  # published position minus this one
    # Of the horizontal difference against its covariance, chi-square without a fault: two degrees of freedom, one where
    # a single satellite is left out; the limit is that of its own.
    separation: Annotated[Statistic, unit("1")] | None = None
    separation_limit: Annotated[Statistic, unit("1")] | None = None
    # mean of its normalised innovations squared, over the last of them, and its expected value without a fault
    innovations: Annotated[Statistic, unit("1")] | None = None
    odometer_innovations: Annotated[Statistic, unit("1")] | None = None  # the same of the odometer, used or not


class TrustHypotheses(Message):
    """Solutions under every hypothesis that a process keeps, once a second."""

    sampled_ns: Nanoseconds
    source: Name  # process
    solutions: Annotated[tuple[HypothesisSolution, ...], Field(max_length=64)] = ()
    # why a hypothesis has no solution now; `missing` has the texts, for people
    missing_codes: Annotated[tuple[tuple[Hypothesis, Explanation], ...], Field(max_length=16)] = ()
    missing: Annotated[tuple[tuple[Hypothesis, Reason], ...], Field(max_length=16)] = ()


class Belief(Message):
    """How probable a hypothesis is, and what follows from it."""

    hypothesis: Hypothesis
    prior: Probability
    probability: Probability
    survives: bool  # above the integrity risk: the level reaches to its solution
    acted_on: bool = False  # it alone survives: its source is not used
    reason: Reason  # what speaks for it and against it
    reason_code: Explanation | None = None  # of `reason`, which is for people
    since_ns: Nanoseconds | None = None  # suspect time, while something speaks for it
    distance_m: Deviation | None = None  # horizontal, of the published position from its solution
    level_m: Deviation | None = None  # horizontal protection level of its solution


class TrustState(Message):
    """The verdict on the position, with its reasons and the statement of every monitor."""

    sampled_ns: Nanoseconds
    state: TrustLevel
    since_ns: Nanoseconds
    row: Count  # of the verdict table that decided
    reasons: tuple[Reason, ...]  # that of the deciding row first
    findings: tuple[Reason, ...] = ()  # accused or excluded sources that do not lower the verdict
    reason_codes: Explanations = ()  # of `reasons`, one each; those are for people
    finding_codes: Explanations = ()  # of `findings`, one each
    gnss_excluded: bool = False  # decided by a third source
    suspect_since_ns: Nanoseconds | None = None  # while GNSS is in conflict with other sensors, excluded or not
    # last position before a loss of GNSS with interference, until displacement has agreed with its return
    gnss_disturbed_since_ns: Nanoseconds | None = None
    odometer_excluded: bool = False
    imu_excluded: bool = False
    beliefs: Annotated[tuple[Belief, ...], Field(max_length=16)] = ()  # most probable first
    protection_level_horizontal_m: Deviation | None = None
    protection_level_vertical_m: Deviation | None = None
    alert_limit_horizontal_m: Deviation
    alert_limit_vertical_m: Deviation
    monitors: tuple[TrustMonitor, ...] = ()


class TrustEvent(Message):
    """A change of the verdict, with the evidence at that time."""

    sampled_ns: Nanoseconds
    before: TrustLevel
    after: TrustLevel
    reasons: tuple[Reason, ...]
    reason_codes: Explanations = ()  # of `reasons`, one each
    monitors: tuple[TrustMonitor, ...] = ()


class TrustedPosition(Message):
    """The newest position whose verdict was SAFE."""

    sampled_ns: Nanoseconds
    latitude_deg: Latitude
    longitude_deg: Longitude
    height_ellipsoid_m: Height
    protection_level_horizontal_m: Deviation
    protection_level_vertical_m: Deviation


class TrustRecord(Persistent):
    """What core.trust believes and what is open, for its next process, also after a power cut."""

    sampled_ns: Nanoseconds
    ended_in_order: bool = False  # the last one of a process that was stopped
    moving: bool = True  # the vehicle was not at standstill
    confirmed_ns: Nanoseconds | None = None  # when a long inertial window has last passed
    suspect_since_ns: Nanoseconds | None = None  # of GNSS, while it is in conflict
    imu_suspect_since_ns: Nanoseconds | None = None
    alike_since_ns: Nanoseconds | None = None  # GNSS and odometer falsified alike
    disturbed_since_ns: Nanoseconds | None = None  # last position before a loss with interference
    odometer_excluded: bool = False
    beliefs: Annotated[tuple[Belief, ...], Field(max_length=16)] = ()  # of hypotheses that survive
    trusted: TrustedPosition | None = None
