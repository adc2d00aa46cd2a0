"""What holds for every test: hypothesis draws the same examples each time, and never for a time limit.

Linear algebra has one thread, as in a vehicle: the workers of pytest have the cores already, and with more threads than
cores a product of small matrices can wait for seconds. NumPy reads the variable when it is imported, after this file.
"""

import os

from hypothesis import settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
settings.register_profile("obu", derandomize=True, deadline=None)
settings.load_profile("obu")
