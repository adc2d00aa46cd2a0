"""Compiles what Numba compiles, once: `python -m tests.support.warm`; else each worker of pytest would, for 7 s."""

import sys

from benchmarks.integrity.simulated import CASES, judge_run
from shared.maths.compiled import COMPILED

if __name__ == "__main__":
    for seed in (0, 1):  # without and with an odometer
        judge_run(CASES[0], seed)
    sys.exit(0 if COMPILED else "Numba is not installed, or left out by NUMBA_DISABLE_JIT")
