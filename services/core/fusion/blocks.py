"""Blocks of states with names, and the layout of those of which the error state is made.

A block states its standard deviation at the start of a filter and the density of its random walk.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from shared.maths.earth import Geodetic

from .settings import Settings

MOST_STATES = 63  # a saved state has at most 2048 elements of a covariance


def _zero(_: Settings) -> float:
    """A value that is set elsewhere, or none."""
    return 0.0


def _unknown(_settings: Settings, _position: Geodetic) -> tuple[float, float] | None:
    return None


def _always(_: Settings) -> bool:
    return True


@dataclass(frozen=True)
class Block:
    """States of one kind: estimated minus true.

    Parameters
    ----------
    name : str
        Under which it is found.
    size : int
        Number of states.
    unit : str
        Unit of each.
    sd : callable
        [unit] Standard deviation at the start of a filter, by the settings; zero: not estimated, or set by the start.
    psd : callable
        [unit²/s] Density of the white noise that drives its random walk, by the settings.
    known : callable
        [unit] Value and standard deviation at the start of a filter at a position, by what the settings state; None:
        zero, with `sd`.
    on : callable
        Whether the settings switch on the aid that has it: see `Layout.size_by`.
    """

    name: str
    size: int
    unit: str
    sd: Callable[[Settings], float] = _zero
    psd: Callable[[Settings], float] = _zero
    known: Callable[[Settings, Geodetic], tuple[float, float] | None] = _unknown
    on: Callable[[Settings], bool] = _always


class Layout:
    """Where each block stands in the error state.

    Parameters
    ----------
    blocks : iterable of Block
        In the order of the state.

    Raises
    ------
    ValueError
        A name stands twice, or there are too many states.
    """

    def __init__(self, blocks: Iterable[Block]) -> None:
        self.blocks = tuple(blocks)
        self._places: dict[str, slice[int, int, None]] = {}
        self.size = 0
        for block in self.blocks:
            if block.name in self._places:
                raise ValueError(f"two aids have states {block.name!r}; rename those of one")
            self._places[block.name] = slice(self.size, self.size + block.size)
            self.size += block.size
        if self.size > MOST_STATES:
            raise ValueError(f"{self.size} states; the filter has {MOST_STATES} at most")

    def place(self, name: str) -> "slice[int, int, None]":
        """Indices of a block; raises `KeyError`."""
        return self._places[name]

    def index(self, name: str) -> int:
        """Index of a block of one state."""
        place = self._places[name]
        if place.stop - place.start != 1:
            raise ValueError(f"{name} has {place.stop - place.start} states")
        return place.start

    def block(self, name: str) -> Block:
        """Block of a name, which must be there."""
        return next(block for block in self.blocks if block.name == name)

    def blocks_by(self, settings: Settings) -> tuple[Block, ...]:
        """Blocks of which a filter with these settings is made: all but the last ones, of aids that are off.

        What stands last can be left out without moving another block. So off equals, bit for bit and in time, a unit
        without that aid, and every place is a constant of compiled code.
        """
        count = len(self.blocks)
        while count and not self.blocks[count - 1].on(settings):
            count -= 1
        return self.blocks[:count]

    def size_by(self, settings: Settings) -> int:
        """Number of states of a filter with these settings."""
        return sum(block.size for block in self.blocks_by(settings))

    def text_by(self, settings: Settings) -> str:
        """Names, sizes and units, for the fingerprint of a saved state."""
        return "; ".join(f"{block.name} {block.size} {block.unit}" for block in self.blocks_by(settings))
