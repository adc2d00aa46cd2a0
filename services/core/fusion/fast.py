"""The loop over ordinary samples as machine code where Numba is installed: the same functions, the same results.

`pip install .[fast]` brings Numba. It compiles for seconds once; from then on processes load what it has made, and not
Numba.
"""

from collections.abc import Callable
from math import isfinite
from typing import Any

from shared.compiling import Program, machine_code

from . import error_model, machine, ordinary, sampling, stationary, strapdown
from .kalman import FloatArray
from .machine import BLOCK, ERRORS, LIMITS, ROOM, WALKS, Machine
from .sampling import Shaking, Sums
from .strapdown import Motion

SIGNATURE = "int64(CPointer(float64), CPointer(float64), CPointer(int64), CPointer(float64), int64)"
SIZE, ROWS, COLUMNS, PLACES = error_model.SIZE, error_model.MOVING, error_model.DRIVING, error_model.PLACES
VELOCITY, POSITION = error_model.VELOCITY.start, error_model.POSITION.start
LASTING_FIRST, LASTING_END = error_model.GNSS_ERROR.start, error_model.GNSS_ERROR.stop
CERTAIN = error_model.ACCELEROMETER_SCALE.start


def _grow(
    P: FloatArray, motion: Motion, sums: Sums, walks: FloatArray, shaking: Shaking, factor: float, remains: float
) -> tuple[FloatArray, bool]:
    """`ordinary.grow` in loops, which allocate nothing: P has room below the covariance, and is changed in place."""
    force_n, rate_b = sampling.means(sums)
    _predict(P, error_model.error_rates(motion, force_n, rate_b), sums[0])
    for i in range(SIZE):
        density = walks[i]
        if i < POSITION:
            density = max(density, factor * (shaking[1] if i < VELOCITY else shaking[0]))
        P[SIZE + i, i] += density * sums[0]
    if remains < 1.0:
        _decay(P, remains)
    total, least = 0.0, P[SIZE, 0]
    for i in range(SIZE):
        total += P[SIZE + i, i]
        if i < CERTAIN:
            least = min(least, P[SIZE + i, i])
    fine = isfinite(total) and least > 0.0
    if fine:
        for i in range(SIZE):
            for k in range(SIZE):
                P[i, k] = P[SIZE + i, k]
    return P, fine


def _predict(P: FloatArray, rates: tuple[float, ...], step: float) -> None:
    """`kalman.predict` without noise, into the next rows of P; the rows behind them hold F t."""
    new, Ft = SIZE, 2 * SIZE
    for i in range(ROWS):
        for j in range(COLUMNS):
            P[Ft + i, j] = 0.0
    for n in range(len(PLACES)):
        P[Ft + PLACES[n] // COLUMNS, PLACES[n] % COLUMNS] = rates[n] * step
    for i in range(SIZE):
        for k in range(SIZE):
            P[new + i, k] = P[i, k]
    for i in range(ROWS):
        for j in range(COLUMNS):
            if P[Ft + i, j] != 0.0:
                for k in range(SIZE):
                    P[new + i, k] += P[Ft + i, j] * P[j, k]
    _square(P)


def _square(P: FloatArray) -> None:
    """Multiply the next rows of P by F t from the right, into the columns beside F t, and make all symmetric."""
    new, Ft = SIZE, 2 * SIZE
    for i in range(ROWS):
        for k in range(ROWS):
            P[Ft + i, COLUMNS + k] = P[new + i, k]
            for j in range(COLUMNS):
                P[Ft + i, COLUMNS + k] += P[new + i, j] * P[Ft + k, j]
    for i in range(ROWS):
        for k in range(ROWS):
            P[new + i, k] = 0.5 * (P[Ft + i, COLUMNS + k] + P[Ft + k, COLUMNS + i])
        for k in range(ROWS, SIZE):
            P[new + k, i] = P[new + i, k]


def _decay(P: FloatArray, remains: float) -> None:
    """`kalman.decay` of the next covariance."""
    for i in range(LASTING_FIRST, LASTING_END):
        for k in range(SIZE):
            P[SIZE + i, k] *= remains
        for k in range(SIZE):
            P[SIZE + k, i] *= remains
        P[SIZE + i, i] += 1.0 - remains * remains


PARTS = (
    strapdown.parallel, strapdown.turn_terms, strapdown.turned, strapdown.mechanise,
    sampling.take_sample, sampling.means, sampling.usual,
    stationary.blend, stationary.length, stationary.at_rest, stationary.doubt_of,
    error_model.error_rates, ordinary.sound, ordinary.run,
    machine.three, machine.moment_of, machine.numbers_of, _predict, _square, _decay,
)  # fmt: skip


def _main(array_at: Callable[..., Any]) -> Callable[..., Any]:
    """Make the function that is called from outside, with addresses."""
    three, moment_of, numbers_of = machine.three, machine.moment_of, machine.numbers_of
    usual, run = sampling.usual, ordinary.run

    def main(block_at: Any, P_at: Any, times_at: Any, samples_at: Any, count: int) -> int:
        if count < 0:  # of one sample, and only if nobody else has to look at it
            count = 1
            block, row = array_at(block_at, (BLOCK,)), array_at(samples_at, (6,))
            last = moment_of(block)[3]
            if not usual((three(row, 0), three(row, 3)), last):
                return 0
        block, P = array_at(block_at, (BLOCK,)), array_at(P_at, (ROOM, SIZE))
        times, samples = array_at(times_at, (count + 1,)), array_at(samples_at, (count, 6))
        e, n = ERRORS, LIMITS
        errors = three(block, e), three(block, e + 3), three(block, e + 6), three(block, e + 9)
        limits = block[n], block[n + 1], block[n + 2], block[n + 3], block[n + 4], block[n + 5]
        taken, moment, _ = run(moment_of(block), P, times, samples, errors, block[WALKS:], limits)
        numbers = numbers_of(moment)
        for place in range(len(numbers)):
            block[place] = numbers[place]
        return taken

    return main


PROGRAM = Program(_main, SIGNATURE, PARTS, {ordinary.grow: _grow})


def compiled_runner() -> Machine | None:
    """Load the compiled loop for one navigator, or make it; None where Numba is not installed."""
    code = machine_code(PROGRAM)
    return None if code is None else Machine(code)
