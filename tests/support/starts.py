"""Starts of all kinds: a navigator that is switched on anywhere in a simulated drive, with any kind of receiver."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from math import inf

import numpy as np
import numpy.typing as npt

from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.solution import Solution
from services.sensors.simulator.drive import Drive, simulate
from services.sensors.simulator.imu_errors import MTI_630_ACCELEROMETER, MTI_630_GYROSCOPE, SensorErrors
from services.sensors.simulator.inertial import attitude_matrices, ideal_forces, ideal_rates, integrate_position
from services.sensors.simulator.trajectory import ROLL_STIFFNESS
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, wrap_angle

FloatArray = npt.NDArray[np.float64]

STEP_S = 0.01
FAST_M_S = 3.0
Leg = tuple[float, float, float]  # [s], [m/s²], [1/m]


@dataclass(frozen=True)
class Receiver:
    """What a receiver says, how often, and how well: white noise, and an error that lasts minutes, each 1 sigma."""

    rate_hz: int = 1
    velocity: bool = True
    white_m: float = 0.3
    lasting_m: float = 1.5
    velocity_sd_m_s: float = 0.05


@cache
def drive(scenario: str, seed: int, duration_s: float) -> Drive:
    """Simulate once for all starts."""
    return simulate(scenario, seed, duration_s=duration_s)


def manoeuvre(legs: tuple[Leg, ...], seed: int = 0, yaw: float = 0.0) -> Drive:
    """Drive legs of (duration [s], acceleration [m/s²], curvature [1/m]) from rest; a speed below zero is backwards."""
    durations, accelerations, curvatures = np.array(legs).T
    counts = np.round(durations / STEP_S).astype(int)
    speed = np.concatenate([[0.0], np.cumsum(np.repeat(accelerations, counts)) * STEP_S])
    curve = np.concatenate([[0.0], np.repeat(curvatures, counts)])
    smooth = np.ones(30) / 30.0  # nobody jerks so hard
    speed = np.convolve(np.pad(speed, 30, mode="edge"), smooth, mode="same")[30:-30]
    curve = np.convolve(np.pad(curve, 30, mode="edge"), smooth, mode="same")[30:-30]
    heading = yaw + np.cumsum(speed * curve) * STEP_S
    zero = np.zeros_like(speed)
    velocity = np.column_stack([speed * np.cos(heading), speed * np.sin(heading), zero])
    attitude = np.column_stack(
        [-ROLL_STIFFNESS * curve * speed**2, zero, np.remainder(heading + np.pi, 2 * np.pi) - np.pi]
    )
    matrices = attitude_matrices(attitude)
    model = drive("parking_lot", 1, 20.0)
    place = integrate_position(Geodetic(*model.position[0].tolist()), velocity, STEP_S)
    rate = ideal_rates(place, matrices, STEP_S)
    force = ideal_forces(place, velocity, matrices, rate, STEP_S)
    moving = np.abs(speed[1:]) > 0.01
    accelerometer = SensorErrors(MTI_630_ACCELEROMETER, STEP_S, (seed, 1))
    gyroscope = SensorErrors(MTI_630_GYROSCOPE, STEP_S, (seed, 2))
    return replace(
        model,
        t_ns=np.arange(1, len(speed)) * 10_000_000,
        position=place.position[1:],
        velocity_n=velocity[1:],
        attitude=attitude[1:],
        ideal_force_b=force,
        ideal_rate_b=rate,
        force_b=force + accelerometer.advance(moving),
        rate_b=rate + gyroscope.advance(moving),
    )


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
        made = Navigator(Settings.model_validate({"lever_arm_body_m": self.drive.lever_arm_b, **(settings or {})}))
        yield from self.lead(made, duration_s)

    def lead(self, made: Navigator, duration_s: float) -> Iterator[tuple[int, Navigator]]:
        """Lead a navigator on from there."""
        d, receiver, rng = self.drive, self.receiver, np.random.default_rng((self.seed, 77))
        first = round(self.at_s / STEP_S)
        every, wait = round(1.0 / (receiver.rate_hz * STEP_S)), round(self.first_fix_s / STEP_S)
        lasting = receiver.lasting_m * rng.standard_normal(3)
        for i in range(first, min(len(d.t_ns), first + round(duration_s / STEP_S))):
            if i % every == 0 and i - first >= wait:
                self._fix(made, i, rng, lasting)
            made.imu(int(d.t_ns[i]), d.force_b[i].tolist(), d.rate_b[i].tolist())
            yield i, made

    def _fix(self, made: Navigator, i: int, rng: np.random.Generator, lasting: FloatArray) -> None:
        d, receiver = self.drive, self.receiver
        C = attitude_matrices(d.attitude[i : i + 1])[0]
        error = lasting + receiver.white_m * rng.standard_normal(3)
        north, east, down = (C @ np.array(d.lever_arm_b) + error).tolist()
        swing = C @ np.cross(d.ideal_rate_b[i], d.lever_arm_b)
        vn, ve, vd = (d.velocity_n[i] + swing + receiver.velocity_sd_m_s * rng.standard_normal(3)).tolist()
        sd = float(np.hypot(receiver.white_m, receiver.lasting_m))
        made.fix(
            int(d.t_ns[i]),
            position=geodetic_from_ned_difference((north, east, down), Geodetic(*d.position[i].tolist())),
            velocity=(vn, ve, vd) if receiver.velocity else None,
            position_sd=(sd, sd, 1.5 * sd),
            velocity_sd=(receiver.velocity_sd_m_s,) * 3,
        )

    def yaw_error(self, i: int, solution: Solution) -> float:
        """Error of the heading at a sample [rad]."""
        return wrap_angle(solution.yaw - float(self.drive.attitude[i, 2]))

    def known_after_s(self, limit: float, duration_s: float) -> tuple[float, float, str]:
        """Time [s] from exceeding 3 m/s (with a fix) until the heading stays good, worst error 5 s after, and how."""
        fast_s, settled, worst, how = inf, inf, 0.0, ""
        fix_s = self.at_s + self.first_fix_s
        for i, made in self.run(duration_s):
            now_s = float(self.drive.t_ns[i]) * 1e-9
            if fast_s == inf and now_s >= fix_s and np.hypot(*self.drive.velocity_n[i, :2]) > FAST_M_S:
                fast_s = now_s
            solution = made.solution()
            error = abs(self.yaw_error(i, solution)) if solution else inf
            how = how or (made.reason if solution else "")
            settled = inf if error > limit else min(settled, now_s)
            if now_s >= fast_s + 5.0:
                worst = max(worst, error)
        return max(0.0, settled - fast_s) if settled < inf else inf, worst, how
