"""Run the campaign: `python -m benchmarks.consistency --runs 50`."""

import sys

from benchmarks.consistency.report import main

sys.exit(main())
