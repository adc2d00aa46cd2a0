"""What gets through ordinary samples, and what it wants to be given."""

from typing import TYPE_CHECKING

from .kalman import FloatArray
from .propagation import PLAIN, Arithmetic, Departure, Moment, Rows, Stamps, run

if TYPE_CHECKING:
    from ..update.engine import Engine


class Runner:
    """`ordinary.run`; one that is machine code has a place of its own to work in, of use to one thread."""

    wants_arrays = False  # of stamps and samples; lists are faster in Python
    arithmetic: Arithmetic = PLAIN

    def __call__(self, start: Departure, times_ns: Stamps, samples: Rows) -> tuple[int, Moment, FloatArray]:
        """Do what `ordinary.run` does."""
        moment, P, errors, walks, limits = start
        return run(moment, P, times_ns, samples, errors, walks, limits)

    def serve(self, engine: "Engine") -> None:
        """Have an engine calculate as this does between ordinary samples, but not what a smoother keeps in files."""
        if engine.filter is not None and engine.filter.trail is None:
            engine.filter.arithmetic = self.arithmetic
