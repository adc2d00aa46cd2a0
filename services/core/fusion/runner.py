"""Ordinary samples one after the other as they come: the loop over them runs ahead of the engine.

What it knows stays with it until somebody wants to see it, or a sample comes that is not ordinary: only then the
engine is brought to where it is.
"""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from shared.maths.rotation import Vector

from .kalman import FloatArray
from .ordinary import PLAIN, Arithmetic, Departure, Moment, Rows, Stamps, run
from .samples import Sample
from .sampling import usual

if TYPE_CHECKING:
    from .engine import Engine


class Kept(NamedTuple):
    """A copy of an engine; or one of an earlier time, and what ordinary samples have led to since."""

    time_ns: int
    engine: "Engine"
    since: Callable[[], tuple[Moment, FloatArray]] | None = None

    def restored(self) -> "Engine":
        """Engine as it was, that goes its own way."""
        twin = self.engine.fork()
        if self.since is not None:
            moment, P = self.since()
            twin.resume(moment, P, Sample(self.time_ns, *moment[3]))
        return twin


class Runner:
    """`ordinary.run` with a place of its own to work in: of use to one navigator, in one thread."""

    wants_arrays = False  # of stamps and samples; lists are faster in Python
    arithmetic: Arithmetic = PLAIN
    kept_every = 16  # ordinary samples after which a copy of the engine is worth its time

    def __init__(self) -> None:
        self.engine: Engine | None = None  # that this is ahead of
        self.last_ns = 0  # stamp of the last sample
        self._until_ns = 0  # stamp after which samples are not ordinary
        self._comparable = False  # the last sample is as it was measured
        self._copy: Engine | None = None  # of the engine, for all that is kept of one run
        self._state: Departure

    def __call__(self, start: Departure, times_ns: Stamps, samples: Rows) -> tuple[int, Moment, FloatArray]:
        """Do what `ordinary.run` does."""
        moment, P, errors, walks, limits = start
        return run(moment, P, times_ns, samples, errors, walks, limits)

    def serve(self, engine: "Engine") -> None:
        """Have an engine calculate as this does between ordinary samples, but not what a smoother keeps in files."""
        if engine.filter is not None and engine.filter.trail is None:
            engine.filter.arithmetic = self.arithmetic

    def follow(self, engine: "Engine") -> bool:
        """Go on from where an engine is; False if nothing can go on from there."""
        departure = engine.departure()
        if departure is None or engine.last is None:
            return False
        start, self._until_ns = departure
        self._load(start)
        self._comparable = start[0][3] == (engine.last.force, engine.last.rate)
        self.last_ns, self.engine, self._copy = engine.last.time_ns, engine, None
        return True

    def take(self, time_ns: int, force: Vector, rate: Vector, *, checked: bool) -> bool:
        """Take one more sample; False, and nothing has happened, if it is not ordinary.

        One that is not `checked` must also be credible, and differ from the last in every reading.
        """
        if time_ns > self._until_ns or not (checked or self._comparable):
            return False
        moment, P, errors, walks, limits = self._state
        if not (checked or usual((force, rate), moment[3])):
            return False
        taken, moment, P = run(moment, P, (self.last_ns, time_ns), ((*force, *rate),), errors, walks, limits)
        if not taken:
            return False
        self._state = moment, P, errors, walks, limits
        self.last_ns, self._comparable = time_ns, True
        return True

    def end(self) -> None:
        """Bring the engine to where this is, and leave it to others."""
        self.show()
        self.engine = None

    def show(self) -> None:
        """Bring the engine to where this is; it must stay there until more samples are taken."""
        engine = self.engine
        if engine is not None and engine.last is not None and engine.last.time_ns != self.last_ns:
            moment, P = self._unload()
            force, rate = moment[3]
            engine.resume(moment, P, Sample(self.last_ns, force, rate))

    def keep(self) -> Kept:
        """Copy the engine as of the last sample, at the cost of what has changed since the last copy."""
        assert self.engine is not None
        copy = self._copy = self._copy or self.engine.fork()
        return Kept(self.last_ns, copy, self._later())

    def _load(self, start: Departure) -> None:
        self._state = start

    def _unload(self) -> tuple[Moment, FloatArray]:
        return self._state[0], self._state[1]

    def _later(self) -> Callable[[], tuple[Moment, FloatArray]]:
        """What `_unload` would give now, to be called at any time."""
        moment, P, *_ = self._state
        return partial(_pair, moment, P)


def _pair(moment: Moment, P: FloatArray) -> tuple[Moment, FloatArray]:
    return moment, P
