"""The error-state filter: a mechanisation, the covariance of its errors, and the corrections between them."""

from math import exp, isfinite, sqrt
from operator import sub

import numpy as np
import numpy.typing as npt

from shared.errors import FilterDiverged
from shared.maths.earth import Geodetic
from shared.maths.kalman import Correction
from shared.maths.rotation import Quaternion, Vector, matrix_from_quaternion, ned_from_body

from ..measurements.gnss_error_model import UNKNOWN, Colour, Told
from ..settings import Settings
from ..smoothing.history import Trail
from . import error_model as em
from .imu_step import NO_SUMS, STEADY, SWAY_S, Shaking, means, take_sample
from .kalman import resized, variances
from .propagation import EARLY_S, NEVER, PLAIN, Arithmetic, Beside, Departure, Moment, sound, unsoundness
from .strapdown import InertialState, motion_of, without

FloatArray = npt.NDArray[np.float64]

SCALE_PSD = 1e-8  # [1/s] 0.6 % in an hour
MOUNTING_PSD = 1e-9  # [rad²/s] 0.1 degrees in an hour
DELAY_PSD = 1e-6  # [s] 1 ms in a second, 60 ms in an hour
LASTING_FIRST, LASTING_END = em.GNSS_ERROR.start - em.DRIVING, em.GNSS_ERROR.stop - em.DRIVING  # of parameters
NO_PARAMETERS = (0.0,) * (em.SIZE - em.DRIVING)


class ErrorStateFilter:
    """Thirty-one errors around a strapdown mechanisation; every correction is fed back at once.

    What is not estimated has neither variance nor noise, and stays as it was given.

    Parameters
    ----------
    settings : Settings
        Noise, periods.
    inertial : InertialState
        Where to start.
    P : ndarray, shape (31, 31)
        Covariance of the start, in the order of `error_model`.
    accelerometer_bias, gyroscope_bias : tuple of float
        [m/s²], [rad/s] Body axes, as far as known.
    parameters : tuple of float
        Of what aids it, in the order of `error_model.PARAMETERS`, as far as known.
    colour : Colour
        How GNSS errors run over time, as far as known.
    """

    def __init__(
        self,
        settings: Settings,
        inertial: InertialState,
        P: FloatArray,
        accelerometer_bias: Vector = (0.0, 0.0, 0.0),
        gyroscope_bias: Vector = (0.0, 0.0, 0.0),
        parameters: tuple[float, ...] = NO_PARAMETERS,
        colour: Colour | Told = UNKNOWN,
    ) -> None:
        self.inertial = inertial
        self.P = P
        self.accelerometer_bias = accelerometer_bias
        self.gyroscope_bias = gyroscope_bias
        self.accelerometer_scale: Vector = (0.0, 0.0, 0.0)
        self.gyroscope_scale: Vector = (0.0, 0.0, 0.0)
        self.parameters = parameters
        self.colour = colour
        self.moved: Vector = (0.0, 0.0, 0.0)  # [m, NED] by all corrections together
        self.rate: Vector = (0.0, 0.0, 0.0)  # [rad/s, body] of the last sample, bias removed
        self.acceleration: Vector = (0.0, 0.0, 0.0)  # [m/s², NED] of the last sample
        self.arithmetic: Arithmetic = PLAIN
        self.trail: Trail | None = None  # is told what happens to the errors, for a smoother
        self._period_s = settings.covariance_period_s
        self._settings = settings
        self._last: tuple[Vector, Vector] | None = None  # sample as measured
        self._shaking: Shaking = STEADY  # of samples: power spectral densities, and what is left of acceleration
        self._sums = NO_SUMS  # since the covariance was brought up
        self._walks = em.noise_density(
            (em.ATTITUDE, settings.imu.angle_random_walk_rad_sqrt_s**2),
            (em.VELOCITY, settings.imu.velocity_random_walk_m_s_sqrt_s**2),
            (em.ACCELEROMETER_BIAS, settings.imu.accelerometer_bias_psd_m2_s5),
            (em.GYROSCOPE_BIAS, settings.imu.gyroscope_bias_psd_rad2_s3),
            (em.ODOMETER_SCALE, SCALE_PSD),
            (em.MOUNTING, MOUNTING_PSD),
            (em.DELAYS, DELAY_PSD if settings.estimate_delays else 0.0),
            (
                em.BAROMETER_OFFSET,
                settings.barometer.offset_random_walk_m_sqrt_s**2 if settings.barometer.enabled else 0.0,
            ),
        )

    def fork(self) -> "ErrorStateFilter":
        """Copy that goes its own way; nothing that both hold is ever changed in place."""
        twin = ErrorStateFilter.__new__(ErrorStateFilter)
        twin.__dict__.update(self.__dict__)
        return twin

    @property
    def inertial(self) -> InertialState:
        """Attitude, velocity and position."""
        quaternion, velocity, position, _ = self._motion
        return InertialState(self._time_ns, quaternion, velocity, Geodetic(*position))

    @inertial.setter
    def inertial(self, state: InertialState) -> None:
        self._time_ns, self._motion = state.time_ns, motion_of(state)

    @property
    def quaternion(self) -> Quaternion:
        """Attitude, without the rest."""
        return self._motion[0]

    @property
    def velocity(self) -> Vector:
        """[m/s, NED], without the rest."""
        return self._motion[1]

    @property
    def position(self) -> Geodetic:
        """Position, without the rest."""
        return Geodetic(*self._motion[2])

    @property
    def ned_from_body(self) -> FloatArray:
        """Attitude as a matrix, shape (3, 3)."""
        return matrix_from_quaternion(self._motion[0])

    def parameter(self, place: int) -> float:
        """Value of a parameter by the place of its error in the state."""
        return self.parameters[place - em.DRIVING]

    @property
    def gnss_error(self) -> FloatArray:
        """Lasting error of GNSS positions over its standard deviation, shape (3,)."""
        return np.array(self.parameters[LASTING_FIRST:LASTING_END])

    @property
    def vehicle_from_body(self) -> FloatArray:
        """Mounting as a matrix, shape (3, 3)."""
        first = em.MOUNTING.start
        return ned_from_body(0.0, self.parameter(first), self.parameter(first + 1))

    def advance(self, force: Vector, rate: Vector, time_ns: int) -> None:
        """Carry the state to an instant with a sample [m/s², rad/s, body; as measured] that holds until then."""
        step_s = (time_ns - self._time_ns) * 1e-9
        if step_s <= 0.0:
            return
        sample = force, rate
        self._motion, self._sums, self._shaking, self.rate, self.acceleration = take_sample(
            self._motion,
            self._sums,
            self._shaking,
            (self.accelerometer_bias, self.gyroscope_bias, self.accelerometer_scale, self.gyroscope_scale),
            sample,
            self._last or sample,
            step_s,
        )
        self._last, self._time_ns = sample, time_ns

    def keep_covariance(self) -> None:
        """Carry the covariance to the instant of the state, if that is due."""
        if self._sums[0] >= self._period_s - EARLY_S:
            self.bring_covariance_up()

    def departure(self, beside: Beside, dues: tuple[float, float, float]) -> Departure | None:
        """What a loop over ordinary samples goes on from, and what goes on beside the filter; None before the first."""
        if self._last is None:
            return None
        errors = self.accelerometer_bias, self.gyroscope_bias, self.accelerometer_scale, self.gyroscope_scale
        first, second, third = self.parameters[LASTING_FIRST:LASTING_END]
        moment: Moment = (
            *(self._motion, self._sums, self._shaking, self._last, self.rate, self.acceleration),
            (first, second, third),
            beside,
        )
        limits = self._period_s, self._settings.imu.vibration_factor, self._memory_s, *dues
        return moment, self.P, errors, self._walks, limits

    def resume(self, moment: Moment, P: FloatArray, time_ns: int) -> Beside:
        """Go on from where a loop has come to."""
        self._motion, self._sums, self._shaking, self._last, self.rate, self.acceleration, lasting, beside = moment
        self._remember_gnss_error(lasting)
        self._time_ns, self.P = time_ns, P
        return beside

    @property
    def sway(self) -> FloatArray:
        """Acceleration [m/s², NED] of the last tenth of a second, less by what vibration makes of it; shape (3,)."""
        a = np.array(self._shaking[2:])
        size2, noise2 = float(a @ a), 1.5 * self._shaking[0] / SWAY_S
        return max(0.0, 1.0 - noise2 / size2) * a if size2 > 0.0 else a

    def rate_noise(self, span_s: float) -> float:
        """Standard deviation [rad/s] that vibration gives to the mean rate of a time."""
        return sqrt(self._shaking[1] / span_s)

    def bring_covariance_up(self) -> None:
        """Carry the covariance to the instant of the state."""
        since_s = self._sums[0]
        if since_s == 0.0:
            return
        memory_s, sums, factor = self._memory_s, self._sums, self._settings.imu.vibration_factor
        remains = exp(-since_s / memory_s) if memory_s < NEVER else 1.0
        self.P, fine = self.arithmetic.grow(self.P, self._motion, sums, self._walks, self._shaking, factor, remains)
        self._sums = NO_SUMS
        if remains < 1.0:
            north, east, down = self.parameters[LASTING_FIRST:LASTING_END]
            self._remember_gnss_error((remains * north, remains * east, remains * down))
        self._require(fine)
        if self.trail is not None:
            F = em.system_matrix(self._motion, *means(sums))
            self.trail.stepped(self, F, since_s, _shares(remains))

    @property
    def _memory_s(self) -> float:
        """Correlation time of what lasts of the error of GNSS, if it is estimated."""
        place = em.GNSS_ERROR.start
        return NEVER if self.P[place, place] == 0.0 else self.colour.correlation_s

    def learn(self, colour: Colour | Told) -> None:
        """Take over what was learned of GNSS errors: what is estimated of them [m] stays, and its variance follows."""
        if colour is self.colour:
            return
        ratios, place = colour.unit / self.colour.unit, em.GNSS_ERROR
        self.colour = colour
        if self.P[place.start, place.start] == 0.0 or (ratios == 1.0).all():
            return
        if self.trail is not None:
            self.trail.resized(self.inertial.time_ns, place, ratios, self.P[place])
        self.P = resized(self.P, place.start, place.stop, ratios)
        north, east, down = (self.gnss_error / ratios).tolist()
        self._remember_gnss_error((north, east, down))

    def _remember_gnss_error(self, lasting: Vector) -> None:
        old = self.parameters
        self.parameters = (*old[:LASTING_FIRST], *lasting, *old[LASTING_END:])

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

    def widen_along(self, block: slice, error: FloatArray) -> None:
        """Admit an error of a direction, shape (3,), in one block of the state, in its unit."""
        self.P = self.P.copy()
        self.P[block, block] += np.outer(error, error)

    def forget_odometer(self) -> None:
        """Take the scale of the odometer for unknown: it is another one."""
        self.set_parameter(em.ODOMETER_SCALE, 0.0, self._settings.odometer.scale_sd)

    def forget_gnss_error(self) -> None:
        """Take the lasting error of GNSS for unknown: it is another one."""
        for place in range(em.GNSS_ERROR.start, em.GNSS_ERROR.stop):
            self.set_parameter(place, 0.0, 1.0)

    def set_parameter(self, place: int, value: float, sd: float) -> None:
        """Take a parameter for something else, of which nothing was known before."""
        own = place - em.DRIVING
        self.parameters = (*self.parameters[:own], value, *self.parameters[own + 1 :])
        self.P = self.P.copy()
        self.P[place] = self.P[:, place] = 0.0
        self.P[place, place] = sd**2
        if self.trail is not None:
            self.trail.forgot(self.inertial.time_ns, place)

    def weigh(self, z: FloatArray, H: FloatArray, R: FloatArray) -> Correction:
        """Work out what a measurement says, without believing it yet."""
        self.bring_covariance_up()
        return self.arithmetic.correct(self.P, z, H, R)

    def accept(self, correction: Correction) -> None:
        """Take the estimated errors out of the state, where they are zero from then on."""
        self.take_out(correction.x, correction.P)
        if self.trail is not None:
            self.trail.corrected(self.inertial.time_ns, correction)

    def take_out(self, errors: FloatArray, P: FloatArray) -> None:
        """Move the state by errors, shape (31,), that leave the covariance P."""
        x = errors.tolist()
        self.P = P
        self.inertial = without(self.inertial, x[: em.MOVING])
        self.moved = (self.moved[0] - x[6], self.moved[1] - x[7], self.moved[2] - x[8])
        bias, drift = self.accelerometer_bias, self.gyroscope_bias
        self.accelerometer_bias = (bias[0] + x[9], bias[1] + x[10], bias[2] + x[11])
        self.gyroscope_bias = (drift[0] + x[12], drift[1] + x[13], drift[2] + x[14])
        self.rate = (self.rate[0] - x[12], self.rate[1] - x[13], self.rate[2] - x[14])
        if any(x[15:21]):
            (a, b, c), (p, q, r) = self.accelerometer_scale, self.gyroscope_scale
            self.accelerometer_scale = (a + x[15], b + x[16], c + x[17])
            self.gyroscope_scale = (p + x[18], q + x[19], r + x[20])
        self.parameters = tuple(map(sub, self.parameters, x[em.DRIVING :]))
        self._check()

    def _check(self) -> None:
        """Raise `FilterDiverged` where numbers have lost their meaning, rather than hand them on."""
        total, least = variances(self.P, em.ACCELEROMETER_SCALE.start)
        self._require(isfinite(total) and least > 0.0)

    def _require(self, fine: bool) -> None:
        if not fine:
            raise FilterDiverged("the covariance is no longer positive")
        if not sound(self._motion):
            raise FilterDiverged(unsoundness(self._motion))


def _shares(remains: float) -> FloatArray | None:
    """What remains of each error over a step, if not all."""
    if remains == 1.0:
        return None
    shares = np.ones(em.SIZE)
    shares[em.GNSS_ERROR] = remains
    return shares
