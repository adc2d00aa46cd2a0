"""Unwraps clocks that start anew: seconds of week and of day, and counters of a fixed number of bits."""

from dataclasses import dataclass, field

import numpy as np

from shared.maths.earth import FloatArray

TICKS_S = {"ns": 1e-9, "us": 1e-6, "10 us": 1e-5, "100 us": 1e-4, "ms": 1e-3, "10 ms": 1e-2}
PERIODS_S: dict[str, float] = {
    "a second": 1.0, "a minute": 60.0, "an hour": 3600.0, "half a day": 43_200.0, "a day": 86_400.0,
    "a week": 604_800.0,
    **{f"2^{bits} {tick}": 2**bits * step_s for bits in (16, 24, 31, 32) for tick, step_s in TICKS_S.items()},
}  # fmt: skip
MAX_STEP = 1e-3  # fraction of the period that the step over its end may be off the period
MAX_STEPS = 3.0  # the same, in median steps of the clock
MIN_LOST = 5  # rows behind a step back that is worth a sentence


@dataclass
class UnwrappedClock:
    """A continuous clock, and what was found, one sentence each."""

    seconds: FloatArray
    sentences: list[str] = field(default_factory=list)


def unwrapped(seconds: FloatArray, rows: FloatArray, period_s: float | None, what: str) -> UnwrappedClock:
    """Make a clock continuous over the ends of its period.

    Parameters
    ----------
    seconds : ndarray, shape (rows,)
        [s] The clock.
    rows : ndarray, shape (rows,)
        Number of each row in its file, from 0.
    period_s : float or None
        [s] The period if it is stated; otherwise it is that of `PERIODS_S` which the first step back fits best.
    what : str
        Name of the clock in the sentences.

    Notes
    -----
    A step from c to d < c is the end of a period P if d + P follows c as the next row does: within three median steps
    or a thousandth of P. With a stated period every step back by more than P / 2 is one. A row that is late by a few
    steps over the end steps forward by P, and is put back.
    """
    steps = np.diff(seconds)
    usual_s = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    back = np.flatnonzero(steps < 0.0)
    for first in back.tolist():
        named = _period(-float(steps[first]), usual_s, period_s)
        if named is None:
            continue
        name, period = named
        near = _tolerance(period, usual_s)
        turns = np.abs(steps + period) <= (near if period_s is None else period / 2.0)
        late = np.abs(steps - period) <= near
        late[:first] = False
        total = np.r_[0.0, np.cumsum(turns.astype(float) - late)] * period
        count = int(turns.sum())
        again = "" if count == 1 else f" and {count - 1} more times"
        said = f"{what} starts anew after {name} at row {_row(rows, first)}{again}; the stamps were continued."
        return UnwrappedClock(seconds + total, [said, *_lost(seconds + total, rows, what)])
    return UnwrappedClock(seconds, _lost(seconds, rows, what))


def _period(step_s: float, usual_s: float, stated_s: float | None) -> tuple[str, float] | None:
    """The period over whose end a clock stepped back by `step_s`; None if it is no known one."""
    if stated_s is not None:
        return (f"{stated_s:g} s", stated_s) if step_s > stated_s / 2.0 else None
    fits = {
        name: period for name, period in PERIODS_S.items()
        if -1e-6 <= period - step_s <= _tolerance(period, usual_s) and period > 10.0 * usual_s
    }  # fmt: skip
    name = min(fits, key=lambda name: fits[name] - step_s, default=None)
    return None if name is None else (name, fits[name])


def _tolerance(period_s: float, usual_s: float) -> float:
    return max(MAX_STEPS * usual_s, MAX_STEP * period_s)


def _lost(seconds: FloatArray, rows: FloatArray, what: str) -> list[str]:
    """Name the step back behind which most rows are not later than one before."""
    if len(seconds) < 2:
        return []
    newest = np.maximum.accumulate(seconds)
    behind = np.r_[False, seconds[1:] <= newest[:-1]] & (seconds < newest)
    edges = np.flatnonzero(np.diff(np.r_[False, behind, False]))
    lengths = edges[1::2] - edges[::2]
    if not len(lengths) or lengths.max() < MIN_LOST:
        return []
    longest = int(np.argmax(lengths))
    start, lost = int(edges[::2][longest]), int(lengths[longest])
    step_s = float(seconds[start - 1] - seconds[start])
    return [
        f"{what} steps back by {step_s:.6g} s at row {_row(rows, start - 1)}, the end of no known period: {lost} rows "
        "behind it are not later than those before, and are rejected. If the clock started anew after a period of "
        "its own, state it as `wraps_s` in `time`; otherwise import the parts before and behind the row as two drives."
    ]


def _row(rows: FloatArray, before: int) -> int:
    """Number, from 1, of the row behind a step."""
    return int(rows[before + 1]) + 1
