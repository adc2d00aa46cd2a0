"""What holds for every test: hypothesis draws the same examples each time, and never for a time limit.

Linear algebra has one thread, as in a vehicle: the workers of pytest have the cores already, and with more threads than
cores a product of small matrices can wait for seconds. NumPy reads the variable when it is imported, after this file.

With OBU_CI=1, which `.ci/run` sets, a test that is skipped fails: nothing is lacking there but what `MAY_LACK` names.
"""

import os
from collections.abc import Generator

import pytest
from hypothesis import settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
settings.register_profile("obu", derandomize=True, deadline=None)
settings.load_profile("obu")

# Beginnings of the reasons of skips that stay skips: recordings are no part of the repository, and some tests are of
# what root alone may do, or may not, or of what a container does not allow.
MAY_LACK = ("recording ", "no recording ", "root ", "only root ", "this system ", "this machine ")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Make a failure of a test that CI should not skip."""
    report = yield
    if os.environ.get("OBU_CI") == "1" and report.skipped and not hasattr(report, "wasxfail"):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        if not reason.removeprefix("Skipped: ").startswith(MAY_LACK):
            report.outcome = "failed"
            report.longrepr = f"{item.nodeid} was skipped, which CI does not allow: {reason}"
    return report
