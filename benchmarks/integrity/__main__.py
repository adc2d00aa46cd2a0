"""Run the campaign: `python -m benchmarks.integrity --runs 1000 --recordings DIR`."""

import sys

from benchmarks.integrity.report import main

sys.exit(main())
