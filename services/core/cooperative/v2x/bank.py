"""Leave-one-out bank: filter i never uses satellite i, whose innovations against it show even a slow ramp.

A filter that uses the satellite under test follows a ramp of 1 m/s, and excludes the healthy satellites instead.

Axes: any leading axes (the runs of a simulation), then the filters: one for each of n satellites, and last the one
that uses all satellites.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..detection import local_threshold
from ..measurements import FloatArray
from .forward import CLOCK, POSITION, BoolArray, Estimate, correct

# The two tests of a satellite, of which one repeats itself over the window, begin as many false alarms as this many
# independent ones: with it 1004 and 108 began in 100,000 epochs with white errors, at design rates of 1e-2 and 1e-3.
TESTS_PER_SATELLITE = 1.1


@dataclass(frozen=True)
class BankSettings:
    """Window, design rate and the rule of re-admission."""

    false_alarm_rate: float = 1e-5  # per epoch, of all satellites and both tests together
    window: int = 10  # innovations whose mean is tested
    readmission_epochs: int = 8
    readmission_t: float = 3.0


@dataclass(frozen=True)
class Pseudoranges:
    """Linear observations y = -u p + b_c + n of n satellites in the local frame."""

    line_of_sight_n: FloatArray  # [-, NED] shape (n, 3)
    clock: tuple[int, ...]  # number of the clock of each satellite
    y: FloatArray  # [m] shape (..., n)
    sd: FloatArray  # [m] shape (n,), of the noise, which is white
    correlated_sd: FloatArray  # [m] shape (n,), of time-correlated errors: orbit, clock, atmosphere
    visible: BoolArray  # shape (n,); what is not measured in this epoch is neither tested nor used

    def rows(self, size: int) -> FloatArray:
        """Jacobian, shape (n, size)."""
        rows = np.zeros((len(self.sd), size))
        rows[:, POSITION] = -self.line_of_sight_n
        rows[range(len(self.sd)), [CLOCK + clock for clock in self.clock]] = 1.0
        return rows


@dataclass(frozen=True)
class BankTest:
    """Tests of one epoch, shapes (..., n)."""

    innovation: FloatArray  # [m] of satellite i against filter i
    single: FloatArray  # innovation over its standard deviation
    mean: FloatArray  # mean of the last innovations over its standard deviation
    threshold: float
    excluded: BoolArray
    newly_excluded: BoolArray

    @property
    def t(self) -> FloatArray:
        """The larger of the two statistics."""
        return np.maximum(self.single, self.mean)


class LeaveOneOutBank:
    """Runs the filters and decides which satellites are excluded."""

    def __init__(self, start: Estimate, satellites: int, settings: BankSettings | None = None) -> None:
        """Start all filters from one estimate, whose axes before the state's become the leading ones."""
        self._settings = settings or BankSettings()
        n, lead = satellites, start.x.shape[:-1]
        self.estimate = Estimate(
            np.repeat(start.x[..., np.newaxis, :], n + 1, axis=-2),
            np.repeat(start.P[..., np.newaxis, :, :], n + 1, axis=-3),
        )
        self.excluded: BoolArray = np.zeros((*lead, n), dtype=np.bool_)
        self._healthy = np.zeros((*lead, n), dtype=np.int64)
        self._history: FloatArray = np.zeros((self._settings.window, *lead, n))
        self._references: FloatArray = np.zeros((self._settings.window, *lead, n))  # sd of h x of the same epochs
        self._filled = np.zeros((*lead, n), dtype=np.int64)  # innovations in the history

    @property
    def satellites(self) -> int:
        """Number of satellites."""
        return int(self.excluded.shape[-1])

    @property
    def fault_free(self) -> Estimate:
        """Estimate from all satellites that are not excluded."""
        return Estimate(self.estimate.x[..., -1, :], self.estimate.P[..., -1, :, :])

    def rearrange(self, sources: Sequence[int | None]) -> None:
        """Change the satellites: each new one is a former one by number, or None for one that was never used.

        The filter of a satellite that was never used is the one that uses all others.
        """
        known = np.array([source is not None for source in sources], dtype=np.bool_)
        columns = [0 if source is None else source for source in sources]
        filters = [self.satellites if source is None else source for source in sources] + [self.satellites]
        self.estimate = Estimate(self.estimate.x[..., filters, :], self.estimate.P[..., filters, :, :])
        if self.satellites == 0:
            shape = (*self.excluded.shape[:-1], len(sources))
            self.excluded = np.zeros(shape, dtype=np.bool_)
            self._healthy, self._filled = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.int64)
            self._history = np.zeros((self._settings.window, *shape))
            self._references = np.zeros((self._settings.window, *shape))
            return
        self.excluded = self.excluded[..., columns] & known
        self._healthy, self._filled = self._healthy[..., columns] * known, self._filled[..., columns] * known
        self._history = self._history[..., columns] * known
        self._references = self._references[..., columns] * known

    def exclude(self, satellite: int) -> None:
        """Exclude a satellite, by number, that another test has found; it is re-admitted as any other."""
        shape = (*self.excluded.shape[:-1], 1)
        self._exclude(~self.excluded[..., satellite, np.newaxis], np.full(shape, satellite))

    def shift_clocks(self, jump: FloatArray) -> None:
        """Add a jump of the receiver's clock [m], shape (...), to all clocks of all filters."""
        x = self.estimate.x.copy()
        x[..., CLOCK:] += jump[..., np.newaxis, np.newaxis]
        self.estimate = Estimate(x, self.estimate.P)

    def advance(self, predicted: Estimate, ranges: Pseudoranges) -> BankTest:
        """Test the pseudoranges of an epoch, exclude and re-admit, and correct all filters.

        Parameters
        ----------
        predicted : Estimate
            `estimate`, propagated to the epoch and corrected by neighbours and map.
        ranges : Pseudoranges
            Observations.

        Returns
        -------
        BankTest
            Of the innovations before the correction.

        Notes
        -----
        With nu_i = y_i - h_i x_i and P_i of filter i::

            t_i = |nu_i|/sqrt(R_i + B_i + s_i²),    t_i,m = |mean_m nu_i|/sqrt(R_i/m + B_i + (mean_m s_i)²),
            s_i² = h_i P_i h_i'

        R_i is the variance of white noise, B_i of time-correlated errors. B and s² are not divided by m: the errors
        are correlated over the window, and s bounds that of their mean while the filter converges. In the filters B
        counts m times, so that m epochs with the same error weigh as one.
        """
        self.estimate = predicted
        rows = ranges.rows(predicted.x.shape[-1])
        before = self.excluded.copy()
        self._push(rows, ranges)
        single, mean = self._statistics(rows, ranges)
        threshold = local_threshold(TESTS_PER_SATELLITE * self.satellites, self._settings.false_alarm_rate)
        first = self._history[0].copy(), single, mean
        for _ in range(self.satellites - 1):
            t = np.where(self.excluded | ~ranges.visible, 0.0, np.maximum(single, mean))
            worst = t.argmax(axis=-1)[..., np.newaxis]
            fires = np.take_along_axis(t, worst, axis=-1) > threshold
            if not fires.any():
                break
            self._exclude(fires, worst)
            self._push(rows, ranges, only=fires)
            single, mean = self._statistics(rows, ranges)
        self._readmit(np.maximum(first[1], first[2]), before, ranges.visible)
        self.correct_all(ranges)
        return BankTest(*first, threshold, self.excluded.copy(), self.excluded & ~before)

    def correct_all(self, ranges: Pseudoranges) -> None:
        """Correct each filter by the visible satellites that are neither excluded nor its own."""
        own = np.eye(self.satellites + 1, self.satellites, dtype=np.bool_)
        used = ~self.excluded[..., np.newaxis, :] & ranges.visible & ~own
        rows = ranges.rows(self.estimate.x.shape[-1])
        innovations = ranges.y[..., np.newaxis, :] - self.estimate.x @ rows.T
        variances = ranges.sd**2 + self._settings.window * ranges.correlated_sd**2
        self.estimate = correct(self.estimate, rows, innovations, variances, used)

    def _own(self) -> Estimate:
        """Estimate of filter i for satellite i."""
        return Estimate(self.estimate.x[..., :-1, :], self.estimate.P[..., :-1, :, :])

    def _push(self, rows: FloatArray, ranges: Pseudoranges, only: BoolArray | None = None) -> None:
        """Append the innovations of the visible satellites to the histories, in all or in some of the runs."""
        innovation = ranges.y - (self._own().x * rows).sum(axis=-1)
        where = np.broadcast_to(ranges.visible, innovation.shape)
        if only is not None:
            where = where & only & (self._filled == 0)
        self._history = np.where(where, _rolled(self._history, innovation), self._history)
        self._references = np.where(where, _rolled(self._references, self._reference_sd(rows)), self._references)
        self._filled = np.where(where, np.minimum(self._filled + 1, self._settings.window), self._filled)

    def _reference_sd(self, rows: FloatArray) -> FloatArray:
        """Standard deviation [m] of what filter i predicts for satellite i."""
        sd: FloatArray = np.sqrt(((self._own().P @ rows[..., np.newaxis])[..., 0] * rows).sum(axis=-1))
        return sd

    def _statistics(self, rows: FloatArray, ranges: Pseudoranges) -> tuple[FloatArray, FloatArray]:
        variance, correlated = ranges.sd**2, ranges.correlated_sd**2
        count = np.maximum(self._filled, 1)
        recent = np.arange(self._settings.window).reshape(-1, *[1] * count.ndim) < self._filled
        mean, mean_sd = (np.where(recent, kept, 0.0).sum(axis=0) / count for kept in (self._history, self._references))
        single: FloatArray = np.abs(self._history[0]) / np.sqrt(variance + correlated + self._reference_sd(rows) ** 2)
        averaged: FloatArray = np.abs(mean) / np.sqrt(variance / count + correlated + mean_sd**2)
        return np.where(ranges.visible, single, 0.0), np.where(ranges.visible, averaged, 0.0)

    def _exclude(self, fires: BoolArray, worst: npt.NDArray[np.intp]) -> None:
        """Exclude satellite `worst` where it fires, and restart all filters from the one that never used it."""
        chosen = np.zeros_like(self.excluded)
        np.put_along_axis(chosen, worst, True, axis=-1)
        chosen &= fires
        self.excluded = self.excluded | chosen
        self._healthy = np.where(chosen, 0, self._healthy)
        clean_x = np.take_along_axis(self.estimate.x, worst[..., np.newaxis], axis=-2)
        clean_P = np.take_along_axis(self.estimate.P, worst[..., np.newaxis, np.newaxis], axis=-3)
        restart = fires[..., np.newaxis]
        self.estimate = Estimate(
            np.where(restart, clean_x, self.estimate.x), np.where(restart[..., np.newaxis], clean_P, self.estimate.P)
        )
        # innovations against the former estimates say nothing about the new ones
        self._filled = np.where(fires & ~self.excluded, 0, self._filled)

    def _readmit(self, t: FloatArray, before: BoolArray, visible: BoolArray) -> None:
        healthy = before & visible & (t < self._settings.readmission_t)
        self._healthy = np.where(healthy, self._healthy + 1, np.where(before & visible, 0, self._healthy))
        back = self.excluded & before & (self._healthy >= self._settings.readmission_epochs)
        self.excluded = self.excluded & ~back
        self._healthy = np.where(back, 0, self._healthy)


def _rolled(history: FloatArray, newest: FloatArray) -> FloatArray:
    return np.concatenate([newest[np.newaxis], history[:-1]])
