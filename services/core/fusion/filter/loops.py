"""Step and correction of the covariance in loops that allocate nothing: what a compiler is given in place of NumPy."""

from math import isfinite

from . import error_model, imu_step, kalman
from .imu_step import Shaking, Sums
from .kalman import FloatArray
from .machine import DISTANCE2, ESTIMATE, EXPECTED, GAINS, INVERSE, MISFIT, NOISE, SMALL, three
from .strapdown import Motion

SIZE, ROWS, COLUMNS, PLACES = error_model.SIZE, error_model.MOVING, error_model.DRIVING, error_model.PLACES
VELOCITY, POSITION = error_model.VELOCITY.start, error_model.POSITION.start
LASTING_FIRST, LASTING_END = error_model.GNSS_ERROR.start, error_model.GNSS_ERROR.stop
CERTAIN = error_model.ACCELEROMETER_SCALE.start


def grow(
    P: FloatArray, motion: Motion, sums: Sums, walks: FloatArray, shaking: Shaking, factor: float, remains: float
) -> tuple[FloatArray, bool]:
    """`ordinary.grow` in loops, which allocate nothing: P has room below the covariance, and is changed in place."""
    force_n, rate_b = imu_step.means(sums)
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
    """Phi P Phi^T without decay, into the next rows of P; the rows behind them hold F t."""
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
    """Have the lasting errors of GNSS decay in the next covariance, and keep their variance one."""
    for i in range(LASTING_FIRST, LASTING_END):
        for k in range(SIZE):
            P[SIZE + i, k] *= remains
        for k in range(SIZE):
            P[SIZE + k, i] *= remains
        P[SIZE + i, i] += 1.0 - remains * remains


def correct(P: FloatArray, table: FloatArray, size: int) -> bool:
    """`kalman.correct` in loops, into the next rows of P; the rows behind them hold H P, then (A H^T - K R)^T."""
    HP = 2 * SIZE
    for a in range(size):
        _clear(P, HP + a)
        for i in range(SIZE):
            if table[a, i] != 0.0:
                _add(P, HP + a, table[a, i], P, i)
    if not _invert(P, table, size):
        return False
    _clear(table, ESTIMATE)
    for a in range(size):
        _clear(table, GAINS + a)
        for b in range(size):
            _add(table, GAINS + a, table[SMALL + a, INVERSE + b], P, HP + b)
        _add(table, ESTIMATE, table[SMALL + a, MISFIT], table, GAINS + a)
    _take_down(P, table, size)
    return True


def _take_down(P: FloatArray, table: FloatArray, size: int) -> None:
    """The next rows of P by Joseph's form."""
    new, HP, rest = SIZE, 2 * SIZE, 2 * SIZE + size
    for i in range(SIZE):
        for k in range(SIZE):
            P[new + i, k] = P[i, k]
        for a in range(size):
            _add(P, new + i, -table[GAINS + a, i], P, HP + a)
    for a in range(size):
        _clear(P, rest + a)
        for b in range(size):
            _add(P, rest + a, -table[SMALL + b, NOISE + a], table, GAINS + b)
        _add_columns(P, rest + a, table, a)
    for i in range(SIZE):
        for a in range(size):
            _add(P, new + i, -P[rest + a, i], table, GAINS + a)
    for i in range(SIZE):
        for k in range(i):
            P[new + i, k] = P[new + k, i] = 0.5 * (P[new + i, k] + P[new + k, i])


def _clear(A: FloatArray, row: int) -> None:
    for k in range(SIZE):
        A[row, k] = 0.0


def _add(A: FloatArray, row: int, factor: float, B: FloatArray, other: int) -> None:
    """Add to a row of A a multiple of one of B."""
    for k in range(SIZE):
        A[row, k] += factor * B[other, k]


def _add_columns(P: FloatArray, row: int, H: FloatArray, other: int) -> None:
    """Add to a row of P what the next rows of P make of one of H."""
    for k in range(SIZE):
        if H[other, k] != 0.0:
            for i in range(SIZE):
                P[row, i] += P[SIZE + i, k] * H[other, k]


def _invert(P: FloatArray, table: FloatArray, size: int) -> bool:
    """S of a correction, its inverse, and d²."""
    HP = 2 * SIZE
    for a in range(size):
        for b in range(size):
            total = table[SMALL + a, NOISE + b]
            for k in range(SIZE):
                total += table[a, k] * P[HP + b, k]
            table[SMALL + a, EXPECTED + b] = total
    s11, s21, s22, s31, s32, s33 = table[SMALL, EXPECTED], 0.0, 1.0, 0.0, 0.0, 1.0
    if size > 1:
        s21, s22 = table[SMALL + 1, EXPECTED], table[SMALL + 1, EXPECTED + 1]
    if size > 2:
        s31, s32, s33 = three(table[SMALL + 2], EXPECTED)
    fine, i11, i21, i22, i31, i32, i33 = kalman.inverse_elements(s11, s21, s22, s31, s32, s33)
    if not fine:
        return False
    first, second, third = table[SMALL], table[SMALL + 1], table[SMALL + 2]
    first[INVERSE], first[INVERSE + 1], first[INVERSE + 2] = i11, i21, i31
    second[INVERSE], second[INVERSE + 1], second[INVERSE + 2] = i21, i22, i32
    third[INVERSE], third[INVERSE + 1], third[INVERSE + 2] = i31, i32, i33
    distance2 = 0.0
    for a in range(size):
        for b in range(size):
            distance2 += table[SMALL + a, MISFIT] * table[SMALL + a, INVERSE + b] * table[SMALL + b, MISFIT]
    first[DISTANCE2] = distance2
    return isfinite(distance2)


PARTS = kalman.inverse_elements, _predict, _square, _decay, _clear, _add, _add_columns, _invert, _take_down, correct
