"""Errors and innovations over what the filter says of them: normalised squares, and the bands that they belong in."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from cli.campaign import Kept
from services.core.fusion.aids.base import Outcome
from services.core.fusion.inertial import error_model as em
from services.core.fusion.inertial.filter import ErrorStateFilter
from services.sensors.simulator.drive import Drive
from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.maths.rotation import ned_from_body
from shared.messages.navigation import AidingKind

FloatArray = npt.NDArray[np.float64]

STATES = slice(0, em.ACCELEROMETER_SCALE.start)
BLOCKS = {
    "attitude": em.ATTITUDE,
    "velocity": em.VELOCITY,
    "position": em.POSITION,
    "accelerometer bias": em.ACCELEROMETER_BIAS,
    "gyroscope bias": em.GYROSCOPE_BIAS,
    "all": STATES,
}
INNOVATIONS = (AidingKind.GNSS_VELOCITY, AidingKind.GNSS_POSITION)


@dataclass(frozen=True)
class Sizes:
    """Normalised squares of one run, each over its number of dimensions: one is right."""

    time_s: Kept  # shape (n,)
    errors: Kept  # shape (n, 6) of `BLOCKS`
    innovations: Kept  # shape (n, 2) of velocity and position; NaN where there was none


def error_of(navigation: ErrorStateFilter, drive: Drive, i: int, bias: FloatArray) -> FloatArray:
    """Errors of the state [as in `error_model`], shape (15,), beside the truth at a sample and its true biases."""
    _, _, velocity, position = navigation.inertial
    turned = navigation.ned_from_body @ ned_from_body(*drive.attitude[i].tolist()).T
    true = Geodetic(*drive.position[i].tolist())
    known = (*navigation.imu.accelerometer_bias, *navigation.imu.gyroscope_bias)
    return np.concatenate(
        [
            Rotation.from_matrix(turned).as_rotvec(),
            velocity - drive.velocity_n[i],
            ned_from_geodetic_difference(position, true),
            known - bias,
        ]
    )


def sizes_of(navigation: ErrorStateFilter, error: FloatArray) -> list[float]:
    """Normalised squares of the blocks of an error, each over its number of dimensions."""
    P = navigation.P[STATES, STATES]
    return [float(error[b] @ np.linalg.solve(P[b, b], error[b])) / (b.stop - b.start) for b in BLOCKS.values()]


def innovation_size(outcomes: Sequence[Outcome], kind: AidingKind) -> float:
    """Mean square of the normalised innovations of a kind, over the axes and all observations; NaN without any."""
    seen = [np.square(o.innovation) / np.square(o.innovation_sd) for o in outcomes if o.kind is kind]
    return float(np.concatenate(seen).mean()) if seen else float("nan")
