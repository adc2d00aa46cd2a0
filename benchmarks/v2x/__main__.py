"""Run this benchmark: `python -m benchmarks.v2x`."""

import sys

from benchmarks.v2x.report import main

sys.exit(main(sys.argv[1:]))
