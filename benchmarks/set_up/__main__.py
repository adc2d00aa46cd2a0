"""Run this benchmark: `python -m benchmarks.set_up`."""

import sys

from benchmarks.set_up.report import main

sys.exit(main(sys.argv[1:]))
