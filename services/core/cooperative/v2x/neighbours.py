"""What neighbours publish, when their range-rate can be used, and which of them contradict the others.

The range-rates are tested against the forward estimate before they correct it, all of one time together. With the
innovations nu and their covariance S = H P H' + R::

    T = nu' S^-1 nu ~ chi2(m),    w_j = |(S^-1 nu)_j|/sqrt((S^-1)_jj)

While T exceeds its threshold the neighbour with the largest w is left out, and with it those without which T would
have passed as well: nothing says which of them is wrong. The oscillator of the own radio is common to all m: until it
is known, two neighbours can contradict each other but neither can be singled out.
"""

from dataclasses import dataclass
from math import hypot, inf, isfinite, nan

import numpy as np

from shared.maths.frequency_offset import CARRIER_FREQUENCY, MAX_OFFSET
from shared.maths.gnss_signals import SPEED_OF_LIGHT
from shared.maths.quantiles import chi_square_limit
from shared.maths.rotation import Vector

from ..detection import local_threshold
from ..measurements import FloatArray, NeighbourFinding
from .forward import BoolArray, Estimate, Neighbours, range_rate_observations

MAX_DISTANCE = 2000.0  # [m] more than the range of ITS-G5
MAX_SPEED = 100.0  # [m/s]
MAX_POSITION_SD, MAX_VELOCITY_SD = 30.0, 10.0  # [m], [m/s] beyond them the direction or the rate says nothing
MAX_REMEMBERED = 256  # neighbours of which it is known that they were left out
SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class NeighbourReport:
    """State that a neighbour published, and the carrier frequency offset of the message that carried it."""

    name: str
    position_e: Vector  # [m, ECEF]
    velocity_e: Vector  # [m/s, ECEF]
    position_sd_m: float | None
    velocity_sd_m_s: float | None
    cfo_hz: float | None = None
    oscillator_offset: float | None = None  # [-] fractional frequency offset of its transmitter
    cfo_sd_hz: float | None = 20.0
    gps_time_ns: int | None = None  # of state and measurement; None: of the epoch


def unusable(
    report: NeighbourReport, distance: float, speed: float, relative_speed: float, own_sd: float
) -> str | None:
    """Why a neighbour's range-rate is not used; None where it is.

    Parameters
    ----------
    report : NeighbourReport
        What was published and measured.
    distance, speed, relative_speed : float
        [m], [m/s] To it, of it, and between it and the vehicle.
    own_sd : float
        [m] Standard deviation of the vehicle's position.

    Notes
    -----
    A neighbour is too near if the range-rate v sin(angle) is bent over the uncertainty sigma of the two positions by
    more than it is uncertain itself: v (sigma/distance)² > sd.
    """
    cfo, offset, *sds = (
        nan if value is None else value
        for value in (
            report.cfo_hz, report.oscillator_offset, report.position_sd_m, report.velocity_sd_m_s, report.cfo_sd_hz,
        )
    )  # fmt: skip
    position_sd, velocity_sd, cfo_sd = sds
    bend = relative_speed * (position_sd**2 + own_sd**2)
    rate_sd = hypot(SPEED_OF_LIGHT / CARRIER_FREQUENCY * cfo_sd, velocity_sd)
    checks = (
        (isfinite(cfo), "neighbour_without_cfo"),
        (abs(offset) <= MAX_OFFSET, "neighbour_without_oscillator_offset"),
        (abs(cfo) <= 2.0 * MAX_OFFSET * CARRIER_FREQUENCY, "implausible_cfo"),
        (distance <= MAX_DISTANCE and speed <= MAX_SPEED, "implausible_neighbour"),
        (all(0.0 < sd < inf for sd in sds), "neighbour_without_accuracy"),
        (position_sd <= MAX_POSITION_SD and velocity_sd <= MAX_VELOCITY_SD, "inaccurate_neighbour"),
        (bend <= rate_sd * distance**2, "neighbour_too_near"),
    )
    return next((reason for holds, reason in checks if not holds), None)


class NeighbourTest:
    """Decides which neighbours are excluded, until their data have agreed for long enough."""

    def __init__(
        self, false_alarm_rate: float, readmission_epochs: int, readmission_t: float, forget_after_s: float
    ) -> None:
        self._rate, self._readmission_epochs, self._readmission_t = false_alarm_rate, readmission_epochs, readmission_t
        self._forget_ns = round(forget_after_s * SECOND_NS)
        self._healthy: dict[str, tuple[int, int]] = {}  # of the excluded: healthy epochs, and when it was seen [ns]

    def clear(self) -> None:
        """Forget which neighbours were left out."""
        self._healthy.clear()

    def evaluate(
        self, names: tuple[str, ...], neighbours: Neighbours, estimate: Estimate, time_ns: int
    ) -> tuple[BoolArray, tuple[NeighbourFinding, ...]]:
        """Test the neighbours of one time.

        Parameters
        ----------
        names : tuple of str
            Their m names.
        neighbours : Neighbours
            What they published and what was measured.
        estimate : Estimate
            One filter, shapes (size,) and (size, size), predicted to that time and not yet corrected by them.
        time_ns : int
            [ns] That time.

        Returns
        -------
        ndarray of bool, shape (m,); tuple of NeighbourFinding
            Which neighbours may be used, and the tests of all.
        """
        rows, innovations, variances = range_rate_observations(estimate, neighbours)
        S = rows @ estimate.P @ rows.T + np.diag(variances)
        self._forget(time_ns)
        used = np.array([name not in self._healthy for name in names], dtype=np.bool_)
        self._exclude(innovations, S, used)
        t = np.abs(innovations) / np.sqrt(np.diag(S))
        for name, size, free in zip(names, t.tolist(), used.tolist(), strict=True):
            self._count(name, size, free, time_ns)
        threshold = local_threshold(len(names), self._rate)
        return used, tuple(
            NeighbourFinding(name, innovation, size, threshold, not free)
            for name, innovation, size, free in zip(names, innovations.tolist(), t.tolist(), used.tolist(), strict=True)
        )

    def _exclude(self, innovations: FloatArray, S: FloatArray, used: BoolArray) -> None:
        """Clear `used` of neighbours until the others agree with the estimate and with one another."""
        while used.any():
            inverse, kept = np.linalg.inv(S[np.ix_(used, used)]), np.flatnonzero(used)
            weighted = inverse @ innovations[used]
            statistic = float(innovations[used] @ weighted)
            if statistic <= chi_square_limit(len(kept), self._rate):
                return
            w2 = weighted**2 / np.diag(inverse)
            explains = statistic - w2 <= (chi_square_limit(len(kept) - 1, self._rate) if len(kept) > 1 else 0.0)
            explains[w2.argmax()] = True
            used[kept[explains]] = False

    def _count(self, name: str, t: float, free: bool, time_ns: int) -> None:
        if free:
            return
        count = self._healthy.get(name, (0, 0))[0] + 1 if t < self._readmission_t else 0
        self._healthy[name] = count, time_ns
        if count >= self._readmission_epochs:
            del self._healthy[name]

    def _forget(self, time_ns: int) -> None:
        self._healthy = {
            name: (count, seen_ns)
            for name, (count, seen_ns) in list(self._healthy.items())[-MAX_REMEMBERED:]
            if time_ns - seen_ns <= self._forget_ns
        }
