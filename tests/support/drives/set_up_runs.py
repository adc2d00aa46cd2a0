"""core.fusion over a simulated drive whose receiver resolves ambiguities, with faults of the set-up; its errors."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from services.core.fusion.process import Config, Process
from services.sensors.simulator.drive import Drive
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_track
from shared.messages.gnss import CarrierSolution, FixType, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import NavigationSolution, NavigationState, SetUpCheck, SetUpState, SetUpVerdict
from shared.runtime.config import GnssAntenna, Vehicle

FloatArray = npt.NDArray[np.float64]
RTK_SD = 0.02  # [m]
BATCH = 10  # samples of one message


@dataclass(frozen=True)
class SetUpRun:
    """Solutions against the truth at their stamps, and the last verdicts.

    Attributes
    ----------
    time_s, horizontal, vertical, level_h, level_v, yaw_error, yaw_sd : ndarray, shape (n,)
        [s], [m], [rad]
    checks : dict
        Newest result of each check.
    states : list of NavigationState
    lever_arm_found : list of float
        [s] When the check of the lever arm contradicted the settings.
    """

    time_s: FloatArray
    horizontal: FloatArray
    vertical: FloatArray
    level_h: FloatArray
    level_v: FloatArray
    yaw_error: FloatArray
    yaw_sd: FloatArray
    speed: FloatArray
    checks: dict[str, SetUpCheck]
    states: list[NavigationState]
    process: Process
    lever_arm_found: list[float]

    def above(self, after_s: float = 0.0) -> tuple[float, float]:
        """Shares of the horizontal and vertical errors that are above their levels, from a time after the start."""
        judged = self.time_s >= self.time_s[0] + after_s
        return (
            float((self.horizontal > self.level_h)[judged].mean()),
            float((self.vertical > self.level_v)[judged].mean()),
        )


def run(
    drive: Drive,
    settings: dict[str, object] | None = None,
    *,
    arm_error: tuple[float, float, float] = (0.0, 0.0, 0.0),
    late_s: float = 0.0,
    with_velocity: bool = True,
    rtk: bool = True,
    imu: FloatArray | None = None,
    height_sign: float = 1.0,
) -> SetUpRun:
    """Solve a drive message by message.

    Parameters
    ----------
    drive : Drive
        Simulated.
    settings : dict, optional
        Of core.fusion, by dotted keys; the lever arm is that of the drive.
    arm_error : tuple of float
        [m, body] By which the setting of the lever arm is off.
    late_s : float
        [s] By which all fixes are older than their stamps.
    with_velocity : bool
        Whether the receiver measures its velocity.
    rtk : bool
        Whether its ambiguities are resolved; otherwise its errors are those of the scenario.
    imu : ndarray, shape (3, 3), optional
        Published axes by those of the vehicle.
    height_sign : float
        Factor on the heights.
    """
    x, y, z = np.add(drive.lever_arm_b, arm_error).tolist()
    config = Config(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=(x, y, z))))
    if settings:
        config = config.with_values(settings)
    process = Process(config)
    turned = np.eye(3) if imu is None else imu
    force, rate = (drive.force_b @ turned.T).tolist(), (drive.rate_b @ turned.T).tolist()
    fixes = _fixes(drive, round(late_s * 1e9), with_velocity, rtk, height_sign)
    stamps = drive.t_ns.tolist()
    rows, states, checks, place = [], [], {}, 0
    lever_arm_found: list[float] = []
    for begin in range(0, len(stamps), BATCH):
        part = slice(begin, begin + BATCH)
        batch = ImuSamples(
            received_ns=stamps[part][-1] + 2_000_000,
            source="imu",
            sampled_ns=tuple(stamps[part]),
            specific_force_body_m_s2=tuple(map(tuple, force[part])),
            angular_rate_body_rad_s=tuple(map(tuple, rate[part])),
        )
        while place < len(fixes) and fixes[place].received_ns <= batch.received_ns:
            for answer in process.handle(fixes[place]):
                assert not isinstance(answer, NavigationSolution)
            place += 1
        for message in process.handle(batch):
            if isinstance(message, NavigationSolution):
                rows.append(_row(drive, message))
            elif isinstance(message, NavigationState):
                states.append(message)
            elif isinstance(message, SetUpState):
                checks = {check.name: check for check in message.checks}
                if checks["lever_arm"].verdict is SetUpVerdict.CONTRADICTS:
                    lever_arm_found.append(message.sampled_ns * 1e-9)
    time_s, horizontal, vertical, level_h, level_v, yaw_error, yaw_sd, speed = np.array(rows).T
    return SetUpRun(
        time_s,
        horizontal,
        vertical,
        level_h,
        level_v,
        yaw_error,
        yaw_sd,
        speed,
        checks,
        states,
        process,
        lever_arm_found,
    )


def _fixes(drive: Drive, late_ns: int, with_velocity: bool, rtk: bool, height_sign: float) -> list[GnssFix]:
    rng = np.random.default_rng((drive.seed, 17))
    found = []
    for k in np.flatnonzero(drive.fix_valid).tolist():
        place, sd = Geodetic(*drive.fix_position[k].tolist()), drive.fix_position_sd_n[k]
        if rtk:
            north, east, down = (RTK_SD * rng.standard_normal(3) - drive.fix_error_n[k]).tolist()
            place, sd = geodetic_from_ned_difference((north, east, down), place), np.full(3, RTK_SD)
        stamp = int(drive.fix_ns[k]) + late_ns
        found.append(
            GnssFix(
                sampled_ns=stamp,
                received_ns=stamp,
                source="gnss",
                fix_type=FixType.THREE_D,
                carrier_solution=CarrierSolution.FIXED if rtk else CarrierSolution.NONE,
                latitude_deg=float(np.degrees(place.latitude)),
                longitude_deg=float(np.degrees(place.longitude)),
                height_ellipsoid_m=height_sign * place.height,
                height_sign_assumed=height_sign < 0.0,
                velocity_ned_m_s=tuple(drive.fix_velocity_n[k].tolist()) if with_velocity else None,
                position_sd_ned_m=tuple(sd.tolist()),
                velocity_sd_ned_m_s=tuple(drive.fix_velocity_sd_n[k].tolist()) if with_velocity else None,
            )
        )
    return found


def _row(drive: Drive, solution: NavigationSolution) -> tuple[float, ...]:
    now = int(np.searchsorted(drive.t_ns, solution.sampled_ns))
    place = Geodetic(np.radians(solution.latitude_deg), np.radians(solution.longitude_deg), solution.height_ellipsoid_m)
    n, e, d = ned_track(np.array([place]), Geodetic(*drive.position[now].tolist()))[0].tolist()
    assert solution.protection_level_horizontal_m is not None and solution.protection_level_vertical_m is not None
    yaw = float(np.remainder(solution.yaw_rad - drive.attitude[now, 2] + np.pi, 2.0 * np.pi) - np.pi)
    return (
        solution.sampled_ns * 1e-9,
        float(np.hypot(n, e)),
        abs(d),
        solution.protection_level_horizontal_m,
        solution.protection_level_vertical_m,
        yaw,
        float(np.sqrt(solution.attitude_cov_ned_rad2[5])),
        float(np.hypot(*drive.velocity_n[now, :2])),
    )
