"""The states of the filter: blocks with names, of which the error state is assembled when this module is imported.

The first blocks are those of inertial navigation. Behind them stands what the aids estimate beside it: a scale, an
offset, a correlated error. Each block states its standard deviation at the start of a filter and the density of its
random walk; an aid finds its own by name, and no place is a number anywhere else.

A package that is installed beside the unit may bring further blocks (`external.py`): an entry point of the group
`obu.aid_states` is a module with a tuple `BLOCKS`.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, cast

from shared.packages import AID_STATES, brought

from .settings import Settings

SCALE_PSD = 1e-8  # [1/s] 0.6 % in an hour
MOUNTING_PSD = 1e-9  # [rad²/s] 0.1 degrees in an hour
UNKNOWN_OFFSET_SD = 300.0  # [m] of barometric height: weather and geoid
MOST_STATES = 63  # a saved state has at most 2048 elements of a covariance


def _zero(_: Settings) -> float:
    """A value that is set elsewhere, or none."""
    return 0.0


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
    """

    name: str
    size: int
    unit: str
    sd: Callable[[Settings], float] = _zero
    psd: Callable[[Settings], float] = _zero


INERTIAL = (
    Block("attitude", 3, "rad, NED", psd=lambda s: s.imu.angle_random_walk_rad_sqrt_s**2),
    Block("velocity", 3, "m/s, NED", psd=lambda s: s.imu.velocity_random_walk_m_s_sqrt_s**2),
    Block("position", 3, "m, NED"),
    Block("accelerometer_bias", 3, "m/s², body", psd=lambda s: s.imu.accelerometer_bias_psd_m2_s5),
    Block("gyroscope_bias", 3, "rad/s, body", psd=lambda s: s.imu.gyroscope_bias_psd_rad2_s3),
    Block("accelerometer_scale", 3, "-", sd=lambda s: s.imu.accelerometer_scale_sd),
    Block("gyroscope_scale", 3, "-", sd=lambda s: s.imu.gyroscope_scale_sd),
)
AIDS = (
    Block("odometer_scale", 1, "-", sd=lambda s: s.odometer.scale_sd, psd=lambda _: SCALE_PSD),
    Block("mounting", 2, "rad", sd=lambda s: s.non_holonomic.mounting_sd_rad, psd=lambda _: MOUNTING_PSD),
    Block("gnss_error", 3, "- of its standard deviation"),  # Gauss-Markov; the first fix sets it
    Block(
        "barometer_offset", 1, "m",
        sd=lambda s: UNKNOWN_OFFSET_SD if s.barometer.enabled else 0.0,
        psd=lambda s: s.barometer.offset_random_walk_m_sqrt_s**2 if s.barometer.enabled else 0.0,
    ),
    Block("gnss_velocity_error", 3, "m/s, NED"),  # Gauss-Markov
)  # fmt: skip


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

    @property
    def text(self) -> str:
        """Names, sizes and units, for the fingerprint of a saved state."""
        return "; ".join(f"{block.name} {block.size} {block.unit}" for block in self.blocks)


def external_blocks() -> tuple[Block, ...]:
    """Blocks of installed packages, in the order of the names of their entry points."""
    return tuple(block for module in brought(AID_STATES) for block in cast(Any, module).BLOCKS)


LAYOUT = Layout((*INERTIAL, *AIDS, *external_blocks()))
