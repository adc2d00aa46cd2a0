"""The loop over ordinary samples, compiled by Numba where that is installed: the same functions, the same results.

`pip install .[fast]` brings Numba. It compiles for seconds once, and keeps what it has made in its cache.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from shared.compiling import compiled

from . import error_model, kalman, ordinary, sampling, stationary, strapdown
from .ordinary import Run

FloatArray = npt.NDArray[np.float64]

PARTS = (
    strapdown.parallel, strapdown.turn_terms, strapdown.turned, strapdown.mechanise,
    sampling.take_sample, sampling.means,
    stationary.blend, stationary.length, stationary.at_rest,
    error_model.error_rates, error_model.system_matrix, error_model.with_vibration,
    kalman.predict, kalman.decay, ordinary.sound,
)  # fmt: skip
COLUMNS = error_model.DRIVING
ROWS = error_model.MOVING
PLACES = error_model.PLACES


# What NumPy does in one call, and a compiler in loops.


def _product(left: FloatArray, right: FloatArray) -> FloatArray:
    product = np.zeros((left.shape[0], right.shape[1]))
    for i in range(left.shape[0]):
        for j in range(left.shape[1]):
            if left[i, j] != 0.0:
                for k in range(right.shape[1]):
                    product[i, k] += left[i, j] * right[j, k]
    return product


def _variances(P: FloatArray, count: int) -> tuple[float, float]:
    total, least = 0.0, P[0, 0]
    for i in range(len(P)):
        total += P[i, i]
        if i < count and P[i, i] < least:
            least = P[i, i]
    return total, least


def _scattered(values: tuple[float, ...]) -> FloatArray:
    F = np.zeros((ROWS, COLUMNS))
    for i in range(len(PLACES)):
        F[PLACES[i] // COLUMNS, PLACES[i] % COLUMNS] = values[i]
    return F


LOOPS: dict[Callable[..., Any], Callable[..., Any]] = {
    kalman.product: _product,
    kalman.variances: _variances,
    error_model.scattered: _scattered,
}


@cache
def compiled_run() -> Run | None:
    """Compile `ordinary.run`, or fetch what was made of it before; None where Numba is not installed."""
    return compiled(ordinary.run, PARTS, LOOPS)
