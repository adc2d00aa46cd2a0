"""Starts of all kinds: a navigator that is switched on anywhere in a simulated drive, with any kind of receiver."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from math import atan2, degrees, hypot, inf

import numpy as np
import numpy.typing as npt

from services.core.fusion.aids.kinds import measurements_of
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.solution import Solution
from services.sensors.simulator.drive import Drive, simulate
from services.sensors.simulator.imu.ideal_imu import attitude_matrices
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, wrap_angle
from shared.messages.gnss import FixType, GnssFix

FloatArray = npt.NDArray[np.float64]

STEP_S = 0.01
HIGH_SPEED_M_S = 3.0


@dataclass(frozen=True)
class Receiver:
    """What a receiver says, how often, and how well: white noise and an error correlated over minutes (1 sigma)."""

    rate_hz: int = 1
    velocity: bool = True  # or else, with a course,
    course: bool = False  # ground speed and course, as NMEA has them
    white_m: float = 0.3
    correlated_m: float = 1.5
    velocity_sd_m_s: float = 0.05


@cache
def drive(scenario: str, seed: int, duration_s: float) -> Drive:
    """Simulate once for all starts."""
    return simulate(scenario, seed, duration_s=duration_s)


@dataclass(frozen=True)
class Start:
    """Switch-on at a time of a drive; the receiver has its first fix some time later."""

    drive: Drive
    receiver: Receiver
    at_s: float
    first_fix_s: float
    seed: int

    def run(self, duration_s: float, settings: dict[str, object] | None = None) -> Iterator[tuple[int, Navigator]]:
        """Lead a new navigator on from there; after each sample its number and the navigator."""
        made = Navigator(
            Settings().with_values({"vehicle.gnss.lever_arm_body_m": self.drive.lever_arm_b, **(settings or {})})
        )
        yield from self.lead(made, duration_s)

    def lead(self, made: Navigator, duration_s: float, until_s: float = inf) -> Iterator[tuple[int, Navigator]]:
        """Lead a navigator on from there, with fixes until a time of the drive."""
        d, receiver, rng = self.drive, self.receiver, np.random.default_rng((self.seed, 77))
        first = round(self.at_s / STEP_S)
        every, wait = round(1.0 / (receiver.rate_hz * STEP_S)), round(self.first_fix_s / STEP_S)
        correlated = receiver.correlated_m * rng.standard_normal(3)
        for i in range(first, min(len(d.t_ns), first + round(duration_s / STEP_S))):
            if i % every == 0 and i - first >= wait and i * STEP_S < until_s:
                self._fix(made, i, rng, correlated)
            made.imu(int(d.t_ns[i]), d.force_b[i].tolist(), d.rate_b[i].tolist())
            yield i, made

    def _fix(self, made: Navigator, i: int, rng: np.random.Generator, correlated: FloatArray) -> None:
        d, receiver = self.drive, self.receiver
        C = attitude_matrices(d.attitude[i : i + 1])[0]
        error = correlated + receiver.white_m * rng.standard_normal(3)
        north, east, down = (C @ np.array(d.lever_arm_b) + error).tolist()
        swing = C @ np.cross(d.ideal_rate_b[i], d.lever_arm_b)
        vn, ve, vd = (d.velocity_n[i] + swing + receiver.velocity_sd_m_s * rng.standard_normal(3)).tolist()
        sd = float(np.hypot(receiver.white_m, receiver.correlated_m))
        latitude, longitude, height = geodetic_from_ned_difference(
            (north, east, down), Geodetic(*d.position[i].tolist())
        )
        message = GnssFix(
            sampled_ns=int(d.t_ns[i]),
            received_ns=int(d.t_ns[i]),
            source="gnss",
            fix_type=FixType.THREE_D,
            latitude_deg=degrees(latitude),
            longitude_deg=degrees(longitude),
            height_ellipsoid_m=height,
            position_sd_ned_m=(sd, sd, 1.5 * sd),
        )
        if receiver.velocity:
            sds = (receiver.velocity_sd_m_s,) * 3
            message = message.model_copy(update={"velocity_ned_m_s": (vn, ve, vd), "velocity_sd_ned_m_s": sds})
        elif receiver.course:
            message = message.model_copy(update={"ground_speed_m_s": hypot(vn, ve), "course_rad": atan2(ve, vn)})
        for measurement in measurements_of(message, made.settings):
            made.measure(measurement)

    def yaw_error(self, i: int, solution: Solution) -> float:
        """Error of the heading at a sample [rad]."""
        return wrap_angle(solution.yaw - float(self.drive.attitude[i, 2]))

    def known_after_s(
        self, limit: float, duration_s: float, settings: dict[str, object] | None = None
    ) -> tuple[float, float, str]:
        """Time [s] from exceeding 3 m/s (with a fix) until the heading stays good, worst error 5 s after, and how."""
        fast_s, settled, worst, how = inf, inf, 0.0, ""
        fix_s = self.at_s + self.first_fix_s
        for i, made in self.run(duration_s, settings):
            now_s = float(self.drive.t_ns[i]) * 1e-9
            if fast_s == inf and now_s >= fix_s and np.hypot(*self.drive.velocity_n[i, :2]) > HIGH_SPEED_M_S:
                fast_s = now_s
            solution = made.solution()
            error = abs(self.yaw_error(i, solution)) if solution else inf
            how = how or (str(made.why[0].values.get("method", made.why[0].code)) if solution else "")
            settled = inf if error > limit else min(settled, now_s)
            if solution and now_s >= fast_s + 5.0:
                worst = max(worst, error)
        return max(0.0, settled - fast_s) if settled < inf else inf, worst, how
