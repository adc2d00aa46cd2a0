"""What the frames of a receiver tell of time, freed of steps of UTC and of times that are not valid yet.

A receiver that is switched on cold tells some date and time until it has a fix, and a UTC that is seconds off until it
has the leap seconds. Its epochs are as far apart as they were all the same: UTC is GPS time less leap seconds.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import median

from shared.maths.dates import DAY_NS, WEEK_NS

from .stamped import NS

MAX_STEP_NS = 30 * NS  # by which leap seconds change; what is further off is another clock
MAX_PAUSE_NS = 600 * NS  # between two times that are not valid; what is further apart is a clock that was set
REPEATED = 0.02  # [-] share of repeated times from which they are no steps, but a habit of the receiver


@dataclass(frozen=True)
class TimeMark:
    """What a frame says of time: UTC, else the time of the GPS week or of the UTC day."""

    utc_ns: int | None = None
    week_ns: int | None = None  # time of week, GPS
    day_ns: int | None = None
    valid: bool | None = None  # whether the receiver has a fix, by this frame; None: it does not say

    @property
    def clock_ns(self) -> int | None:
        """Time in its period; None for a frame that tells none."""
        return self.week_ns if self.day_ns is None else self.day_ns

    @property
    def period_ns(self) -> int:
        """After which its time begins again."""
        return WEEK_NS if self.day_ns is None else DAY_NS


def with_validity(marks: Sequence[TimeMark]) -> list[TimeMark]:
    """Give each mark the validity that was told last, the first ones that which is told first.

    Where a receiver never had a fix, its times count, without their date.
    """
    stated = [mark.valid for mark in marks if mark.valid is not None]
    if stated and not any(stated):
        return [replace(mark, utc_ns=None, valid=True) for mark in marks]
    valid, found = (stated[0] if stated else True), []
    for mark in marks:
        valid = valid if mark.valid is None else mark.valid
        found.append(replace(mark, valid=valid))
    return found


def without_steps(kinds: Sequence[str], contents: Sequence[bytes], marks: Sequence[TimeMark]) -> list[TimeMark]:
    """Move the marks before a step of UTC by the step.

    Parameters
    ----------
    kinds, contents : sequence of str, sequence of bytes
        Kind and bytes of each frame.
    marks : sequence of Mark
        Their times, with validity.

    Returns
    -------
    list of Mark
        Times of week have the UTC of the leap seconds that were told last; times of day before a step back by at most
        30 s are moved. A step of sentences ahead cannot be told from a pause, and stays.
    """
    return _without_steps_of_day(kinds, contents, _without_steps_of_week(marks))


def _without_steps_of_week(marks: Sequence[TimeMark]) -> list[TimeMark]:
    offsets = [
        (mark.utc_ns - mark.week_ns) % WEEK_NS
        for mark in marks
        if mark.valid and mark.utc_ns is not None and mark.week_ns is not None
    ]
    if not offsets:
        return list(marks)
    last_ns = next((later for earlier, later in reversed(list(pairwise(offsets))) if earlier == later), offsets[-1])
    found = []
    for mark in marks:
        if mark.utc_ns is not None and mark.week_ns is not None:
            step_ns = _signed(last_ns - mark.utc_ns + mark.week_ns, WEEK_NS)
            mark = replace(mark, utc_ns=mark.utc_ns + step_ns) if abs(step_ns) <= MAX_STEP_NS else mark  # noqa: PLW2901
        found.append(mark)
    return found


def _without_steps_of_day(kinds: Sequence[str], contents: Sequence[bytes], marks: Sequence[TimeMark]) -> list[TimeMark]:
    found = list(marks)
    for at, step_ns in _steps_of_day(kinds, contents, marks):
        for k in range(at):
            mark = found[k]
            if mark.day_ns is not None:
                utc_ns = None if mark.utc_ns is None else mark.utc_ns + step_ns
                found[k] = replace(mark, day_ns=(mark.day_ns + step_ns) % DAY_NS, utc_ns=utc_ns)
    return found


def _steps_of_day(kinds: Sequence[str], contents: Sequence[bytes], marks: Sequence[TimeMark]) -> list[tuple[int, int]]:
    """First frame behind each step back, and the step [ns], by the sentence that comes most often."""
    told = [k for k, mark in enumerate(marks) if mark.valid and mark.day_ns is not None]
    if not told:
        return []
    lead = Counter(kinds[k] for k in told).most_common(1)[0][0]
    times = [(k, marks[k].day_ns or 0) for k in told if kinds[k] == lead]
    steps = [_signed(later - earlier, DAY_NS) for (_, earlier), (_, later) in pairwise(times)]
    ahead = [step for step in steps if step > 0]
    if not ahead:
        return []
    period_ns, repeated = round(median(ahead)), steps.count(0)
    found = []
    for n, (step, following) in enumerate(pairwise(steps)):
        before, behind = times[n][0], times[n + 1][0]
        if not -MAX_STEP_NS <= step <= 0 or 2 * following >= 3 * period_ns - step:
            continue  # a time that is wrong alone is followed by one of the clock before it
        if step == 0 and (contents[before] == contents[behind] or repeated > max(REPEATED * len(steps), 1)):
            continue
        found.append((behind, step - period_ns))
    return found


def with_times_without_fix(marks: Sequence[TimeMark], times_ns: Sequence[int | None]) -> list[int | None]:
    """Place frames whose times are not valid before the next valid one, else behind the last one.

    Parameters
    ----------
    marks : sequence of Mark
        One a frame, with validity.
    times_ns : sequence of int or None
        [ns] Time of each frame by the valid ones; None for a rejected frame.

    Returns
    -------
    list of int or None
        [ns] Times of all, in the same order; frames without a fix are as far apart as they say.
    """
    found = list(times_ns)
    sure = [k for k, mark in enumerate(marks) if mark.valid and mark.clock_ns is not None and times_ns[k] is not None]
    for before, behind in pairwise([-1, *sure, len(marks)]):
        if any(not mark.valid and mark.clock_ns is not None for mark in marks[before + 1 : behind]):
            _place(found, marks, before, behind)
    return found


def _place(times_ns: list[int | None], marks: Sequence[TimeMark], before: int, behind: int) -> None:
    """Set the times between two frames whose times are known; at least one of them is."""
    run = marks[before + 1 : behind]
    clocks = [mark for mark in run if mark.clock_ns is not None]
    pauses = [pause for a, b in pairwise(clocks) if (pause := _pause(a, b)) is not None]
    usual_ns = round(median([pause for pause in pauses if pause] or [NS]))
    since_ns, last, own_ns = 0, clocks[0], []
    for mark in run:
        if mark.clock_ns is not None:
            since_ns, last = since_ns + (_pause(last, mark) or 0), mark
        own_ns.append(since_ns)
    first_ns = times_ns[before] if before >= 0 else None
    last_ns = times_ns[behind] if behind < len(marks) else None
    if last_ns is not None:
        pause = _pause(clocks[-1], marks[behind])
        start_ns = last_ns - (usual_ns if pause is None else pause) - since_ns
    elif first_ns is not None:
        pause = _pause(marks[before], clocks[0])
        start_ns = first_ns + (usual_ns if pause is None else pause)
    else:
        return
    for k, own in enumerate(own_ns, before + 1):
        if times_ns[k] is not None:
            times_ns[k] = start_ns + own if first_ns is None else max(start_ns + own, first_ns)


def _pause(earlier: TimeMark, later: TimeMark) -> int | None:
    """Time between two marks of one clock [ns]; None where they are of two clocks, or one was set between them."""
    if earlier.clock_ns is None or later.clock_ns is None or earlier.period_ns != later.period_ns:
        return None
    pause_ns = (later.clock_ns - earlier.clock_ns) % earlier.period_ns
    return pause_ns if pause_ns <= MAX_PAUSE_NS else None


def _signed(time_ns: int, period_ns: int) -> int:
    return (time_ns + period_ns // 2) % period_ns - period_ns // 2
