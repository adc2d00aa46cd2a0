"""Heights of GNSS that have the wrong sign, as the check of the set-up has found."""

import numpy as np

from ...inertial import error_model as em
from ...inertial.filter import ErrorStateFilter

MIN_HEIGHT_M = 10.0  # a height near zero, of which the sign hardly matters
GRAVITY_GRADIENT = 3.1e-6  # [1/s²] decrease of gravity per metre of height
SLOPE = 0.2  # [-] twice that of a steep road, which the climb had with the wrong sign


def inflate_for_wrong_heights(navigation: ErrorStateFilter) -> None:
    """Inflate the covariance of the height by twice the height, and of the climb by that of a road.

    The bias of the accelerometers along the vertical has taken up the gravity of the wrong height, which would tell the
    same height again.
    """
    wrong_m = 2.0 * max(abs(navigation.position.height), MIN_HEIGHT_M)
    navigation.inflate(height_sd=wrong_m)
    vertical_b = navigation.ned_from_body[2]
    navigation.inflate_along(em.ACCELEROMETER_BIAS, GRAVITY_GRADIENT * wrong_m * vertical_b)
    north, east, _ = navigation.velocity
    navigation.inflate_along(em.VELOCITY, np.array([0.0, 0.0, SLOPE * float(np.hypot(north, east))]))
