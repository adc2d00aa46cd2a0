"""Progress of a command on standard error: a bar with the time left on a terminal, otherwise a line every ten seconds.

Use it as::

    with progress_on(Console(stderr=True)) as progress:
        for row in progress.track(rows, total=len(rows), description="exporting"):
            ...
"""

import sys
import time
from typing import Any

from rich.console import Console
from rich.progress import Progress, TaskID

LINE_PERIOD_S = 10.0
SPEED_PERIOD_S = 600.0  # of the mean from which the time left is computed: single steps may take a minute


def progress_on(console: Console) -> Progress:
    """Show tasks with the time left: as bars that vanish at the end on a terminal, otherwise as lines.

    Parameters
    ----------
    console : Console
        On standard error, so that a result on standard output is not mixed with it.

    Returns
    -------
    Progress
        A context manager with the methods of rich: `track`, `add_task`, `update`, `advance`.
    """
    if not console.is_terminal:
        return Lines(console)
    # rich prints standard output above the bars, through `console`: not where it is a pipe or a file.
    shared = sys.stdout.isatty()
    return Progress(console=console, transient=True, redirect_stdout=shared, speed_estimate_period=SPEED_PERIOD_S)


class Lines(Progress):
    """A line every ten seconds, such as "solving: 42 %, 35 s left"; none for a command that ends before."""

    def __init__(self, console: Console) -> None:
        super().__init__(console=console, disable=True, auto_refresh=False, speed_estimate_period=SPEED_PERIOD_S)
        self._next_s = time.monotonic() + LINE_PERIOD_S

    def update(self, task_id: TaskID, **changes: Any) -> None:  # as in rich
        """Change a task, and print a line if one is due."""
        super().update(task_id, **changes)
        self._print(task_id)

    def advance(self, task_id: TaskID, advance: float = 1) -> None:
        """Advance a task, and print a line if one is due."""
        super().advance(task_id, advance)
        self._print(task_id)

    def _print(self, task_id: TaskID) -> None:
        if time.monotonic() < self._next_s:
            return
        self._next_s = time.monotonic() + LINE_PERIOD_S
        task = next(task for task in self.tasks if task.id == task_id)
        done = "" if task.total is None else f": {task.percentage:.0f} %"
        left = "" if task.time_remaining is None else f", {task.time_remaining:.0f} s left"
        self.console.print(f"{task.description}{done}{left}", markup=False, highlight=False, soft_wrap=True)
