"""Fixes of a simulated GNSS receiver: errors, outages and carrier-phase ambiguity states."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic, geodetic_from_ned_difference
from shared.messages.gnss import GnssStart

from ..scenarios import Scenario
from ..vehicle import AntennaState, Stream, Vector
from .gnss_errors import BASE_SD, VELOCITY_SD, PositionErrors, position_errors, position_sd

FloatArray = npt.NDArray[np.float64]

SETTLING_TIME_S = 15.0  # [s] initial standstill for the alignment; excluded from an exact RMSE
ZERO = (0.0, 0.0, 0.0)
HELD_SD_M_S = 2.0  # by which a receiver that holds its velocity states less and less of its position
REACQUISITION_S = 2.0  # [s] from the end of an outage to the first fix
AMBIGUITIES_S = (("none", 8.0), ("float", 25.0))  # [s] after an outage, the time at which each state ends


def search_s(start: GnssStart, rng: np.random.Generator) -> float:
    """Time [s] from a restart to the first fix, as a receiver under open sky needs it; an assumption.

    A hot start has all it needs once it tracks. Otherwise the three subframes of an ephemeris, of the five of 6 s that
    repeat, take 18 s from the beginning of one that comes within 12 s. A cold start finds the signals first.
    """
    if start is GnssStart.HOT:
        return float(rng.uniform(REACQUISITION_S, REACQUISITION_S + 1.0))
    found_s = float(rng.uniform(2.0, 6.0) if start is GnssStart.COLD else rng.uniform(1.0, 2.0))
    return found_s + float(rng.uniform(0.0, 12.0)) + 18.0


@dataclass(frozen=True)
class Fix:
    """Position, velocity and ambiguity state of one epoch, as computed by the receiver."""

    valid: bool
    carrier: str
    position: Geodetic  # of the last valid epoch, if this one is not
    velocity_n: Vector
    error_n: Vector  # [m, NED] reported minus true position
    position_sd_n: Vector
    velocity_sd_n: Vector


class Reception:
    """Computes fixes from antenna states, epoch by epoch at a constant rate."""

    def __init__(self, scenario: Scenario, seed: int, step_s: float) -> None:
        self._scenario, self._seed, self._step = scenario, seed, step_s
        self._epochs = max(1, round(scenario.duration_s / step_s))
        self._period = -1
        self._errors: PositionErrors | None = None
        self._open_s = float("inf")  # time since the end of the last outage
        self._last = scenario.start
        self._velocity: Vector | None = None  # of the last valid epoch
        self._covered_s = 0.0

    def fix(self, epoch: int, antenna: AntennaState) -> Fix:
        """Compute the fix of an epoch.

        Parameters
        ----------
        epoch : int
            Number of the epoch; non-decreasing from call to call.
        antenna : AntennaState
            True state of the antenna.

        Returns
        -------
        Fix
            Its standard deviations are those of its errors. During an outage it repeats the last position.
        """
        period, index = divmod(epoch, self._epochs)
        errors = self._errors_of(period)
        self._open_s = 0.0 if antenna.covered else self._open_s + self._step
        if self._open_s < REACQUISITION_S and self._scenario.hold_s and self._velocity is not None:
            return self._held()
        if self._open_s < REACQUISITION_S:
            return Fix(False, "none", self._last, ZERO, ZERO, (4000.0, 4000.0, 4000.0), (20.0, 20.0, 20.0))
        self._covered_s = 0.0
        carrier = self._carrier()
        error_n = _vector(errors.noise[index] * BASE_SD[carrier] + errors.injected[index])
        self._last = geodetic_from_ned_difference(error_n, antenna.position)
        velocity_n = _vector(antenna.velocity_n + errors.velocity[index])
        self._velocity = velocity_n
        sd = _vector(position_sd(self._scenario.error, carrier))
        return Fix(True, carrier, self._last, velocity_n, error_n, sd, VELOCITY_SD)

    def _held(self) -> Fix:
        """Fix without signals, which the receiver calls valid: its last velocity, then standstill where it was."""
        self._covered_s += self._step
        assert self._velocity is not None
        velocity_n = self._velocity if self._covered_s <= self._scenario.hold_s else ZERO
        north, east, down = (self._step * component for component in velocity_n)
        self._last = geodetic_from_ned_difference((north, east, down), self._last)
        grown = HELD_SD_M_S * self._covered_s
        return Fix(True, "none", self._last, velocity_n, ZERO, (grown, grown, grown), VELOCITY_SD)

    def _carrier(self) -> str:
        """Ambiguity state: it restarts after each outage and improves up to the best state of the scenario."""
        for state, until_s in AMBIGUITIES_S:
            if self._open_s < until_s or self._scenario.carrier == state:
                return state
        return "fixed"

    def _errors_of(self, period: int) -> PositionErrors:
        if self._errors is None or period != self._period:
            self._errors = position_errors(
                self._scenario.error,
                self._epochs,
                self._step,
                seed=(self._seed, Stream.GNSS, period),
                settled=round(SETTLING_TIME_S / self._step) - 1 if period == 0 else 0,
                last=None if self._errors is None else self._errors.last,
            )
            self._period = period
        return self._errors


def _vector(values: FloatArray) -> Vector:
    x, y, z = values.tolist()
    return x, y, z
