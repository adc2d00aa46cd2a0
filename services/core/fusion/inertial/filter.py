"""Error-state Kalman filter (ESKF): inertial state, IMU errors and parameters, with the covariance of their errors."""

from collections.abc import Mapping, Sequence
from math import exp, inf, sqrt
from operator import is_not
from types import MappingProxyType
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from shared.copies import shallow
from shared.inertial.strapdown import InertialState, local_earth
from shared.maths.compiled import compilable
from shared.maths.earth import Geodetic, geodetic_from_ned_difference
from shared.maths.kalman import Correction, correct
from shared.maths.rotation import Quaternion, Vector, matrix_from_quaternion

from ..settings import Settings
from ..smoothing.history import HistoryRecorder
from ..states import LAYOUT
from . import error_model as em
from .propagation import (
    NEVER_NS,
    ZERO,
    ImuErrors,
    Intervals,
    Samples,
    Stop,
    initial_state,
    propagate,
    propagate_arrays,
)
from .row import (
    PARAMETERS,
    Numbers,
    Row,
    diverged,
    fault_of,
    minus,
    packed,
    row_of,
    step_of,
    subtracted,
)
from .standstill import Limits

FloatArray = npt.NDArray[np.float64]

SCATTER = 0.25  # [-] of delays that are found
UNCERTAIN_SHARE = 0.5  # [-] of the way in a delay that has just been found
NO_ERRORS = ImuErrors()


class CorrelatedErrors(Protocol):
    """What is known of the time-correlated errors of an aid, a block of states of the filter."""

    @property
    def correlation_s(self) -> float:
        """Correlation time [s]."""
        ...

    def stationary(self, estimated: bool) -> FloatArray | float:
        """Stationary variances [unit²] of the block, which has a variance already or not; zero: no noise drives it."""
        ...


NO_ERRORS_KNOWN: Mapping[str, CorrelatedErrors] = MappingProxyType({})


class FixDelay(NamedTuple):
    """Delays [s] of GNSS that the filter has found, and the velocity [m/s, NED] of the longer one ago.

    Stamps are corrected by them. Velocities count less where they change nevertheless: a receiver that is late smooths
    them too. The velocity is that of a first-order lag.
    """

    position_s: float
    velocity_s: float
    velocity: Vector

    @property
    def longest_s(self) -> float:
        """The longer of the two, or the earlier if they are negative [s]."""
        return max(abs(self.position_s), abs(self.velocity_s))

    def change(self, velocity: Vector) -> Vector:
        """Change of the velocity [m/s, NED] in that time."""
        return minus(velocity, self.velocity)

    def velocity_cov(self, velocity: Vector) -> FloatArray:
        """Covariance [m²/s²] of a late GNSS velocity by its delay, shape (3, 3)."""
        error = self.velocity_s / self.longest_s * np.array(self.change(velocity))
        return np.outer(error, error)

    def way(self, velocity: Vector) -> Vector:
        """Way [m, NED] in the delay of positions, which a receiver has still to go: by the mean velocity in it."""
        share, (x, y, z) = 0.5 * abs(self.position_s) / self.longest_s, self.change(velocity)
        mean = minus(velocity, (share * x, share * y, share * z))
        north, east, down = (self.position_s * part for part in mean)
        return north, east, down


class ErrorStateFilter:
    """The state, and the covariance of its errors; estimated errors are subtracted from the state at once.

    A state that is not estimated has neither variance nor noise, and keeps its value. Nothing is changed in place, so
    that `copy.copy` gives an independent filter.

    Parameters
    ----------
    settings : Settings
        Noise densities and initial standard deviations.
    inertial : InertialState
        Attitude, velocity and position at the start.
    P : ndarray, shape (n, n)
        Covariance at the start, in the order of `error_model`: n is `Layout.size_by` of the settings.
    imu : ImuErrors
        Estimated biases and scale factors at the start.
    parameters : tuple of float
        Parameters of the aiding sensors at the start, in the order of `error_model.PARAMETERS`; None: all zero.
    errors : mapping of str to CorrelatedErrors
        Statistics of time-correlated errors, by the name of their block.
    """

    def __init__(
        self,
        settings: Settings,
        inertial: InertialState,
        P: FloatArray,
        imu: ImuErrors = NO_ERRORS,
        parameters: tuple[float, ...] | None = None,
        errors: Mapping[str, CorrelatedErrors] = NO_ERRORS_KNOWN,
    ) -> None:
        self.state = initial_state(inertial, ZERO, ZERO)
        self.P = P
        self.imu = imu
        self.parameters = (0.0,) * (len(P) - em.DRIVING) if parameters is None else parameters
        self.errors = errors  # replaced and never changed in place
        self.position_correction: Vector = ZERO  # [m, NED] sum of all corrections
        self.late: FixDelay | None = None  # fixes that seem to be older than their stamps
        self.recorder: HistoryRecorder | None = None  # records steps and corrections for the smoother
        self._settings = settings
        self._has_sample = False
        self._values: tuple[tuple[object, ...], FloatArray] | None = None  # of `numbers`, and what they are made of
        densities = ((LAYOUT.place(b.name), b.psd(settings)) for b in LAYOUT.blocks)
        self._psd = em.process_noise_psd(*densities)[: len(P)]
        self._noise: tuple[object, list[bool], em.ProcessNoise] | None = None  # of `noise`, and what it is made of

    @property
    def size(self) -> int:
        """Number of states."""
        return em.DRIVING + len(self.parameters)

    def unrecorded(self) -> "ErrorStateFilter":
        """Independent copy without a history for the smoother."""
        made = shallow(self)
        made.recorder = None
        return made

    @property
    def row(self) -> Row:
        """What samples and updates change."""
        return Row(self.state, self.P, self.imu, np.array(self.parameters), self.position_correction)

    def take(self, row: Row) -> None:
        """Take over what samples and updates have changed."""
        self.state, self.P, self.imu, parameters, self.position_correction = row
        self.parameters = tuple(parameters.tolist())

    @property
    def numbers(self) -> Numbers:
        """The row as arrays."""
        members = self.state, self.imu, self.parameters, self.position_correction
        if self._values is None or any(map(is_not, members, self._values[0])):
            self._values = members, packed(self.row).values
        return Numbers(self.state.time_ns, self._values[1], self.P)

    def take_numbers(self, numbers: Numbers) -> None:
        """Take over a row that compiled code has changed."""
        time_ns, values, P = numbers
        self.take(row_of(time_ns, values.tolist(), P, values[PARAMETERS:]))
        self._values = (self.state, self.imu, self.parameters, self.position_correction), values

    @property
    def noise(self) -> em.ProcessNoise:
        """Noise that drives the errors of now."""
        places = [LAYOUT.place(name) for name in self.errors]
        estimated = [float(self.P[place.start, place.start]) > 0.0 for place in places]
        if self._noise is None or self._noise[0] is not self.errors or self._noise[1] != estimated:
            correlation_s, variance = np.full(self.size, inf), np.zeros(self.size)
            for place, errors, is_estimated in zip(places, self.errors.values(), estimated, strict=True):
                correlation_s[place], variance[place] = errors.correlation_s, errors.stationary(is_estimated)
            made = em.ProcessNoise(self._psd, correlation_s, variance, self._settings.imu.vibration_factor)
            self._noise = self.errors, estimated, made
        return self._noise[2]

    @property
    def inertial(self) -> InertialState:
        """Attitude, velocity and position."""
        state = self.state
        return InertialState(state.time_ns, state.quaternion, state.velocity, Geodetic(*state.position))

    @inertial.setter
    def inertial(self, inertial: InertialState) -> None:
        _, quaternion, velocity, (latitude, longitude, height) = inertial
        self.state = self.state._replace(
            quaternion=quaternion,
            velocity=velocity,
            position=(latitude, longitude, height),
            earth=local_earth(latitude),
        )

    @property
    def time_ns(self) -> int:
        """Instant of the state."""
        return self.state.time_ns

    @property
    def quaternion(self) -> Quaternion:
        """Attitude, NED from body."""
        return self.state.quaternion

    @property
    def velocity(self) -> Vector:
        """Velocity [m/s, NED]."""
        return self.state.velocity

    @property
    def position(self) -> Geodetic:
        """Position of the IMU."""
        return Geodetic(*self.state.position)

    @property
    def published_position(self) -> Geodetic:
        """Position for the time of the receiver where its stamps are the exact ones, otherwise that of the state."""
        if self.late is None or not self._settings.gnss.stamps_exact:
            return self.position
        north, east, down = self.late.way(self.velocity)
        return geodetic_from_ned_difference((-north, -east, -down), self.position)

    @property
    def ned_from_body(self) -> FloatArray:
        """Attitude as a matrix, shape (3, 3)."""
        return matrix_from_quaternion(self.state.quaternion)

    @property
    def rate(self) -> Vector:
        """Angular rate [rad/s, body] of the last sample, IMU errors removed."""
        return self.state.rate_b

    @property
    def acceleration(self) -> Vector:
        """Acceleration [m/s², NED] of the last sample."""
        return self.state.acceleration_n

    def parameter(self, place: int) -> float:
        """Value of a parameter, by the index of its error in the state."""
        return self.parameters[place - em.DRIVING]

    def parameters_of(self, place: slice) -> FloatArray:
        """Values of a block of parameters, by the indices of their errors in the state."""
        return np.array(self.parameters[place.start - em.DRIVING : place.stop - em.DRIVING])

    def begin_samples(self, row: Sequence[float] | FloatArray) -> None:
        """Measure vibration from the first sample on."""
        if not self._has_sample:
            fx, fy, fz, wx, wy, wz = map(float, row)
            self.state, self._has_sample = self.state._replace(force=(fx, fy, fz), rate=(wx, wy, wz)), True

    def propagate(
        self, samples: Samples, begin: int, end: int, limits: Limits, intervals: Intervals, due_ns: int = NEVER_NS
    ) -> tuple[int, Stop]:
        """Propagate the state over samples; returns how many, and why it stopped: see `propagation.propagate`."""
        times_ns, rows, _ = samples
        if begin < end:
            self.begin_samples(rows[begin])
        loop = propagate_arrays if isinstance(rows, np.ndarray) else propagate
        self.state, taken, stop = loop(self.state, times_ns, rows, begin, end, self.imu, limits, intervals, due_ns)
        return taken, Stop(stop)

    def propagate_covariance(self) -> None:
        """Propagate the covariance to the instant of the state: P = Phi P Phi^T + Q."""
        span_s = self.state.span_s
        if span_s == 0.0:
            return
        row, Ft, decay = step_of(self.row, self.noise)
        self.take(row)
        if self.late is not None:
            self._lag(self.late, span_s)
        self._check()
        if self.recorder is not None:
            self.recorder.record_step(self, Ft, span_s, decay)

    def use_errors(self, name: str, errors: CorrelatedErrors) -> None:
        """Use other statistics of the time-correlated errors of a block."""
        self.errors = {**self.errors, name: errors}

    def change_unit(self, place: slice, ratios: FloatArray) -> None:
        """Change the unit of a block: its values in the old unit are kept, and its variances are scaled.

        `ratios` are the new unit over the old one, shape (m,).
        """
        if self.P[place.start, place.start] == 0.0 or (ratios == 1.0).all():
            return
        if self.recorder is not None:
            self.recorder.record_rescaling(self.time_ns, place, ratios, self.P[place])
        self.P = rescaled(self.P, place, ratios)
        begin, end = place.start - em.DRIVING, place.stop - em.DRIVING
        values = self.parameters_of(place) / ratios
        self.parameters = (*self.parameters[:begin], *values.tolist(), *self.parameters[end:])

    def correct_delay(self, position_s: float, velocity_s: float, *, moved: bool = True) -> None:
        """Take fixes to be older than their stamps from now on, and go the way that they were behind, if `moved`.

        What is left of the way is allowed for by a half of it: a delay that is found scatters, and the vehicle did not
        keep its velocity in it.
        """
        more_s = position_s - (self.late.position_s if self.late is not None else 0.0)
        self.propagate_covariance()
        self.late = FixDelay(position_s, velocity_s, self.velocity) if position_s or velocity_s else None
        north, east, down = (more_s * part for part in self.velocity)
        if moved:
            place = geodetic_from_ned_difference((north, east, down), self.position)
            self.inertial = self.inertial._replace(position=place)
        self.inflate_along(em.POSITION, UNCERTAIN_SHARE * np.array([north, east, down]))

    def _lag(self, late: FixDelay, span_s: float) -> None:
        """Let the velocity of the delay ago follow, and the position be less sure where it changes.

        Its variance grows by (d_p c / 4)² in the delay T, with the change c: found delays scatter by a quarter.
        """
        change, share = late.change(self.velocity), SCATTER * late.position_s / late.longest_s
        self.inflate_along(em.POSITION, share * sqrt(late.longest_s * span_s) * np.array(change))
        left = exp(-span_s / late.longest_s)
        x, y, z = change
        self.late = late._replace(velocity=minus(self.velocity, (left * x, left * y, left * z)))

    def begin_standstill(self) -> None:
        """Begin a new interval between two zero-velocity updates."""
        self.state = self.state._replace(standstill_s=0.0, standstill_rotation_b=ZERO)

    def begin_non_holonomic(self) -> None:
        """Begin a new interval between two updates by the non-holonomic constraint."""
        self.state = self.state._replace(since_non_holonomic_s=0.0)

    def inflate(
        self, *, attitude_sd: float = 0.0, velocity_sd: float = 0.0, position_sd: float = 0.0, height_sd: float = 0.0
    ) -> None:
        """Add variances to P: standard deviations [rad, m/s, m] of errors that the error model does not contain."""
        self.propagate_covariance()
        inflated = self.P.copy()
        diagonal = np.einsum("ii->i", inflated)
        diagonal[em.ATTITUDE] += attitude_sd**2
        diagonal[em.VELOCITY] += velocity_sd**2
        diagonal[em.POSITION] += position_sd**2
        diagonal[em.POSITION.stop - 1] += height_sd**2
        self.P = inflated

    def inflate_along(self, block: slice, error: FloatArray) -> None:
        """Add to P the covariance of an error along a direction, shape (3,), of one block of the state, in its unit."""
        self.P = inflated_along(self.P, block, error)

    def reset_block(self, name: str) -> None:
        """Set the parameters of a block and their variances to those of a start."""
        block = LAYOUT.block(name)
        self.set_parameters(LAYOUT.place(name), block.sd(self._settings))

    def set_parameters(self, place: slice, sd: float) -> None:
        """Set parameters of a block to zero with a standard deviation, independent of the estimate before."""
        for k in range(place.start, place.stop):
            self.set_parameter(k, 0.0, sd)

    def set_parameter(self, place: int, value: float, sd: float) -> None:
        """Set a parameter and its variance, independent of the estimate before."""
        own = place - em.DRIVING
        self.parameters = (*self.parameters[:own], value, *self.parameters[own + 1 :])
        self.P = self.P.copy()
        self.P[place] = self.P[:, place] = 0.0
        self.P[place, place] = sd**2
        if self.recorder is not None:
            self.recorder.record_reset(self.time_ns, place)

    def innovate(self, z: FloatArray, H: FloatArray, R: FloatArray) -> Correction:
        """Compute the correction by a measurement z = H x + noise of covariance R; the state is not changed.

        H may have columns of all states, as aids make it: those of states that are left out are not used.
        """
        self.propagate_covariance()
        return correct(self.P, z, em.fitting(H, self.P), R)

    def apply(self, correction: Correction) -> None:
        """Subtract the estimated errors from the state, after which their estimate is zero."""
        self.subtract_errors(correction.x, correction.P)
        if self.recorder is not None:
            self.recorder.record_correction(self.time_ns, correction)

    def subtract_errors(self, errors: FloatArray, P: FloatArray) -> None:
        """Subtract errors x, shape (n,), from the state, true = estimated - x, and set the covariance P after it."""
        self.take(subtracted(self.row, errors, P))
        self._check()

    def _check(self) -> None:
        """Raise `FilterDiverged` if P is not finite with positive variances, or the state is implausible."""
        if fault := fault_of(self.row):
            raise diverged(fault)


@compilable
def inflated_along(P: FloatArray, block: slice, error: FloatArray) -> FloatArray:
    """Covariance to which that of an error, shape (3,), of one block of the state was added."""
    after = P.copy()
    after[block, block] += error.reshape(3, 1) * error
    return after


def rescaled(P: FloatArray, place: slice, ratios: FloatArray) -> FloatArray:
    """Covariance after a change of unit of some errors u, whose numerical values and variances are kept.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance before.
    place : slice
        Indices of u; all of these errors have a variance above zero.
    ratios : ndarray, shape (m,)
        [-] New unit of each error over the old one.

    Returns
    -------
    ndarray, shape (n, n)
        The part of the other errors x that is correlated with u is scaled by the ratios, as if the new unit had been
        used from the start; the uncorrelated part is kept.

    Notes
    -----
    With P_xu, P_uu the blocks of P and D = diag(ratios)::

        A = P_xu P_uu^-1,  x = A u + rest  ->  A D u + rest,  P+ = (I + W) P (I + W)^T  with  W = A (D - I)
    """
    A = P[:, place].dot(np.linalg.inv(P[place, place]))
    A[place] = 0.0
    W = A * (ratios - 1.0)
    half = P + W.dot(P[place])
    after = half + half[:, place].dot(W.T)
    symmetric: FloatArray = after + after.T
    symmetric *= 0.5
    return symmetric
