"""The loop over ordinary samples as machine code where Numba is installed: the same functions, the same results.

`pip install .[fast]` brings Numba. It compiles for seconds once; from then on processes load what it has made, and not
Numba.
"""

from collections.abc import Callable
from typing import Any

from shared.maths.compiling import Program, machine_code

from ..update import standstill_detector
from . import error_model, imu_step, loops, machine, propagation, strapdown
from .error_model import SIZE
from .machine import BLOCK, ERRORS, FAILED, GROW, LIMITS, ROOM, TABLE_ROWS, WALKS, Machine

SIGNATURE = "int64(CPointer(float64), CPointer(float64), CPointer(int64), CPointer(float64), int64)"

PARTS = (
    strapdown.parallel, strapdown.turn_terms, strapdown.turned, strapdown.mechanise,
    imu_step.take_sample, imu_step.means,
    standstill_detector.blend, standstill_detector.length, standstill_detector.at_rest, standstill_detector.doubt_of,
    error_model.error_rates, propagation.sound, propagation.run,
    machine.three, machine.moment_of, machine.numbers_of, *loops.PARTS,
)  # fmt: skip


def _main(array_at: Callable[..., Any]) -> Callable[..., Any]:
    """Make the function that is called from outside, with addresses."""
    three, moment_of, numbers_of = machine.three, machine.moment_of, machine.numbers_of
    run, grow = propagation.run, propagation.grow
    correct = loops.correct

    def main(block_at: Any, P_at: Any, times_at: Any, samples_at: Any, count: int) -> int:
        if count == GROW:
            block, P = array_at(block_at, (BLOCK,)), array_at(P_at, (ROOM, SIZE))
            motion, sums, shaking, _, _, _, _, _ = moment_of(block)
            _, fine = grow(P, motion, sums, block[WALKS:], shaking, block[LIMITS], block[LIMITS + 1])
            return 1 if fine else FAILED
        if count < GROW:
            table = array_at(samples_at, (TABLE_ROWS, SIZE))
            return 1 if correct(array_at(P_at, (ROOM, SIZE)), table, GROW - count) else FAILED
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


PROGRAM = Program(_main, SIGNATURE, PARTS, {propagation.grow: loops.grow})


def compiled_runner() -> Machine | None:
    """Load the compiled loop for one navigator, or make it; None where Numba is not installed."""
    code = machine_code(PROGRAM)
    return None if code is None else Machine(code)
