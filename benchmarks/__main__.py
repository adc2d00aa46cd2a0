"""Run every benchmark: `python -m benchmarks`."""

import sys

from benchmarks.bus.report import main

sys.exit(main(sys.argv[1:]))
