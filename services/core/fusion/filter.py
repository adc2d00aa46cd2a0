"""The error-state filter: a mechanisation, the covariance of its errors, and the corrections between them."""

from math import isfinite, pi, sqrt

import numpy as np
import numpy.typing as npt

from shared.errors import FilterDiverged
from shared.maths.earth import Geodetic, geodetic_from_ned_difference
from shared.maths.rotation import (
    Quaternion,
    Vector,
    matrix_from_quaternion,
    ned_from_body,
    quaternion_from_rotation_vector,
    quaternion_product,
)

from . import error_model as em
from .kalman import Correction, correct, predict
from .settings import Settings
from .strapdown import InertialState, normalised, propagate

FloatArray = npt.NDArray[np.float64]

SCALE_PSD = 1e-8  # [1/s] 0.6 % in an hour
MOUNTING_PSD = 1e-9  # [rad²/s] 0.1 degrees in an hour
SHAKE_S = 1.0  # time constant of the measured vibration
FASTEST_M_S = 500.0
NO_PARAMETERS = (0.0,) * (em.SIZE - em.DRIVING)
HIGHEST_LATITUDE = 0.4999 * pi  # the NED frame has no north at the pole; 2 km from it this filter ends


class ErrorStateFilter:
    """Thirty errors around a strapdown mechanisation; every correction is fed back at once.

    What is not estimated has neither variance nor noise, and stays as it was given.

    Parameters
    ----------
    settings : Settings
        Noise, periods.
    inertial : InertialState
        Where to start.
    P : ndarray, shape (30, 30)
        Covariance of the start, in the order of `error_model`.
    accelerometer_bias, gyroscope_bias : tuple of float
        [m/s²], [rad/s] Body axes, as far as known.
    parameters : tuple of float
        Of what aids it, in the order of `error_model.PARAMETERS`, as far as known.
    """

    def __init__(
        self,
        settings: Settings,
        inertial: InertialState,
        P: FloatArray,
        accelerometer_bias: Vector = (0.0, 0.0, 0.0),
        gyroscope_bias: Vector = (0.0, 0.0, 0.0),
        parameters: tuple[float, ...] = NO_PARAMETERS,
    ) -> None:
        self.inertial = inertial
        self.P = P
        self.accelerometer_bias = accelerometer_bias
        self.gyroscope_bias = gyroscope_bias
        self.accelerometer_scale: Vector = (0.0, 0.0, 0.0)
        self.gyroscope_scale: Vector = (0.0, 0.0, 0.0)
        self.parameters = parameters
        self.rate: Vector = (0.0, 0.0, 0.0)  # [rad/s, body] of the last sample, bias removed
        self.acceleration: Vector = (0.0, 0.0, 0.0)  # [m/s², NED] of the last sample
        self._period_s = settings.covariance_period_s
        self._settings = settings
        self._last: tuple[Vector, Vector] | None = None  # sample as measured
        self._force_shake = 0.0  # [m²/s³] power spectral density of what samples differ by from each other
        self._rate_shake = 0.0  # [rad²/s]
        self._since_s = 0.0  # of the covariance
        self._impulse: Vector = (0.0, 0.0, 0.0)  # [m/s, NED] specific force summed over that time
        self._turn: Vector = (0.0, 0.0, 0.0)  # [rad, body] angular rate summed over that time

    def fork(self) -> "ErrorStateFilter":
        """Copy that goes its own way; nothing that both hold is ever changed in place."""
        twin = ErrorStateFilter.__new__(ErrorStateFilter)
        twin.__dict__.update(self.__dict__)
        return twin

    @property
    def ned_from_body(self) -> FloatArray:
        """Attitude as a matrix, shape (3, 3)."""
        return matrix_from_quaternion(self.inertial.quaternion)

    def parameter(self, place: int) -> float:
        """Value of a parameter by the place of its error in the state."""
        return self.parameters[place - em.DRIVING]

    @property
    def vehicle_from_body(self) -> FloatArray:
        """Mounting as a matrix, shape (3, 3)."""
        first = em.MOUNTING.start
        return ned_from_body(0.0, self.parameter(first), self.parameter(first + 1))

    def advance(self, force: Vector, rate: Vector, time_ns: int) -> None:
        """Carry the state to an instant with a sample [m/s², rad/s, body; as measured] that holds until then."""
        bias = self.accelerometer_bias
        drift = self.gyroscope_bias
        step_s = (time_ns - self.inertial.time_ns) * 1e-9
        if step_s <= 0.0:
            return
        self._feel_vibration(force, rate, step_s)
        (a, b, c), (fx, fy, fz) = self.gyroscope_scale, force
        (p, q, r), (wx, wy, wz) = self.accelerometer_scale, rate
        self.rate = (wx - drift[0] - a * wx, wy - drift[1] - b * wy, wz - drift[2] - c * wz)
        true_force = (fx - bias[0] - p * fx, fy - bias[1] - q * fy, fz - bias[2] - r * fz)
        before = self.inertial.velocity
        self.inertial, (north, east, down) = propagate(self.inertial, true_force, self.rate, time_ns)
        after = self.inertial.velocity
        per_s = 1.0 / step_s
        self.acceleration = (
            (after[0] - before[0]) * per_s,
            (after[1] - before[1]) * per_s,
            (after[2] - before[2]) * per_s,
        )
        x, y, z = self._impulse
        self._impulse = (x + north * step_s, y + east * step_s, z + down * step_s)
        (x, y, z), (wx, wy, wz) = self._turn, self.rate
        self._turn = (x + wx * step_s, y + wy * step_s, z + wz * step_s)
        self._since_s += step_s
        if self._since_s >= self._period_s - 1e-9:
            self.bring_covariance_up()

    def _feel_vibration(self, force: Vector, rate: Vector, step_s: float) -> None:
        """Measure white noise by the difference of successive samples, whose variance is twice its own."""
        if self._last is not None:
            (x, y, z), (a, b, c) = self._last
            force2 = (force[0] - x) ** 2 + (force[1] - y) ** 2 + (force[2] - z) ** 2
            rate2 = (rate[0] - a) ** 2 + (rate[1] - b) ** 2 + (rate[2] - c) ** 2
            share, scale = min(1.0, step_s / SHAKE_S), step_s / 6.0
            self._force_shake += share * (scale * force2 - self._force_shake)
            self._rate_shake += share * (scale * rate2 - self._rate_shake)
        self._last = (force, rate)

    def rate_noise(self, span_s: float) -> float:
        """Standard deviation [rad/s] that vibration gives to the mean rate of a time."""
        return sqrt(self._rate_shake / span_s)

    def _noise(self) -> FloatArray:
        """Power spectral density of the errors' growth: that of the sensor, or of the vibration if it is more."""
        settings, factor = self._settings, self._settings.vibration_factor
        return em.noise_density(
            (em.ATTITUDE, max(settings.angle_random_walk_rad_sqrt_s**2, factor * self._rate_shake)),
            (em.VELOCITY, max(settings.velocity_random_walk_m_s_sqrt_s**2, factor * self._force_shake)),
            (em.ACCELEROMETER_BIAS, settings.accelerometer_bias_psd_m2_s5),
            (em.GYROSCOPE_BIAS, settings.gyroscope_bias_psd_rad2_s3),
            (em.ODOMETER_SCALE, SCALE_PSD),
            (em.MOUNTING, MOUNTING_PSD),
        )

    def bring_covariance_up(self) -> None:
        """Carry the covariance to the instant of the state."""
        if self._since_s == 0.0:
            return
        (x, y, z), (a, b, c), per_s = self._impulse, self._turn, 1.0 / self._since_s
        mean_force, mean_rate = (x * per_s, y * per_s, z * per_s), (a * per_s, b * per_s, c * per_s)
        F = em.system_matrix(self.inertial, mean_force, self.ned_from_body, mean_rate)
        self.P = predict(self.P, F, self._noise(), self._since_s)
        self._since_s, self._impulse, self._turn = 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        self._check()

    def widen(
        self, *, attitude_sd: float = 0.0, velocity_sd: float = 0.0, position_sd: float = 0.0, height_sd: float = 0.0
    ) -> None:
        """Admit more error [rad, m/s, m] than the model knows of."""
        self.bring_covariance_up()
        widened = self.P.copy()
        diagonal = np.einsum("ii->i", widened)
        diagonal[em.ATTITUDE] += attitude_sd**2
        diagonal[em.VELOCITY] += velocity_sd**2
        diagonal[em.POSITION] += position_sd**2
        diagonal[em.POSITION.stop - 1] += height_sd**2
        self.P = widened

    def forget_odometer(self) -> None:
        """Take the scale of the odometer for unknown: it is another one."""
        place = em.ODOMETER_SCALE - em.DRIVING
        self.parameters = (*self.parameters[:place], 0.0, *self.parameters[place + 1 :])
        self.P = self.P.copy()
        self.P[em.ODOMETER_SCALE] = self.P[:, em.ODOMETER_SCALE] = 0.0
        self.P[em.ODOMETER_SCALE, em.ODOMETER_SCALE] = self._settings.odometer_scale_sd**2

    def weigh(self, z: FloatArray, H: FloatArray, R: FloatArray) -> Correction:
        """Work out what a measurement says, without believing it yet."""
        self.bring_covariance_up()
        return correct(self.P, z, H, R)

    def accept(self, correction: Correction) -> None:
        """Take the estimated errors out of the state, where they are zero from then on."""
        x = correction.x.tolist()
        self.P = correction.P
        time_ns, quaternion, velocity, position = self.inertial
        self.inertial = InertialState(
            time_ns,
            _turned_back(quaternion, (x[0], x[1], x[2])),
            (velocity[0] - x[3], velocity[1] - x[4], velocity[2] - x[5]),
            _moved_back(position, (x[6], x[7], x[8])),
        )
        bias, drift = self.accelerometer_bias, self.gyroscope_bias
        self.accelerometer_bias = (bias[0] + x[9], bias[1] + x[10], bias[2] + x[11])
        self.gyroscope_bias = (drift[0] + x[12], drift[1] + x[13], drift[2] + x[14])
        self.rate = (self.rate[0] - x[12], self.rate[1] - x[13], self.rate[2] - x[14])
        if any(x[15:21]):
            (a, b, c), (p, q, r) = self.accelerometer_scale, self.gyroscope_scale
            self.accelerometer_scale = (a + x[15], b + x[16], c + x[17])
            self.gyroscope_scale = (p + x[18], q + x[19], r + x[20])
        self.parameters = tuple(old - error for old, error in zip(self.parameters, x[em.DRIVING :], strict=True))
        self._check()

    def _check(self) -> None:
        """Raise `FilterDiverged` where numbers have lost their meaning, rather than hand them on."""
        variances = self.P.diagonal().tolist()
        if not (isfinite(sum(variances)) and min(variances[: em.ACCELEROMETER_SCALE.start]) > 0.0):
            raise FilterDiverged("the covariance is no longer positive")
        _, quaternion, velocity, position = self.inertial
        if not isfinite(sum(quaternion) + sum(velocity) + sum(position)):
            raise FilterDiverged("the state is no longer finite")
        if max(map(abs, velocity)) > FASTEST_M_S:
            raise FilterDiverged("the velocity is beyond any vehicle's")
        if abs(position.latitude) > HIGHEST_LATITUDE:
            raise FilterDiverged("the position is too near a pole")


def _turned_back(quaternion: Quaternion, error: Vector) -> Quaternion:
    """exp(-sk(psi)) C, exactly."""
    back = quaternion_from_rotation_vector((-error[0], -error[1], -error[2]))
    return normalised(quaternion_product(back, quaternion))


def _moved_back(position: Geodetic, error: Vector) -> Geodetic:
    return geodetic_from_ned_difference((-error[0], -error[1], -error[2]), position)
