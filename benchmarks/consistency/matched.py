"""Drives whose sensors, and whose start, err by exactly what the filter assumes: there its covariance must be right.

Truth is a simulated drive; on its ideal inertial readings come the white noise and the walking biases of the settings,
and the vibration that the filter has to measure, on its fixes the errors that are stated. The filter starts beside the
truth by a draw from its own first covariance. Standstill and wheels, whose errors it overstates on purpose, are left
out.
"""

from dataclasses import dataclass
from math import inf, radians, sqrt

import numpy as np

from services.core.fusion.aids.aiding import Aids
from services.core.fusion.aids.base import Measurement
from services.core.fusion.aids.gnss.correlated import POSITION
from services.core.fusion.aids.gnss.fix import Reading, Stamp, gnss_measurements
from services.core.fusion.aids.gnss.position_errors import UNKNOWN_ERRORS, KnownGnssErrors
from services.core.fusion.aids.gnss.settings import GnssSettings
from services.core.fusion.inertial import error_model as em
from services.core.fusion.inertial.filter import ErrorStateFilter
from services.core.fusion.inertial.propagation import Intervals, samples_of
from services.core.fusion.inertial.standstill import CERTAIN_LIMITS
from services.core.fusion.settings import ImuSettings, Settings
from services.core.fusion.states import LAYOUT
from services.sensors.simulator.drive import EPOCH_NS, STEP_NS, Drive, simulate
from services.sensors.simulator.gnss.gnss_errors import ErrorKind, InjectedError, position_errors
from services.sensors.simulator.imu.imu_errors import MTI_630_ACCELEROMETER, MTI_630_GYROSCOPE
from shared.inertial.strapdown import InertialState
from shared.maths.earth import Geodetic, earth_rate_n, geodetic_from_ned_difference
from shared.maths.rotation import ned_from_body, quaternion_from_matrix, quaternion_from_rotation_vector
from shared.maths.rotation import quaternion_product as product
from shared.runtime.config import GnssAntenna, Vehicle

from .sizes import INNOVATIONS, STATES, FloatArray, Sizes, error_of, innovation_size, sizes_of

START = 21  # epoch [s] at which the filter starts: all drives have driven off by then
STREAM = 21  # of random numbers that no part of the simulator draws
STEP_S = STEP_NS * 1e-9
COVARIANCE_SAMPLES = 5  # from one covariance step to the next
POSITION_SD = np.array([2.0, 1.5, 3.0])  # [m, NED] of fixes, stated and true
VELOCITY_SD = np.array([0.05, 0.05, 0.08])  # [m/s, NED]
SHAKING = (MTI_630_ACCELEROMETER.vibration, MTI_630_GYROSCOPE.vibration)  # [m/s², rad/s] of each sample
START_SD = (*np.radians([0.3, 0.3, 1.5]).tolist(), 0.1, 0.1, 0.1, *POSITION_SD.tolist())
WHITE_SHARE = 0.003  # of the variance of an error that is said to last
CORRELATION_S = 60.0


@dataclass(frozen=True)
class Model:
    """How errors of GNSS positions run, and what the filter knows of that."""

    time_correlated: bool = False  # for `CORRELATION_S`; if not, they are white
    known: bool = True  # whether the filter is given the error model
    gyroscope_bias_sd: float = radians(0.2)  # [rad/s] drawn, and stated: small enough for a linear error model


def run(model: Model, scenario: str, seed: int, duration_s: float) -> Sizes:
    """Drive once, from `START` on."""
    drive = simulate(scenario, seed, duration_s)
    time_correlated = model.time_correlated or not model.known
    settings = Settings(
        imu=ImuSettings(gyroscope_bias_sd_rad_s=model.gyroscope_bias_sd),
        vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive.lever_arm_b)),
        gnss=GnssSettings(time_correlated_errors=time_correlated),
    )
    rng = np.random.default_rng((seed, STREAM))
    first = START * EPOCH_NS // STEP_NS - 1
    navigation, bias = _started(model, drive, settings, first, rng)
    biases = bias + _walk(settings, len(drive.t_ns) - first, rng)
    walks = settings.imu.velocity_random_walk_m_s_sqrt_s, settings.imu.angle_random_walk_rad_sqrt_s
    sd = np.repeat(np.hypot(np.array(walks) / sqrt(STEP_S), SHAKING), 3)
    noise = rng.standard_normal(biases.shape) * sd
    ideal = np.hstack([drive.ideal_force_b, drive.ideal_rate_b])[first:]
    stamps = drive.t_ns[first:].tolist()
    samples = samples_of(stamps, ideal + biases + noise, {})
    fixes, aids = _fixes(model, drive, settings, rng), Aids(settings)
    times, errors, innovations = [], [], []
    for i in range(1, len(stamps)):
        navigation.propagate(samples, i, i + 1, CERTAIN_LIMITS, Intervals(inf))
        if i % COVARIANCE_SAMPLES == 0:
            navigation.propagate_covariance()
        if stamps[i] % EPOCH_NS:
            continue
        outcomes = [o for fix in fixes[stamps[i] // EPOCH_NS - 1] for o in aids.use(navigation, fix)]
        navigation.propagate_covariance()
        times.append(stamps[i] * 1e-9)
        errors.append(sizes_of(navigation, error_of(navigation, drive, first + i, biases[i])))
        innovations.append([innovation_size(outcomes, kind) for kind in INNOVATIONS])
    return Sizes(np.array(times), np.array(errors), np.array(innovations))


def _started(
    model: Model, drive: Drive, settings: Settings, first: int, rng: np.random.Generator
) -> tuple[ErrorStateFilter, FloatArray]:
    """Filter at the end of a sample, and the true biases there: the errors are a draw from its covariance."""
    bias_sd = settings.imu.accelerometer_bias_sd_m_s2, settings.imu.gyroscope_bias_sd_rad_s
    sd = np.zeros(em.SIZE)
    sd[STATES] = *START_SD, *np.repeat(bias_sd, 3)
    sd[LAYOUT.place("gnss_error")] = 1.0
    x = (sd[STATES] * rng.standard_normal(sd[STATES].shape)).tolist()
    true = quaternion_from_matrix(ned_from_body(*drive.attitude[first].tolist()))
    north, east, down = drive.velocity_n[first].tolist()
    inertial = InertialState(
        int(drive.t_ns[first]),
        product(quaternion_from_rotation_vector((x[0], x[1], x[2])), true),
        (north + x[3], east + x[4], down + x[5]),
        geodetic_from_ned_difference((x[6], x[7], x[8]), Geodetic(*drive.position[first].tolist())),
    )
    gnss_errors = KnownGnssErrors(CORRELATION_S, 1.0 - WHITE_SHARE) if model.known else UNKNOWN_ERRORS
    navigation = ErrorStateFilter(settings, inertial, np.diag(sd**2), errors={POSITION: gnss_errors})
    return navigation, -np.array(x[9:])  # of a filter that starts with biases of zero


def _walk(settings: Settings, n: int, rng: np.random.Generator) -> FloatArray:
    """Walk of accelerometer and gyroscope biases from zero, shape (n, 6)."""
    psd = np.repeat([settings.imu.accelerometer_bias_psd_m2_s5, settings.imu.gyroscope_bias_psd_rad2_s3], 3)
    steps = rng.standard_normal((n, 6)) * np.sqrt(psd * STEP_S)
    steps[0] = 0.0
    walk: FloatArray = np.cumsum(steps, axis=0)
    return walk


def _fixes(model: Model, drive: Drive, settings: Settings, rng: np.random.Generator) -> list[list[Measurement]]:
    """Velocity and position of every epoch."""
    n = len(drive.fix_ns)
    errors = rng.standard_normal((n, 3))
    if model.time_correlated:
        kind = InjectedError(ErrorKind.GAUSS_MARKOV, (1.0, 1.0, 1.0), CORRELATION_S)
        correlated = position_errors(kind, n, EPOCH_NS * 1e-9, seed=(drive.seed, STREAM)).injected
        errors = sqrt(WHITE_SHARE) * errors + sqrt(1.0 - WHITE_SHARE) * correlated
    late = settings.gnss.time_sd_s * rng.standard_normal((n, 1))
    velocity_errors = VELOCITY_SD * rng.standard_normal((n, 3))
    stated = Reading((0.0, 0.0, 0.0), np.diag(POSITION_SD**2))
    fixes = []
    for k, time_ns in enumerate(drive.fix_ns.tolist()):
        i = time_ns // STEP_NS - 1
        C, arm, rate = ned_from_body(*drive.attitude[i].tolist()), np.array(drive.lever_arm_b), drive.ideal_rate_b[i]
        here = Geodetic(*drive.position[i].tolist())
        velocity = drive.velocity_n[i] + C @ np.cross(rate, arm) - np.cross(earth_rate_n(here.latitude), C @ arm)
        north, east, down = (C @ arm + POSITION_SD * errors[k] + late[k] * drive.velocity_n[i]).tolist()
        place = geodetic_from_ned_difference((north, east, down), here)
        x, y, z = (velocity + velocity_errors[k]).tolist()
        moving = Reading((x, y, z), np.diag(VELOCITY_SD**2))
        fixes.append(gnss_measurements(settings, Stamp(time_ns, time_ns, "gnss"), place, stated, moving))
    return fixes
