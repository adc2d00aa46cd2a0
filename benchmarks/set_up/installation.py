"""A random installation of a simulated vehicle, what its settings say of it, and how its drives disturb a survey."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import radians

import numpy as np

from services.core.fusion.set_up.survey.arcs import rotations, skews
from services.core.fusion.settings import Settings
from services.sensors.simulator.drive import STEP_NS, Drive, simulate
from services.sensors.simulator.imu.ideal_imu import attitude_matrices
from services.sensors.simulator.vehicle import LEVER_ARM_B
from shared.maths.earth import (
    FloatArray,
    Geodetic,
    geodetic_from_ned_difference,
    gravity,
    ned_from_geodetic_difference,
)
from shared.messages.base import Message
from shared.messages.gnss import CarrierSolution, FixType, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.vehicle import VehicleSpeed

BATCH = 10  # samples of a message
FLEX_S = 0.1  # time constant of a mount that gives way
DRIVE_S = 600.0
# Scenario and how it is driven. On a motorway there are no bends that show an arm: the driver did not do as told.
DRIVES = (
    "urban",
    "parking_lot",
    "urban",
    "parking_lot",
    "degraded",
    "urban",
    "parking_lot",
    "highway",
    "tunnel",
    "urban",
)


@dataclass(frozen=True)
class Installation:
    """How sensors are really mounted and stamped, and what disturbs the drives.

    Attributes
    ----------
    seed : int
    scenario : str
    mounting : ndarray, shape (3, 3)
        Columns are the vehicle's axes in those of the sensor.
    imu : ndarray, shape (3,)
        [m, body] From the middle of the rear axle to the IMU.
    arm : ndarray, shape (3,)
        [m, body] From the IMU to the antenna.
    delay_s, scale : float
        Age of fixes beyond their stamps, and indicated over true speed.
    flex : float
        [rad per m/s²] By which the mount gives way.
    vibration : tuple of float
        [m/s², rad/s] Standard deviation of samples.
    bank_rad : float
        Tilt of the whole ground, about a random direction.
    wind_up, slip : float
        Change of the scale as tyres warm up, and per m/s² of acceleration.
    believed_arm : ndarray, shape (3,)
        [m, body] As the settings have it; they know nothing of mounting, delay and scale.
    """

    seed: int
    scenario: str
    mounting: FloatArray
    imu: FloatArray
    arm: FloatArray
    delay_s: float
    scale: float
    flex: float
    vibration: tuple[float, float]
    bank_rad: float
    wind_up: float
    slip: float
    believed_arm: FloatArray

    @classmethod
    def random(cls, seed: int) -> "Installation":
        """One of a seed: half of the mounts at any angle, half askew by up to 40 degrees."""
        rng = np.random.default_rng((seed, 48))
        axis = rng.standard_normal(3)
        turn = axis / np.linalg.norm(axis) * (rng.uniform(0.0, np.pi) if seed % 2 else radians(rng.uniform(2.0, 40.0)))
        arm = np.array([rng.uniform(-1.5, 1.5), rng.uniform(-0.7, 0.7), rng.uniform(-1.6, -0.6)])
        return cls(
            seed=seed,
            scenario=DRIVES[seed % len(DRIVES)],
            mounting=rotations(turn),
            imu=np.array([rng.uniform(0.0, 1.8), rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.2)]),
            arm=arm,
            delay_s=rng.uniform(-0.1, 0.4),
            scale=rng.uniform(0.92, 1.08),
            flex=radians(rng.uniform(0.0, 0.3)),
            vibration=(rng.uniform(0.02, 0.4), rng.uniform(0.0005, 0.01)),
            bank_rad=radians(rng.uniform(0.0, 3.0)),
            wind_up=rng.uniform(0.0, 0.003),
            slip=rng.uniform(0.0, 0.01),
            believed_arm=arm + rng.uniform(-0.8, 0.8, 3) * np.array([1.0, 1.0, 0.2]),
        )

    @property
    def settings(self) -> Settings:
        """Of the filter at first."""
        return Settings().with_values(
            {
                "vehicle.imu.body_from_sensor": np.eye(3).tolist(),
                "vehicle.gnss.lever_arm_body_m": [round(float(value), 3) for value in self.believed_arm],
            }
        )

    def messages(self, settings: Settings, drive: int) -> Iterator[Message]:
        """Measurements of one of its drives, in the order of arrival, samples in the axes of the settings."""
        return _Drive(self, simulate(self.scenario, 100 * drive + self.seed, DRIVE_S), drive).messages(settings)


class _Drive:
    """A simulated drive, as this installation measures it."""

    def __init__(self, of: Installation, drive: Drive, number: int) -> None:
        self._of, self._drive = of, drive
        self._rng = np.random.default_rng((of.seed, number, 49))
        turn = self._rng.uniform(0.0, 2.0 * np.pi)
        self._ground = rotations(of.bank_rad * np.array([np.cos(turn), np.sin(turn), 0.0]))  # banked against level

    @cached_property
    def attitude(self) -> FloatArray:
        """Of the simulated vehicle on level ground, shape (n, 3, 3)."""
        return attitude_matrices(self._drive.attitude)

    def samples(self) -> tuple[FloatArray, FloatArray]:
        """Force [m/s²] and rate [rad/s] in the axes of the sensor, shape (n, 3) each."""
        of, step_s = self._of, STEP_NS * 1e-9
        level = np.array([0.0, 0.0, gravity(self._drive.position[0, 0], self._drive.position[0, 2])])
        force = self._drive.force_b + (level - self._ground.T @ level) @ self.attitude
        rate, exact = self._drive.rate_b, self._drive.ideal_rate_b
        change = np.gradient(exact, step_s, axis=0)
        force = force + np.cross(change, of.imu) + np.cross(exact, np.cross(exact, of.imu))
        pushed = self._drive.ideal_force_b.copy()
        pushed[:, 2] = 0.0
        give = of.flex * _lowpass(np.column_stack([-pushed[:, 1], pushed[:, 0], 0.0 * pushed[:, 0]]), FLEX_S / step_s)
        bent = np.eye(3) - skews(give)
        force = np.einsum("nij,nj->ni", bent, force)
        rate = np.einsum("nij,nj->ni", bent, rate) + np.gradient(give, step_s, axis=0)
        moving = (np.linalg.norm(self._drive.velocity_n, axis=1) > 0.1)[:, np.newaxis]
        force = force + moving * of.vibration[0] * self._rng.standard_normal(force.shape)
        rate = rate + moving * of.vibration[1] * self._rng.standard_normal(rate.shape)
        return force @ of.mounting.T, rate @ of.mounting.T

    def messages(self, settings: Settings) -> Iterator[Message]:
        """Fixes and speeds before the samples of their time."""
        published = np.array(settings.vehicle.imu.body_from_sensor)
        force, rate = (values @ published.T for values in self.samples())
        others = sorted([*self._fixes(), *self._speeds()], key=lambda message: message.received_ns)
        stamps, place = self._drive.t_ns.tolist(), 0
        for begin in range(0, len(stamps), BATCH):
            part = slice(begin, begin + BATCH)
            received_ns = stamps[part][-1]
            yield ImuSamples(
                received_ns=received_ns, source="imu", sampled_ns=tuple(stamps[part]),
                specific_force_body_m_s2=tuple(map(tuple, force[part].tolist())),
                angular_rate_body_rad_s=tuple(map(tuple, rate[part].tolist())),
            )  # fmt: skip
            while place < len(others) and others[place].received_ns <= received_ns:
                yield others[place]
                place += 1

    def _fixes(self) -> Iterator[GnssFix]:
        drive, of = self._drive, self._of
        start = Geodetic(*drive.position[0].tolist())
        for k in np.flatnonzero(drive.fix_valid).tolist():
            now = int(np.searchsorted(drive.t_ns, drive.fix_ns[k]))
            C, rate = self.attitude[now], drive.ideal_rate_b[now]
            moved = of.imu + of.arm - np.array(LEVER_ARM_B)  # the simulated IMU is above the rear axle
            level = np.array(ned_from_geodetic_difference(Geodetic(*drive.fix_position[k].tolist()), start))
            ned = self._ground @ (level + C @ moved)
            velocity = self._ground @ (drive.fix_velocity_n[k] + C @ np.cross(rate, moved))
            north, east, down = ned.tolist()
            place = geodetic_from_ned_difference((north, east, down), start)
            stamp_ns = int(drive.fix_ns[k]) + round(of.delay_s * 1e9)
            fixed = drive.fix_position_sd_n[k, 0] < 0.1
            yield GnssFix(
                sampled_ns=stamp_ns, received_ns=max(stamp_ns, int(drive.fix_ns[k])), source="gnss",
                fix_type=FixType.THREE_D,
                carrier_solution=CarrierSolution.FIXED if fixed else CarrierSolution.NONE,
                latitude_deg=float(np.degrees(place.latitude)), longitude_deg=float(np.degrees(place.longitude)),
                height_ellipsoid_m=place.height, velocity_ned_m_s=tuple(velocity.tolist()),
                position_sd_ned_m=tuple(drive.fix_position_sd_n[k].tolist()),
                velocity_sd_ned_m_s=tuple(drive.fix_velocity_sd_n[k].tolist()),
            )  # fmt: skip

    def _speeds(self) -> Iterator[VehicleSpeed]:
        of, drive = self._of, self._drive
        true = np.linalg.norm(drive.velocity_n, axis=1)
        at = np.searchsorted(drive.t_ns, drive.odometer_ns).clip(0, len(true) - 1)
        pushed = np.gradient(true, STEP_NS * 1e-9)[at]
        time_s = drive.odometer_ns * 1e-9
        factor = of.scale * (1.0 + of.wind_up * (1.0 - np.exp(-time_s / 200.0)) + of.slip * pushed)
        noise = 0.03 * self._rng.standard_normal(len(at))
        for stamp_ns, speed in zip(
            drive.odometer_ns.tolist(), (true[at] * factor + noise * (true[at] > 0.0)).tolist(), strict=True
        ):
            yield VehicleSpeed(sampled_ns=stamp_ns, received_ns=stamp_ns, source="can", speed_m_s=max(speed, 0.0))


def _lowpass(values: FloatArray, steps: float) -> FloatArray:
    """First-order low pass of a time constant in steps."""
    found, share, last = np.empty_like(values), 1.0 / (1.0 + steps), np.zeros(values.shape[1])
    for k, value in enumerate(values):
        last = last + share * (value - last)
        found[k] = last
    return found
