"""Progress of a command, on a terminal and elsewhere."""

from io import StringIO

import pytest
from rich.console import Console

from cli import progress as module
from cli.progress import Lines, progress_on


class Clock:
    """Time that the test moves."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    found = Clock()
    monkeypatch.setattr(module, "time", found)
    monkeypatch.setattr("rich.progress.Progress.get_time", lambda _: found.now_s, raising=False)
    return found


def lines(clock: Clock, seconds: int, step_s: float = 1.0) -> list[str]:
    text = StringIO()
    with Lines(Console(file=text)) as progress:
        progress.get_time = clock.monotonic
        task = progress.add_task("solving", total=60)
        for _ in range(seconds):
            clock.now_s += step_s
            progress.advance(task)
    return text.getvalue().splitlines()


def test_a_line_every_ten_seconds_states_the_share_and_the_time_left(clock: Clock) -> None:
    assert lines(clock, 30) == [
        "solving: 17 %, 50 s left",
        "solving: 33 %, 40 s left",
        "solving: 50 %, 30 s left",
    ]


def test_a_short_command_prints_no_line(clock: Clock) -> None:
    assert lines(clock, 9) == []


def test_an_update_prints_the_new_description(clock: Clock) -> None:
    text = StringIO()
    with Lines(Console(file=text)) as progress:
        progress.get_time = clock.monotonic
        task = progress.add_task("importing", total=None)
        clock.now_s += 11.0
        progress.update(task, description="imported a")
    assert text.getvalue() == "imported a\n"


def test_a_terminal_has_a_bar_with_the_time_left_that_vanishes() -> None:
    text = StringIO()
    with progress_on(Console(file=text, force_terminal=True, width=80)) as progress:
        assert list(progress.track([1, 2], description="reading")) == [1, 2]
    assert "reading" in text.getvalue()
    assert "100%" in text.getvalue()
    assert not isinstance(progress, Lines)
    assert text.getvalue().rstrip("\n").endswith("\x1b[2K"), "the bar is erased"
