"""Run this benchmark: `python -m benchmarks.navigation`."""

import sys

from benchmarks.navigation.report import main

sys.exit(main(sys.argv[1:]))
