"""The loop over ordinary samples where it is machine code, which wants numbers side by side at an address."""

from struct import Struct
from typing import TYPE_CHECKING, Any

import numpy as np

from shared.maths.kalman import Correction, correct

from .error_model import SIZE
from .imu_step import Shaking, Sums
from .kalman import FloatArray
from .propagation import Arithmetic, Departure, Moment, Rows, Stamps
from .runner import Runner
from .strapdown import Motion

if TYPE_CHECKING:
    from shared.maths.compiling import Code

# A block: the numbers of a moment, then errors, limits and walks as of `ordinary.run`.
NUMBERS, ERRORS, LIMITS, WALKS = 58, 58, 70, 76
BLOCK = WALKS + SIZE
ROOM = 2 * SIZE + 9  # rows: the covariance, the next one, and what is between them
MOMENT, HEAD = Struct(f"{NUMBERS}d"), Struct(f"{WALKS}d")
STEP, FACTORS = Struct("28d"), Struct("2d")  # motion, sums, shaking; factor on vibration and what remains
# In place of a number of samples: a step of the covariance, a correction of 1 to 3 components.
GROW, CORRECT = -1, (0, -2, -3, -4)
# The table of a correction. Its rows: three each of H and of K^T; x; three of what has the size of z, side by side.
GAINS, ESTIMATE, SMALL = 3, 6, 7
NOISE, EXPECTED, INVERSE, MISFIT, DISTANCE2 = 0, 3, 6, 9, 10  # columns of R, S, its inverse, z, d²
TABLE_ROWS = 10
FAILED = 0


class Machine(Runner, Arithmetic):
    """Machine code of the loop, with a place of its own to work in.

    Parameters
    ----------
    code : Code
        Takes the addresses of block, covariance, stamps and samples, and how many; returns how many were taken. It
        does other things for numbers below zero: see `GROW` and `CORRECT`.
    """

    wants_arrays = True

    def __init__(self, code: "Code") -> None:
        self._code, self.arithmetic = code, self
        self._block, self._P = np.zeros(BLOCK), np.zeros((ROOM, SIZE))
        self._bytes = self._block.data.cast("B")
        self._places = self._block.ctypes.data, self._P.ctypes.data
        self._table = np.zeros((TABLE_ROWS, SIZE))
        table = self._table.ctypes.data
        self._grow = code.bound(*self._places, table, table, GROW)
        self._correct = [code.bound(*self._places, table, table, what) for what in CORRECT]

    def __call__(self, start: Departure, times_ns: Stamps, samples: Rows) -> tuple[int, Moment, FloatArray]:
        """Do what `ordinary.run` does; stamps and samples are arrays."""
        assert isinstance(times_ns, np.ndarray) and isinstance(samples, np.ndarray)
        moment, P, (b, d, p, q), walks, limits = start
        HEAD.pack_into(self._bytes, 0, *numbers_of(moment), *b, *d, *p, *q, *limits)
        self._block[WALKS:] = walks
        self._P[:SIZE] = P
        taken = self._code(*self._places, times_ns.ctypes.data, samples.ctypes.data, len(samples))
        return taken, moment_of(MOMENT.unpack_from(self._bytes)), self._P[:SIZE].copy()

    def grow(
        self,
        P: FloatArray,
        motion: Motion,
        sums: Sums,
        walks: FloatArray,
        shaking: Shaking,
        factor: float,
        remains: float,
    ) -> tuple[FloatArray, bool]:
        """Do what `ordinary.grow` does."""
        q, v, p, place = motion
        STEP.pack_into(self._bytes, 0, *q, *v, *p, *place, *sums, *shaking)
        FACTORS.pack_into(self._bytes, 8 * LIMITS, factor, remains)
        self._block[WALKS:], self._P[:SIZE] = walks, P
        fine = self._grow() != FAILED
        return self._P[:SIZE].copy(), fine

    def correct(self, P: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray) -> Correction:
        """Do what `kalman.correct` does."""
        size, table = len(z), self._table
        end = SMALL + size
        table[:size], table[SMALL:end, NOISE : NOISE + size], table[SMALL:end, MISFIT] = H, R, z
        self._P[:SIZE] = P
        if self._correct[size]() == FAILED:
            return correct(P, z, H, R)  # which says why
        table, P_after = table.copy(), self._P[SIZE : 2 * SIZE].copy()
        S, inverse = table[SMALL:end, EXPECTED : EXPECTED + size], table[SMALL:end, INVERSE : INVERSE + size]
        distance2, K = table.item(SMALL, DISTANCE2), table[GAINS : GAINS + size].T
        return Correction(table[ESTIMATE], P_after, distance2, z, H, K, S, inverse)


def three(numbers: Any, place: int) -> Any:
    """Vector of three numbers from a place on."""
    return numbers[place], numbers[place + 1], numbers[place + 2]


def moment_of(n: Any) -> Any:
    """Moment of the numbers of a block."""
    place = n[10], n[11], n[12], n[13], n[14], n[15]
    motion = (n[0], n[1], n[2], n[3]), three(n, 4), three(n, 7), place
    sums, shaking = (n[16], n[17], n[18], n[19], n[20], n[21], n[22]), (n[23], n[24], n[25], n[26], n[27])
    last, rate, acceleration, lasting = (three(n, 28), three(n, 31)), three(n, 34), three(n, 37), three(n, 40)
    rest = three(n, 43), three(n, 46), n[49], three(n, 50)
    return motion, sums, shaking, last, rate, acceleration, lasting, (rest, three(n, 53), n[56], n[57])


def numbers_of(moment: Any) -> Any:
    """Numbers of a moment, in the order in which they lie in a block."""
    (q, v, p, place), sums, shaking, (f, w), rate, acceleration, lasting, (rest, turn, still, rolling) = moment
    head = q + v + p + place + sums + shaking + f + w + rate + acceleration + lasting
    return head + rest[0] + rest[1] + (rest[2],) + rest[3] + turn + (still, rolling)
