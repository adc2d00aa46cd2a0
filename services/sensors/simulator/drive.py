"""A whole drive as arrays, for research: `simulate("parking_lot", seed=1)`."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .gnss.reception import Reception
from .scenarios import Scenario, scenario_of
from .vehicle import LEVER_ARM_B, Stream, Vector, Vehicle, antenna_at

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

STEP_NS = 10_000_000
EPOCH_NS = 1_000_000_000
ODOMETER_NS = 100_000_000
ODOMETER_SD = 0.03  # [m/s]
ODOMETER_SCALE_SD = 0.005  # [-]


@dataclass(frozen=True)
class Drive:
    """The truth and all measurements of one drive; body axes are forward, right, down, the reference point is the IMU.

    Inertial sample k is the mean over the step that ends at `t_ns[k]`. The drive begins at standstill, so the
    position at time zero equals the position at `t_ns[0]`.
    """

    scenario: Scenario
    seed: int
    lever_arm_b: Vector  # [m, body] from the IMU to the antenna
    # n inertial samples
    t_ns: IntArray  # shape (n,)
    position: FloatArray  # shape (n, 3) [rad, rad, m] true latitude, longitude, ellipsoidal height
    velocity_n: FloatArray  # shape (n, 3) [m/s, NED] true
    attitude: FloatArray  # shape (n, 3) [rad] true roll, pitch, yaw
    ideal_force_b: FloatArray  # shape (n, 3) [m/s²]
    ideal_rate_b: FloatArray  # shape (n, 3) [rad/s]
    force_b: FloatArray  # shape (n, 3) [m/s²] measured
    rate_b: FloatArray  # shape (n, 3) [rad/s] measured
    # m GNSS epochs, at the antenna
    fix_ns: IntArray  # shape (m,)
    fix_valid: BoolArray  # shape (m,)
    fix_position: FloatArray  # shape (m, 3) [rad, rad, m] measured
    fix_velocity_n: FloatArray  # shape (m, 3) [m/s, NED] measured
    fix_error_n: FloatArray  # shape (m, 3) [m, NED] measured minus true position
    fix_position_sd_n: FloatArray  # shape (m, 3) [m, NED]
    fix_velocity_sd_n: FloatArray  # shape (m, 3) [m/s, NED]
    # k readings of the odometer
    odometer_ns: IntArray  # shape (k,)
    odometer: FloatArray  # shape (k,) [m/s] measured speed


def simulate(
    scenario: Scenario | str, seed: int = 0, duration_s: float | None = None, *, epoch_s: float = 1.0
) -> Drive:
    """Simulate a drive of a scenario: the true motion and all measurements.

    Parameters
    ----------
    scenario : Scenario or str
        Name of a row of `scenarios.SCENARIOS`, or a scenario.
    seed : int
        Seed of the speeds, stops and errors; the same seed gives the same drive.
    duration_s : float, optional
        [s] Duration; by default that of the scenario.
    epoch_s : float
        [s] Time between GNSS fixes, a multiple of 10 ms.

    Returns
    -------
    Drive
        Inertial samples at 100 Hz, fixes, odometer at 10 Hz; no clock errors and no delays.

    Raises
    ------
    ValueError
        The scenario is unknown, or the drive is too short for a fix.
    """
    if isinstance(scenario, str):
        scenario = scenario_of(scenario, seed)
    duration_ns = round((duration_s or scenario.duration_s) * 1e9)
    stride = round(epoch_s * 1e9) // STEP_NS
    steps = duration_ns // STEP_NS
    if not 0 < stride <= steps:
        raise ValueError(f"no fix every {epoch_s} s within {duration_ns / 1e9} s")
    readings = Vehicle(scenario, seed, STEP_NS * 1e-9).advance(steps)
    motion, reception = readings.motion, Reception(scenario, seed, stride * STEP_NS * 1e-9)
    nodes = np.arange(stride, steps + 1, stride)
    fixes = [reception.fix(i, antenna_at(motion, node)) for i, node in enumerate(nodes.tolist())]
    odometer_nodes = np.arange(0, steps + 1, ODOMETER_NS // STEP_NS)
    return Drive(
        scenario=scenario,
        seed=seed,
        lever_arm_b=LEVER_ARM_B,
        t_ns=np.arange(1, steps + 1) * STEP_NS,
        position=motion.position[1:],
        velocity_n=motion.velocity_n[1:],
        attitude=motion.attitude[1:],
        ideal_force_b=motion.force_b,
        ideal_rate_b=motion.rate_b,
        force_b=readings.force_b,
        rate_b=readings.rate_b,
        fix_ns=nodes * STEP_NS,
        fix_valid=np.array([fix.valid for fix in fixes]),
        fix_position=np.array([fix.position for fix in fixes]),
        fix_velocity_n=np.array([fix.velocity_n for fix in fixes]),
        fix_error_n=np.array([fix.error_n for fix in fixes]),
        fix_position_sd_n=np.array([fix.position_sd_n for fix in fixes]),
        fix_velocity_sd_n=np.array([fix.velocity_sd_n for fix in fixes]),
        odometer_ns=odometer_nodes * STEP_NS,
        odometer=_odometer(motion.speed[odometer_nodes], seed),
    )


def _odometer(speed: FloatArray, seed: int) -> FloatArray:
    """Speed with scale error and white noise; exactly zero at standstill."""
    rng = np.random.default_rng((seed, Stream.WHEELS))
    scale = 1.0 + ODOMETER_SCALE_SD * rng.standard_normal()
    return np.where(speed > 0.0, scale * speed + ODOMETER_SD * rng.standard_normal(len(speed)), 0.0)
