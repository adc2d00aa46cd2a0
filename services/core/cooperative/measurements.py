"""Raw GNSS measurements and the verdict about them: the inputs and outputs of this process's mathematics.

Times are integer nanoseconds of GPS time since 1980-01-06; Galileo system time differs from it by nanoseconds, which
the clock of each constellation absorbs.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import islice
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.rotation import Vector
from shared.messages.base import Symmetric3
from shared.messages.explanation import Reference, ReferenceKind
from shared.trust.result import Test

FloatArray = npt.NDArray[np.float64]

SECONDS_PER_WEEK = 604800
WEEK_NS = SECONDS_PER_WEEK * 1_000_000_000
NOTHING: Mapping[str, int] = MappingProxyType({})


class Constellation(StrEnum):
    """Satellite systems whose broadcast ephemerides are decoded."""

    GPS = "gps"
    GALILEO = "galileo"


class SatelliteId(NamedTuple):
    """A satellite: its constellation and its number in it (PRN or SVID)."""

    constellation: Constellation
    number: int

    def __str__(self) -> str:
        """As RINEX names it: G05, E11."""
        return f"{'G' if self.constellation == Constellation.GPS else 'E'}{self.number:02d}"

    @property
    def reference(self) -> Reference:
        """Reference of an explanation."""
        return Reference(kind=ReferenceKind.SATELLITE, name=str(self))


MAX_NAMED = 16  # satellites or neighbours in an explanation; more at once are a fault of all


def references(found: "Iterable[SatelliteId | NeighbourFinding]") -> tuple[Reference, ...]:
    """References of satellites or neighbours, the first ones of many."""
    return tuple(item.reference for item in islice(found, MAX_NAMED))


def upper(cov: FloatArray) -> Symmetric3:
    """Upper triangle of a covariance, shape (3, 3), row by row."""
    (nn, ne, nd), (_, ee, ed), (_, _, dd) = cov.tolist()
    return nn, ne, nd, ee, ed, dd


@dataclass(frozen=True)
class Measurement:
    """One satellite's raw measurement on L1/E1; Doppler is positive while the satellite approaches."""

    satellite: SatelliteId
    pseudorange_m: float
    doppler_hz: float | None = None
    cn0_db_hz: float | None = None
    carrier_cycles: float | None = None  # grows with the range
    lock_time_s: float | None = None  # for which the carrier has been tracked without an interruption
    half_cycle_resolved: bool = False
    slipped: bool = False  # the receiver has lost the carrier since the epoch before


@dataclass(frozen=True)
class RawEpoch:
    """All raw measurements of one reception time."""

    gps_time_ns: int
    measurements: tuple[Measurement, ...]


@dataclass(frozen=True)
class SatelliteFinding:
    """One satellite of the solution: its residual, its test and what the geometry lets be detected."""

    satellite: SatelliteId
    elevation_rad: float
    azimuth_rad: float
    sd_m: float
    residual_m: float  # least-squares residual; of an excluded satellite: against the solution without it
    w: float  # |residual| over its own standard deviation
    mdb_m: float | None  # minimal detectable bias; None where no bias can be detected
    mib_m: float | None  # minimal bias that is attributed to this satellite too; None where none can be
    hpl_m: float | None  # horizontal error that the minimal detectable bias causes; None where nothing bounds it
    excluded: bool = False


@dataclass(frozen=True)
class SatelliteSolution:
    """Least-squares position and velocity from the satellites that were not excluded."""

    position_e: Vector  # [m, ECEF] of the antenna
    position_cov_e: FloatArray  # [m²] shape (3, 3)
    clock_m: Mapping[Constellation, float]  # [m] receiver clock bias times c, against each constellation
    velocity_e: Vector | None = None  # [m/s, ECEF]
    velocity_cov_e: FloatArray | None = None
    clock_drift_m_s: float | None = None
    doppler_excluded: tuple[SatelliteId, ...] = ()


@dataclass(frozen=True)
class NeighbourFinding:
    """Test of one neighbour's range-rate."""

    name: str  # ID of its station
    innovation_m_s: float
    t: float  # innovation over its standard deviation
    threshold: float
    excluded: bool

    @property
    def reference(self) -> Reference:
        """Reference of an explanation."""
        return Reference(kind=ReferenceKind.NEIGHBOUR, name=self.name)


@dataclass(frozen=True)
class SatelliteVerdict(Test):
    """The result of the test of one epoch, with its evidence.

    `outcome` accuses while a satellite is excluded or a fault is detected; `fault_free` says whether the solution is
    free of it. An accusation without satellites is a fault that could not be attributed; `suspects` are satellites
    that explain the fault as well as those that were excluded, in which case nothing says that it is gone. The
    statistic is T of the satellites that remain.
    """

    dof: int = 0
    excluded: tuple[SatelliteId, ...] = ()
    suspects: tuple[SatelliteId, ...] = ()
    fault_free: bool = False
    solution: SatelliteSolution | None = None
    hpl_m: float | None = None
    findings: tuple[SatelliteFinding, ...] = ()
    neighbours: tuple[NeighbourFinding, ...] = ()
    rejected: Mapping[str, int] = field(default_factory=lambda: NOTHING)  # measurements not used, by reason
