"""Run this benchmark: `python -m benchmarks.starts`."""

import sys

from benchmarks.starts.report import main

sys.exit(main(sys.argv[1:]))
