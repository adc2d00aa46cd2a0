"""A copy of the tree, in which a fault is put and its tests are run."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from tests.support.copied import copied_tree

from .covering import Selection
from .sites import Site

LIMIT_S = 60  # of processor time: a busy machine lets no fault through
HANGS_S = 300.0  # time in which it is used, or nothing is calculated
FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+?\.py(?:::.+?)?)(?: - .*)?$", re.MULTILINE)
NO_TEST = 5  # what pytest returns where every test was deselected


class MutantResult(NamedTuple):
    """A fault, and what the tests said."""

    site: Site
    outcome: str  # killed, crashed, time out, survived, untested, equivalent
    how: str  # how the tests were chosen; of an equivalent one, why it is
    test: str = ""  # that failed

    @property
    def row(self) -> str:
        """Line of the table."""
        site = self.site
        replacement = " ".join(site.replacement.split())[:60].replace("|", "\\|")
        by = f" by `{self.test.replace('|', chr(92) + '|')}`" if self.test else ""
        return f"| `{site.path}:{site.line}` | {site.kind} | `{replacement}` | {self.outcome}{by} | {self.how} |"


class Copy:
    """A copy of what git knows of a tree, beside the libraries that set-up has put into it."""

    def __init__(self, root: Path, to: Path) -> None:
        """Copy; raises CalledProcessError where `root` is no work tree of git."""
        copied_tree(root, to)
        (to / ".venv").symlink_to(root / ".venv")
        self._folder = to
        self._sound: dict[str, bool] = {}

    def tests(self) -> list[str]:
        """Names of all tests."""
        collected = self._pytest(["--collect-only", "-q", "tests"], limit_s=5 * LIMIT_S)
        return [line for line in collected.stdout.splitlines() if "::" in line] if collected else []

    def tried(self, site: Site, choose: Callable[[Site, str], Selection]) -> MutantResult:
        """Put a fault in, run its tests, and take it out again.

        A test that fails in the copy without the fault finds nothing, and is left out.
        """
        target = self._folder / site.path
        before, source = target.stat(), target.read_text(encoding="utf-8")
        tests, how = choose(site, source)
        left = list(tests)
        while left:
            target.write_text(site.applied(source), encoding="utf-8")
            try:
                outcome, test = self._outcome(left)
            finally:
                target.write_text(source, encoding="utf-8")
                os.utime(target, ns=(before.st_atime_ns, before.st_mtime_ns))  # or its compiled file would be old
            if outcome != "killed" or self._passes(test):
                return MutantResult(site, outcome, how, test)
            left = (
                [*left, "--deselect", test] if how in ("folder", "import") else [name for name in left if name != test]
            )
        return MutantResult(site, "untested", how)

    def _outcome(self, tests: Sequence[str]) -> tuple[str, str]:
        run = self._pytest(["-x", "-q", "-m", "not slow", *tests])
        if run is None:
            return "time out", ""
        if run.returncode == NO_TEST:
            return "untested", ""
        if not run.returncode:
            return "survived", ""
        if (failed := FAILED.search(run.stdout)) is not None:
            return "killed", failed[1]
        return "crashed", tests[0]  # pytest names no test

    def _passes(self, test: str) -> bool:
        if test not in self._sound:
            run = self._pytest(["-x", "-q", test])
            self._sound[test] = run is not None and not run.returncode
        return self._sound[test]

    def _pytest(self, arguments: Sequence[str], limit_s: int = LIMIT_S) -> subprocess.CompletedProcess[str] | None:
        """Run pytest; None where it takes longer than the limit."""
        command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *arguments]
        # Numba would keep what it compiled from a file with a fault, for the next file that calls it.
        environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
        limited = ["prlimit", f"--cpu={limit_s}", *command]
        try:
            run = subprocess.run(
                limited, cwd=self._folder, capture_output=True, text=True, timeout=HANGS_S, check=False, env=environment
            )
        except subprocess.TimeoutExpired:
            return None
        return None if run.returncode in (-signal.SIGXCPU, -signal.SIGKILL) else run
