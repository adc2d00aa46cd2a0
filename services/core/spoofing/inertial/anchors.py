"""What core.fusion publishes, as the start of a propagation."""

from dataclasses import dataclass
from math import radians, sqrt

import numpy as np
import numpy.typing as npt

from shared.maths.rotation import Quaternion, ned_from_body, quaternion_from_matrix
from shared.messages.navigation import FilterState, NavigationSolution

from .propagation import STATE

FloatArray = npt.NDArray[np.float64]

# Elements of FilterState: velocity, attitude, both biases, scale of the odometer, yaw and pitch of the mounting.
ODOMETER_SCALE, MOUNTING_PITCH, MOUNTING_YAW = 21, 22, 23
ELEMENTS = (3, 4, 5, 0, 1, 2, 9, 10, 11, 12, 13, 14, ODOMETER_SCALE, MOUNTING_YAW, MOUNTING_PITCH)


@dataclass(frozen=True)
class Anchor:
    """A solution, with what a window of 5 s needs to know of its errors."""

    time_ns: int
    state: FloatArray  # shape (19,) of `propagation`
    attitude_cov: FloatArray  # shape (3, 3) [rad², NED]
    gyroscope_bias_sd: FloatArray  # shape (3,) [rad/s, body]


@dataclass(frozen=True)
class FilterAnchor:
    """State of fusion's filter, with what it knows of odometer and mounting, and the covariance of all of it."""

    time_ns: int
    state: FloatArray  # shape (19,) of `propagation`
    # shape (3,) [-, rad, rad] speed of the vehicle over that of the odometer; lateral over forward velocity of the
    # body; minus the downward over the forward velocity
    mounting: FloatArray
    covariance: FloatArray  # shape (15, 15) of the errors in the order of `free_propagation`


def anchor_of(solution: NavigationSolution) -> Anchor:
    """Read a solution as the start of a propagation."""
    matrix = ned_from_body(solution.roll_rad, solution.pitch_rad, solution.yaw_rad)
    turned = matrix @ ned_from_body(0.0, 0.0, -(solution.heading_turn_rad or 0.0))
    nn, ne, nd, ee, ed, dd = solution.attitude_cov_ned_rad2
    return Anchor(
        solution.sampled_ns,
        _state(quaternion_from_matrix(turned), solution),
        np.array([[nn, ne, nd], [ne, ee, ed], [nd, ed, dd]]),
        np.array(solution.gyroscope_bias_sd_rad_s or (0.0, 0.0, 0.0)),
    )


def _state(quaternion: Quaternion, of: NavigationSolution | FilterState) -> FloatArray:
    position = radians(of.latitude_deg), radians(of.longitude_deg), of.height_ellipsoid_m
    biases = *of.accelerometer_bias_m_s2, *of.gyroscope_bias_rad_s
    state = np.zeros(STATE)
    state[:-3] = *quaternion, *of.velocity_ned_m_s, *position, *biases
    return state


def is_readable(state: FilterState) -> bool:
    """Whether a filter state has the layout that `filter_anchor_of` reads."""
    size = _size(state)
    return len(state.parameters) >= 3 and size > MOUNTING_YAW and size * (size + 1) // 2 == len(state.covariance)


def _size(state: FilterState) -> int:
    return round((sqrt(8.0 * len(state.covariance) + 1.0) - 1.0) / 2.0)


def filter_anchor_of(state: FilterState) -> FilterAnchor:
    """Read a filter state as the start of a free propagation.

    Notes
    -----
    With k the error of the odometer's scale in fusion (odometer = (1 + k) speed), and the errors of fusion estimated
    minus true, those of the propagation true minus estimated: scale = 1 / (1 + k), d(scale) = -dk / (1 + k)², and the
    mounting angles have the opposite sign.
    """
    size = _size(state)
    P = np.zeros((size, size))
    P[np.triu_indices(size)] = state.covariance
    P = P + np.triu(P, 1).T
    k, pitch, yaw = state.parameters[:3]
    J = np.diag([1.0] * 12 + [-1.0 / (1.0 + k) ** 2, -1.0, -1.0])
    return FilterAnchor(
        state.sampled_ns,
        _state(state.quaternion_ned_from_body, state),
        np.array([1.0 / (1.0 + k), -yaw, -pitch]),
        J @ P[np.ix_(ELEMENTS, ELEMENTS)] @ J.T,
    )
