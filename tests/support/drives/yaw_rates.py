"""A level drive with bends for the monitor of the gyroscope: increments, wheel speeds, fixes and solutions."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import cos, hypot, radians, sin

import numpy as np

from services.core.spoofing.grade import Grade
from services.core.spoofing.gyroscope.monitor import GyroscopeMonitor
from services.core.spoofing.process import Config
from services.core.spoofing.settings import Settings
from shared.inertial.increments import Increment
from shared.messages.gnss import FixType, GnssFix
from shared.messages.navigation import NavigationPhase, NavigationSolution
from shared.messages.trust import Outcome
from shared.messages.vehicle import WheelSpeeds
from shared.trust.result import Test

NS = 1_000_000_000
STEP_NS = NS // 10
TRACK_M = 1.5
BIAS = radians(0.3)  # [rad/s] of the gyroscope's z axis, which the filter knows
INDUSTRIAL: Settings = Config(grade=Grade.INDUSTRIAL)
Profile = Callable[[float], float]


@dataclass
class Run:
    """What the monitor said once a second."""

    monitor: GyroscopeMonitor
    verdicts: list[Mapping[str, Test]] = field(default_factory=list)

    def accusing(self, second: int) -> set[tuple[str, ...]]:
        """Names by the windows that accuse after a number of seconds."""
        found = self.verdicts[second - 1].values()
        return {test.accused for test in found if test.outcome is Outcome.ACCUSES}

    def first(self, after: int = 0) -> int | None:
        """First second of an accusation after a time."""
        return next((k for k in range(after + 1, len(self.verdicts) + 1) if self.accusing(k)), None)

    def names(self, after: int = 0) -> set[tuple[str, ...]]:
        """All names after a time."""
        return set().union(*(self.accusing(k) for k in range(after + 1, len(self.verdicts) + 1)))


def town(t: float) -> float:
    """Yaw rate [rad/s] with a bend to either side every 40 s."""
    return radians(15.0) * (1.0 if t % 80.0 < 40.0 else -1.0) if 20.0 <= t % 40.0 < 25.0 else 0.0


def nothing(_: float) -> float:
    """No error."""
    return 0.0


def unchanged(_: float) -> float:
    """Factor of nothing."""
    return 1.0


def steady(_: float) -> float:
    """Speed [m/s] in town."""
    return 12.0


def learned(_: float) -> float:
    """Bias as it is."""
    return BIAS


@dataclass
class Faults:
    """Errors as functions of time [s], from when they begin."""

    rate: Profile = nothing  # [rad/s] of the gyroscope
    course: Profile = nothing  # [rad] of the GNSS velocity
    left: Profile = unchanged  # factor on the left wheels
    known: Profile = learned  # [rad/s] the filter's estimate of the gyroscope's bias
    wheels: bool = True
    antenna: bool = False


def driven(
    seconds: int, faults: Faults | None = None, *, speed: Profile = steady, turn: Profile = town, seed: int = 1
) -> Run:
    """Drive for some seconds."""
    faults, rng = faults or Faults(), np.random.default_rng(seed)
    run = Run(GyroscopeMonitor(INDUSTRIAL, Counter()))
    yaw, pending = 0.0, []
    for k in range(1, 10 * seconds + 1):
        t, time_ns = 0.1 * k, k * STEP_NS
        v = speed(t)
        w = turn(t) if v > 0.0 else 0.0
        yaw += 0.1 * w
        rate = w + BIAS + faults.rate(t) + 1e-3 * float(rng.normal())
        pending.append(Increment(time_ns - STEP_NS, time_ns, (0.0, 0.0, -9.8, 0.0, 0.0, rate, 0.1), 0.0, k == 1))
        if faults.wheels:
            run.monitor.speeds(wheels_of(time_ns, v, w, faults.left(t), rng))
        if k % 10 == 0:
            run.monitor.solution(solution_of(time_ns, faults.known(t), stationary=v == 0.0))
            fix = fix_of(time_ns, v, yaw + faults.course(t), rng, heading=yaw if faults.antenna else None)
            run.monitor.fix(fix, fix.velocity_ned_m_s, fix.velocity_sd_ned_m_s)
            run.verdicts.append(dict(run.monitor.verdicts(time_ns, pending)))
            pending = []
    return run


def wheels_of(time_ns: int, v: float, w: float, left: float, rng: np.random.Generator) -> WheelSpeeds:
    """Wheel speeds in steps of 0.01 km/h with 0.02 m/s of noise; the left ones are 0.3 % larger."""
    half, noise = 0.5 * TRACK_M * w, 0.02 if v > 0.0 else 0.0
    sides = [v + half, v - half]
    true = np.array([*sides, *(hypot(side, 2.7 * w) for side in sides)])
    scale = np.array([1.003 * left, 1.0, 1.003 * left, 1.0])
    rl, rr, fl, fr = np.round((true * scale + noise * rng.normal(size=4)) * 360.0).clip(0.0) / 360.0
    return WheelSpeeds(
        sampled_ns=time_ns, received_ns=time_ns, source="can0", rear_left_m_s=rl, rear_right_m_s=rr,
        front_left_m_s=fl, front_right_m_s=fr,
    )  # fmt: skip


def fix_of(time_ns: int, v: float, course: float, rng: np.random.Generator, *, heading: float | None = None) -> GnssFix:
    """Fix with a velocity along a course, with 0.05 m/s of noise an axis."""
    north, east = v * cos(course) + 0.05 * float(rng.normal()), v * sin(course) + 0.05 * float(rng.normal())
    baseline = None if heading is None else (heading + radians(0.2) * float(rng.normal())) % (2.0 * np.pi)
    return GnssFix(
        sampled_ns=time_ns, received_ns=time_ns, source="gnss0", fix_type=FixType.THREE_D, latitude_deg=0.0,
        longitude_deg=0.0, height_ellipsoid_m=0.0, velocity_ned_m_s=(north, east, 0.0),
        velocity_sd_ned_m_s=(0.05, 0.05, 0.08), baseline_heading_rad=baseline,
        baseline_heading_sd_rad=None if heading is None else radians(0.2),
    )  # fmt: skip


def solution_of(time_ns: int, bias: float, *, stationary: bool) -> NavigationSolution:
    """Solution at the equator, where the Earth turns about no vertical axis."""
    return NavigationSolution(
        sampled_ns=time_ns, phase=NavigationPhase.NAVIGATING, latitude_deg=0.0, longitude_deg=0.0,
        height_ellipsoid_m=0.0, velocity_ned_m_s=(0.0, 0.0, 0.0), roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0,
        position_cov_ned_m2=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0), velocity_cov_ned_m2_s2=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0),
        attitude_cov_ned_rad2=(1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6), angular_rate_body_rad_s=(0.0, 0.0, 0.0),
        accelerometer_bias_m_s2=(0.0, 0.0, 0.0), gyroscope_bias_rad_s=(0.0, 0.0, bias), stationary=stationary,
        gyroscope_bias_sd_rad_s=(3e-5, 3e-5, 3e-5),
    )  # fmt: skip
