"""The paper's method on recorded arrays: differenced GNSS velocity against accelerometer, compass and barometer.

Fixes come at 1 Hz, sensors at a multiple of it. Interval k is [k - 1, k) s: both sides are means over it. The sensors'
axes are the device's own. The paper high-passes the specific force in the vehicle's axes and turns it by the course of
GNSS; the improved methods take east, north and up from gravity and field, or from an attitude.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.signal import butter, sosfilt, sosfilt_zi

from services.core.spoofing.inertial.compass import device_from_enu
from services.core.spoofing.windows.metrics import Metric
from shared.maths.earth import STANDARD_GRAVITY, wrap_angles

FloatArray = npt.NDArray[np.float64]

CUT_OFF_HZ = 0.12
WINDOW = 5  # [epochs of 1 s]
MIN_SPEED = 1.0  # [m/s] for the heading rate
GRAVITY_LOW_PASS_HZ = 0.01  # with 0.05 Hz seconds of braking tilt the compass: M has twice the sigma


def high_pass(values: FloatArray, rate_hz: float, *, cut_off_hz: float = CUT_OFF_HZ) -> FloatArray:
    """Butterworth high-pass of order 2, causal, in its steady state of the first sample.

    Parameters
    ----------
    values : ndarray, shape (n, ...)
        Samples along the first axis.
    rate_hz, cut_off_hz : float
        [Hz] Sampling rate, and frequency at which the gain is 1/sqrt(2).

    Returns
    -------
    ndarray, shape (n, ...)
        Starts at 0. From rest, a gravity of 9.81 m/s² would otherwise be a transient of 10 s.
    """
    return _filtered(values, "highpass", rate_hz, cut_off_hz)


def low_pass(values: FloatArray, rate_hz: float) -> FloatArray:
    """Butterworth low-pass of order 2 and `GRAVITY_LOW_PASS_HZ`, causal, in its steady state of the first sample."""
    return _filtered(values, "lowpass", rate_hz, GRAVITY_LOW_PASS_HZ)


def _filtered(
    values: FloatArray, kind: Literal["lowpass", "highpass"], rate_hz: float, cut_off_hz: float
) -> FloatArray:
    sections = butter(2, cut_off_hz, kind, fs=rate_hz, output="sos")
    zi = np.multiply.outer(sosfilt_zi(sections), values[0])
    filtered: FloatArray = sosfilt(sections, values, axis=0, zi=zi)[0]
    return filtered


@dataclass(frozen=True)
class Rates:
    """Heading rate [rad/s], acceleration [m/s², ENU] and altitude rate [m/s], each a mean over 1 s."""

    heading_rate: FloatArray  # shape (n,)
    acceleration: FloatArray  # shape (n, 3)
    altitude_rate: FloatArray  # shape (n,)

    def part(self, seconds: slice) -> "Rates":
        """Rates of some of the seconds."""
        return Rates(self.heading_rate[seconds], self.acceleration[seconds], self.altitude_rate[seconds])


def gnss_rates(velocity_enu: FloatArray, *, filtered: bool = False, cut_off_hz: float = CUT_OFF_HZ) -> Rates:
    """Rates of GNSS velocities at 1 Hz.

    Parameters
    ----------
    velocity_enu : ndarray, shape (n + 1, 3)
        [m/s, ENU] One velocity a second.
    filtered : bool
        Whether the high-pass of the accelerometer is used on the velocity differences as well. The paper does not:
        its metric is then the acceleration of the vehicle itself.
    cut_off_hz : float
        [Hz] Of the high-pass.

    Returns
    -------
    Rates
        n seconds.
    """
    course = np.arctan2(velocity_enu[:, 0], velocity_enu[:, 1])
    acceleration = np.diff(velocity_enu, axis=0)
    return Rates(
        wrap_angles(np.diff(course)),
        high_pass(acceleration, 1.0, cut_off_hz=cut_off_hz) if filtered else acceleration,
        0.5 * (velocity_enu[1:, 2] + velocity_enu[:-1, 2]),
    )


def paper_rates(
    force: FloatArray,
    field: FloatArray,
    height: FloatArray,
    rate_hz: int,
    vehicle_from_device: FloatArray,
    *,
    cut_off_hz: float = CUT_OFF_HZ,
) -> Rates:
    """Rates of a phone's sensors as in the paper, with the acceleration in the axes of the vehicle.

    Parameters
    ----------
    force, field : ndarray, shape (n · rate_hz, 3)
        [m/s²], [any unit]; device axes. Specific force and magnetic field; sample 0 belongs to the first fix.
    height : ndarray, shape (n · rate_hz,)
        [m] Barometric.
    rate_hz : int
        [Hz] Samples a second.
    vehicle_from_device : ndarray, shape (3, 3)
        Mounting: rotation to forward, right, down. The paper's phone lies in the axes of the car.
    cut_off_hz : float
        [Hz] Of the high-pass that removes gravity, in the vehicle's axes.

    Returns
    -------
    Rates
        n - 1 seconds, between the first sample of each second and the next; `turned_by_course` makes them comparable.
    """
    acceleration = high_pass(force @ vehicle_from_device.T, float(rate_hz), cut_off_hz=cut_off_hz)
    return _with_compass(device_from_enu(force, field), acceleration, height, rate_hz)


def turned_by_course(rates: Rates, velocity_enu: FloatArray) -> Rates:
    """Turn accelerations from forward, right, down to east, north, up by the course of GNSS.

    Parameters
    ----------
    rates : Rates
        Of n seconds, by `paper_rates`.
    velocity_enu : ndarray, shape (n + 1, 3)
        [m/s, ENU] By GNSS, which an attack changes; the course of a second is that of its mean velocity, and stays as
        it was below 1 m/s.
    """
    mean = 0.5 * (velocity_enu[1:, :2] + velocity_enu[:-1, :2])
    moving = np.hypot(mean[:, 0], mean[:, 1]) > MIN_SPEED
    newest = np.maximum.accumulate(np.where(moving, np.arange(len(mean)), -1))
    first = int(np.argmax(moving))  # the course before it is not known: that of the first is taken
    course = np.arctan2(mean[:, 0], mean[:, 1])[np.where(newest < 0, first, newest)]
    forward, right, down = rates.acceleration.T
    acceleration = np.column_stack([
        forward * np.sin(course) + right * np.cos(course), forward * np.cos(course) - right * np.sin(course), -down,
    ])  # fmt: skip
    return Rates(rates.heading_rate, acceleration, rates.altitude_rate)


def mounting_of(force: FloatArray, gravity: FloatArray, velocity_enu: FloatArray) -> FloatArray:
    """Rotation from device axes to forward, right, down, by gravity and the accelerations of GNSS.

    Parameters
    ----------
    force, gravity : ndarray, shape (n, 3)
        [m/s²] At 1 Hz, device axes; gravity points up, as a specific force at rest.
    velocity_enu : ndarray, shape (n, 3)
        [m/s, ENU] By GNSS.

    Notes
    -----
    Down is the mean of gravity. With the level force z = x + iy and the acceleration w = forward + i right of GNSS, the
    turn about it is the angle of sum conj(z) w, which is the least-squares one.
    """
    down = -gravity.mean(axis=0)
    down /= np.linalg.norm(down)
    aside = np.cross(down, np.eye(3)[int(np.argmin(np.abs(down)))])
    ahead = aside / np.linalg.norm(aside)
    level = np.stack([ahead, np.cross(down, ahead), down])
    mean = 0.5 * (velocity_enu[1:] + velocity_enu[:-1])
    change, course = np.diff(velocity_enu, axis=0), np.arctan2(mean[:, 0], mean[:, 1])
    along = change[:, 0] * np.sin(course) + change[:, 1] * np.cos(course)
    across = change[:, 0] * np.cos(course) - change[:, 1] * np.sin(course)
    moving = np.hypot(mean[:, 0], mean[:, 1]) > MIN_SPEED
    x, y, _ = level @ (force - gravity)[1:].T
    angle = np.angle(np.sum(((x - 1j * y) * (along + 1j * across))[moving]))
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    mounting: FloatArray = turn @ level
    return mounting


def sensor_rates(
    force: FloatArray, field: FloatArray, height: FloatArray, rate_hz: int, *, cut_off_hz: float = CUT_OFF_HZ
) -> Rates:
    """Rates of a phone's sensors in east, north, up, with a low-pass of the specific force as gravity.

    Parameters
    ----------
    force, field, height, rate_hz, cut_off_hz
        As of `paper_rates`.

    Returns
    -------
    Rates
        n - 1 seconds, between the first sample of each second and the next.

    Notes
    -----
    With the force itself as gravity, up would be its own direction, and the horizontal acceleration zero.
    """
    d_from_enu = device_from_enu(low_pass(force, float(rate_hz)), field)
    acceleration = high_pass(np.einsum("nji,nj->ni", d_from_enu, force), float(rate_hz), cut_off_hz=cut_off_hz)
    return _with_compass(d_from_enu, acceleration, height, rate_hz)


def _with_compass(d_from_enu: FloatArray, acceleration: FloatArray, height: FloatArray, rate_hz: int) -> Rates:
    """Accelerations as means of seconds, with the heading rate of a compass and the altitude rate of a barometer."""
    heading = np.arctan2(d_from_enu[:, 1, 0], d_from_enu[:, 1, 1])  # of the device's y axis
    whole = slice(0, len(height) // rate_hz * rate_hz, rate_hz)
    return Rates(wrap_angles(np.diff(heading[whole])), _second_means(acceleration, rate_hz), np.diff(height[whole]))


def attitude_rates(
    force: FloatArray, rate: FloatArray, height: FloatArray, d_from_enu: FloatArray, rate_hz: int
) -> Rates:
    """Rates of a phone that knows its attitude: heading rate by gyroscopes, gravity removed without a high-pass.

    Parameters
    ----------
    force, rate : ndarray, shape (n · rate_hz, 3)
        [m/s²], [rad/s]; device axes. Specific force and angular rate.
    height : ndarray, shape (n · rate_hz,)
        [m] Barometric.
    d_from_enu : ndarray, shape (n · rate_hz, 3, 3)
        Attitude: columns are east, north and up in device axes.
    rate_hz : int
        [Hz] Samples a second.

    Returns
    -------
    Rates
        n - 1 seconds, as `sensor_rates`.
    """
    acceleration = np.einsum("nji,nj->ni", d_from_enu, force) - [0.0, 0.0, STANDARD_GRAVITY]
    turn = -np.einsum("nj,nj->n", rate, d_from_enu[:, :, 2])  # clockwise from above
    whole = slice(0, len(force) // rate_hz * rate_hz, rate_hz)
    return Rates(_second_means(turn, rate_hz), _second_means(acceleration, rate_hz), np.diff(height[whole]))


def _second_means(values: FloatArray, rate_hz: int) -> FloatArray:
    """Means over each second but the last one, shape (n - 1, ...)."""
    seconds = len(values) // rate_hz
    means: FloatArray = values[: seconds * rate_hz].reshape(seconds, rate_hz, *values.shape[1:]).mean(axis=1)
    return means[:-1]


def metrics(gnss: Rates, sensors: Rates, speed: FloatArray) -> dict[Metric, FloatArray]:
    """Signed differences of 5 s means; NaN where a metric is not defined.

    Parameters
    ----------
    gnss, sensors : Rates
        n seconds each.
    speed : ndarray, shape (n + 1,)
        [m/s] By GNSS at the epochs: the heading rate needs more than 1 m/s in the whole window.

    Returns
    -------
    dict of ndarray, shape (n - 4,)
        GNSS minus sensors, of the window that ends with each second.
    """
    difference = window_mean(gnss.acceleration) - window_mean(sensors.acceleration)
    magnitude = [np.linalg.norm(rates.acceleration, axis=1) for rates in (gnss, sensors)]
    heading = window_mean(gnss.heading_rate) - window_mean(sensors.heading_rate)
    slowest = np.lib.stride_tricks.sliding_window_view(speed, WINDOW + 1).min(axis=1)
    return {
        Metric.HEADING_RATE: np.where(slowest > MIN_SPEED, heading, np.nan),
        Metric.ACCELERATION_EAST: difference[:, 0],
        Metric.ACCELERATION_NORTH: difference[:, 1],
        Metric.ACCELERATION_UP: difference[:, 2],
        Metric.ACCELERATION: window_mean(magnitude[0]) - window_mean(magnitude[1]),
        Metric.ALTITUDE_RATE: window_mean(gnss.altitude_rate) - window_mean(sensors.altitude_rate),
    }


def paper_sigma(gnss_error: FloatArray, sensor_error: FloatArray) -> float:
    """The paper's sigma: sqrt(var_gnss + var_sensors) of the errors at 1 Hz, although the metric is a mean of 5 s.

    The mean of a differenced series telescopes, so that this is 2 to 4 times too wide for heading and altitude rate.
    """
    return float(np.sqrt(np.nanvar(gnss_error) + np.nanvar(sensor_error)))


def window_mean(values: FloatArray) -> FloatArray:
    """Mean of each 5 successive seconds, shape (n - 4, ...)."""
    means: FloatArray = np.lib.stride_tricks.sliding_window_view(values, WINDOW, axis=0).mean(axis=-1)
    return means
