"""A phone in a simulated car: its sensors at 10 Hz and GNSS velocities at 1 Hz, with the truth.

Vibration, biases, suspension and the error of the attitude are assumptions of the reference simulation.
"""

from dataclasses import dataclass
from math import radians

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from services.sensors.simulator.drive import Drive, simulate
from shared.maths.rotation import ned_from_body

FloatArray = npt.NDArray[np.float64]

RATE_HZ = 10
STRIDE = 10  # samples of the simulator's IMU at 100 Hz
DURATION_S = 900
VIBRATION_SD, FULL_VIBRATION_M_S = 0.12, 15.0  # [m/s²] times 0.3 at rest to 1.3 at that speed
ACCELEROMETER_BIAS_SD = 0.05  # [m/s²]
GYROSCOPE_SD, GYROSCOPE_BIAS_SD = radians(0.15), radians(0.1)  # [rad/s]
FIELD_UT, DIP = 52.0, radians(66.0)
MAGNETOMETER_SD, MAGNETIC_WANDER_SD, MAGNETIC_WANDER_S = 0.5, 0.8, 30.0  # [uT], [uT], [s]
HARD_IRON_SD = 0.5  # [uT] what a calibration leaves
BAROMETER_SD = 0.12  # [m]
PITCH_PER_M_S2, ROLL_PER_M_S2 = radians(0.6), radians(0.8)  # suspension
MOUNT = (radians(4.0), radians(-25.0), radians(12.0))  # roll, pitch, yaw
TILT_SD, YAW_SD, ATTITUDE_S = radians(0.35), radians(1.0), 60.0  # error of an attitude filter: assumed
VELOCITY_SD = (0.03, 0.03, 0.08)  # [m/s, ENU]
CARRIER_NOISE_M_S = 0.0097  # the paper's, of a displacement in a second, in space
OUTLIERS, OUTLIER_SD = 0.005, 0.5  # [-], [m/s]
ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class PhoneDrive:
    """n seconds: sensors at 10 Hz in device axes, GNSS velocities at 0, 1, ... n s."""

    force: FloatArray  # shape (10 n, 3) [m/s²]
    rate: FloatArray  # shape (10 n, 3) [rad/s]
    field: FloatArray  # shape (10 n, 3) [uT]
    height: FloatArray  # shape (10 n,) [m]
    d_from_enu: FloatArray  # shape (10 n, 3, 3) attitude with the error of an attitude filter
    velocity: FloatArray  # shape (n, 3) [m/s, ENU] by GNSS
    true_velocity: FloatArray  # shape (n, 3) [m/s, ENU]
    carrier_velocity: FloatArray  # shape (n, 3) [m/s, ENU] by displacements of carrier phases, of the seconds beside


def drive_phone(seed: int) -> PhoneDrive:
    """Simulate 15 minutes of stop and go."""
    drive = simulate("urban", seed, float(DURATION_S))
    rng = np.random.default_rng((seed, 2))
    n = DURATION_S * RATE_HZ

    def decimated(values: FloatArray) -> FloatArray:
        means: FloatArray = values.reshape(n, STRIDE, *values.shape[1:]).mean(axis=1)
        return means

    velocity_n = drive.velocity_n[STRIDE // 2 :: STRIDE]
    speed = np.hypot(velocity_n[:, 0], velocity_n[:, 1])
    forward, lateral = np.gradient(speed, 1.0 / RATE_HZ), speed * decimated(drive.ideal_rate_b)[:, 2]
    lean = [
        ned_from_body(ROLL_PER_M_S2 * side, PITCH_PER_M_S2 * along, 0.0)
        for along, side in zip(forward.tolist(), lateral.tolist(), strict=True)
    ]
    body_from_device = np.array(lean) @ ned_from_body(*MOUNT)
    ned_from_vehicle = np.array([ned_from_body(*angles) for angles in drive.attitude[STRIDE // 2 :: STRIDE].tolist()])
    enu_from_device = ENU_FROM_NED @ ned_from_vehicle @ body_from_device

    def in_device(values_b: FloatArray) -> FloatArray:
        turned: FloatArray = np.einsum("nji,nj->ni", body_from_device, values_b)
        return turned

    vibration = VIBRATION_SD * (0.3 + np.minimum(speed / FULL_VIBRATION_M_S, 1.0))[:, np.newaxis]
    force = in_device(decimated(drive.ideal_force_b)) + ACCELEROMETER_BIAS_SD * rng.standard_normal(3)
    force += vibration * rng.standard_normal((n, 3))
    rate = in_device(decimated(drive.ideal_rate_b)) + GYROSCOPE_BIAS_SD * rng.standard_normal(3)
    rate += GYROSCOPE_SD * rng.standard_normal((n, 3))
    field_enu = FIELD_UT * np.array([0.0, np.cos(DIP), -np.sin(DIP)])
    field = np.einsum("nij,i->nj", enu_from_device, field_enu) + HARD_IRON_SD * rng.standard_normal(3)
    field += MAGNETIC_WANDER_SD * correlated(rng, (n, 3), MAGNETIC_WANDER_S)
    field += MAGNETOMETER_SD * rng.standard_normal((n, 3))
    error = correlated(rng, (n, 3), ATTITUDE_S) * [TILT_SD, TILT_SD, YAW_SD]
    wrong = Rotation.from_rotvec(error).as_matrix() @ enu_from_device
    true_velocity = np.vstack([np.zeros(3), drive.velocity_n[RATE_HZ * STRIDE - 1 :: RATE_HZ * STRIDE][:-1]])
    true_velocity = true_velocity @ ENU_FROM_NED.T
    noise = rng.standard_normal(true_velocity.shape) * VELOCITY_SD
    outlier = rng.random(len(true_velocity)) < OUTLIERS
    noise += outlier[:, np.newaxis] * OUTLIER_SD * rng.standard_normal(true_velocity.shape)
    return PhoneDrive(
        force, rate, field,
        drive.position[STRIDE // 2 :: STRIDE, 2] + BAROMETER_SD * rng.standard_normal(n),
        np.swapaxes(wrong, 1, 2), true_velocity + noise, true_velocity,
        carrier_velocity(drive, np.random.default_rng((seed, 3))) @ ENU_FROM_NED.T,
    )  # fmt: skip


def carrier_velocity(drive: Drive, rng: np.random.Generator) -> FloatArray:
    """Velocity [m/s, NED] at each second by the displacements of the seconds before and after it, shape (n, 3).

    A displacement is the mean velocity of its second. That of the paper's phone at rest is 9.7 mm/s, which is taken
    for the noise of two epochs, a third of its square on each axis; successive displacements share one of them.
    """
    means = np.array(drive.velocity_n).reshape(DURATION_S, -1, 3).mean(axis=1)
    epoch = CARRIER_NOISE_M_S / np.sqrt(6.0) * rng.standard_normal((DURATION_S + 1, 3))
    displaced = means + np.diff(epoch, axis=0)
    before = np.vstack([displaced[:1], displaced[:-1]])
    velocity: FloatArray = 0.5 * (before + displaced)
    return velocity


def correlated(rng: np.random.Generator, shape: tuple[int, int], correlation_s: float) -> FloatArray:
    """First-order Gauss-Markov noise of standard deviation 1 at 10 Hz, stationary from the first sample."""
    keep = float(np.exp(-1.0 / (RATE_HZ * correlation_s)))
    white = np.sqrt(1.0 - keep**2) * rng.standard_normal(shape)
    white[0] /= np.sqrt(1.0 - keep**2)
    found: FloatArray = lfilter([1.0], [1.0, -keep], white, axis=0)
    return found
