"""Plain RAIM with exclusion: global test, largest Baarda w excluded, repeated; re-admission after healthy epochs."""

from dataclasses import dataclass, field, replace
from math import isfinite

import numpy as np

from shared.maths.quantiles import chi_square_limit
from shared.messages.explanation import Explanation, explain
from shared.messages.trust import Outcome

from ..broadcast.store import EphemerisStore
from ..codes import Code
from ..detection import (
    horizontal_levels,
    innovation_test,
    minimal_detectable_biases,
    minimal_identifiable_biases,
    noncentrality,
)
from ..measurements import FloatArray, RawEpoch, SatelliteFinding, SatelliteId, SatelliteVerdict, references
from .model import ErrorModel, SatelliteMeasurement, Sky, usable_sights
from .solution import PositionFit, fit_velocity, masked, solution_of


@dataclass(frozen=True)
class RaimSettings:
    """Design rates and the rule of re-admission."""

    false_alarm_rate: float = 1e-5  # per epoch
    missed_detection_rate: float = 1e-4
    readmission_epochs: int = 8  # consecutive epochs with t below `readmission_t`
    readmission_t: float = 3.0
    model: ErrorModel = field(default_factory=ErrorModel)


@dataclass(frozen=True)
class _Tested:
    """A set of satellites after exclusion, with what the tests said."""

    position: PositionFit | None
    excluded: tuple[SatelliteMeasurement, ...]
    suspects: tuple[SatelliteId, ...]  # without any of which the test would have passed as well
    passes: bool
    rejected: dict[str, int]


class SatelliteMonitor:
    """Tests successive raw epochs; keeps the excluded satellites and the last fault-free position."""

    def __init__(self, settings: RaimSettings | None = None) -> None:
        self._settings = settings or RaimSettings()
        self._healthy_epochs: dict[SatelliteId, int] = {}  # of the satellites that are excluded
        self._start_e: FloatArray | None = None
        self._sky: Sky | None = None  # of the epoch that was evaluated last

    def evaluate(
        self, epoch: RawEpoch, store: EphemerisStore, left_out: frozenset[SatelliteId] = frozenset()
    ) -> SatelliteVerdict:
        """Test an epoch.

        Parameters
        ----------
        epoch : RawEpoch
            Raw measurements.
        store : EphemerisStore
            Broadcast ephemerides and ionosphere.
        left_out : frozenset of SatelliteId
            Satellites that another test excludes in this epoch; they count as excluded, and are not remembered.

        Returns
        -------
        SatelliteVerdict
            Not evaluated where no satellite is redundant: with n satellites of c constellations n - 3 - c < 1.
        """
        sights, rejected = usable_sights(epoch, store, self._settings.model)
        sky = Sky(sights, epoch.gps_time_ns, store.ionosphere, self._settings.model)
        self._sky = sky
        tested = self._test(sky, left_out | self._healthy_epochs.keys())
        if self._healthy_epochs and (tested.position is None or tested.position.fit.dof < 1):
            # What is left cannot be tested: earlier exclusions give way, and the whole epoch is judged afresh.
            self._healthy_epochs.clear()
            tested = self._test(sky, left_out)
        for reason, count in tested.rejected.items():
            rejected[reason] = rejected.get(reason, 0) + count
        if tested.position is None:
            why = explain(Code.NO_SOLUTION, usable_count=len(sights))
            return SatelliteVerdict(Outcome.NOT_EVALUATED, why, rejected=rejected)
        return self._verdict(tested.position, tested, left_out, rejected)

    def all_in_view(self) -> PositionFit | None:
        """Solve the epoch that was evaluated last with all its satellites, excluded ones too; None if there is none."""
        return None if self._sky is None or not self._sky.sights else masked(self._sky, self._start_e)[0]

    def all_agree(self, epoch: RawEpoch, store: EphemerisStore) -> bool:
        """Whether the satellites of an epoch, without exception, pass the global test; nothing is remembered."""
        sights, _ = usable_sights(epoch, store, self._settings.model)
        sky = Sky(sights, epoch.gps_time_ns, store.ionosphere, self._settings.model)
        tested = self._test(sky, frozenset())
        return tested.passes and not tested.excluded

    def _test(self, sky: Sky, excluded: frozenset[SatelliteId]) -> _Tested:
        """Solve without the excluded satellites; while the global test fails, exclude the one with the largest w."""
        rate = self._settings.false_alarm_rate
        out = [sight for sight in sky.sights if sight.satellite in excluded]
        kept = [sight for sight in sky.sights if sight.satellite not in excluded]
        suspects: tuple[SatelliteId, ...] = ()
        while True:
            position, rejected = masked(replace(sky, sights=tuple(kept)), self._start_e) if kept else (None, {})
            if position is None or position.fit.dof < 1:
                return _Tested(position, tuple(out), (), False, rejected)
            fit = position.fit
            if fit.statistic <= chi_square_limit(fit.dof, rate):
                return _Tested(position, tuple(out), suspects, True, rejected)
            if fit.dof < 2:
                return _Tested(position, tuple(out), (), False, rejected)
            worst = int(fit.w.argmax())
            enough = fit.statistic - fit.w**2 <= chi_square_limit(fit.dof - 1, rate)  # T without each satellite
            suspects = tuple(
                satellite for row, satellite in enumerate(position.satellites) if enough[row] and row != worst
            )
            out.append(position.sky.sights[worst])
            kept.remove(position.sky.sights[worst])

    def _verdict(
        self, position: PositionFit, tested: _Tested, left_out: frozenset[SatelliteId], rejected: dict[str, int]
    ) -> SatelliteVerdict:
        settings, dof = self._settings, position.fit.dof
        excluded = self._excluded_findings(position, tested.excluded)
        if tested.passes:
            self._start_e = position.geometry.position_e
            unknown = left_out - self._healthy_epochs.keys()
            self._readmit(tuple(finding for finding in excluded if finding.satellite not in unknown))
        if dof < 1:
            return SatelliteVerdict(
                Outcome.NOT_EVALUATED, no_redundancy(position), rejected=rejected, solution=solution_of(position, None)
            )
        rate = settings.false_alarm_rate
        lambda_ = noncentrality(dof, rate, settings.missed_detection_rate)
        findings = _findings(position, lambda_, settings.missed_detection_rate)
        levels = [finding.hpl_m for finding in findings]
        bounded = [level for level in levels if level is not None]
        level_m = max(bounded) if len(bounded) == len(levels) else None
        return SatelliteVerdict(
            Outcome.ACCUSES if tested.excluded or not tested.passes else Outcome.PASS,
            _why(tested, position, level_m),
            statistic=position.fit.statistic,
            threshold=chi_square_limit(dof, rate),
            false_alarm_rate=rate,
            dof=dof,
            excluded=tuple(sight.satellite for sight in tested.excluded),
            suspects=tested.suspects,
            fault_free=tested.passes and not tested.suspects,
            solution=solution_of(position, fit_velocity(position, rate)),
            hpl_m=level_m,
            findings=(*findings, *excluded),
            rejected=rejected,
        )

    def _readmit(self, excluded: tuple[SatelliteFinding, ...]) -> None:
        """Count healthy epochs of excluded satellites, and readmit those that may be used from the next epoch on."""
        for finding in excluded:
            healthy = finding.w < self._settings.readmission_t
            count = self._healthy_epochs.get(finding.satellite, 0) + 1 if healthy else 0
            self._healthy_epochs[finding.satellite] = count
            if count >= self._settings.readmission_epochs:
                del self._healthy_epochs[finding.satellite]

    def _excluded_findings(
        self, position: PositionFit, excluded: tuple[SatelliteMeasurement, ...]
    ) -> tuple[SatelliteFinding, ...]:
        """Innovations of excluded satellites against the solution without them, where its clock is known."""
        comparable = tuple(sight for sight in excluded if sight.satellite.constellation in position.clocks)
        if not comparable:
            return ()
        sky = replace(position.sky, sights=comparable)
        geometry = sky.geometry(position.geometry.position_e)
        found = []
        for row, sight in enumerate(comparable):
            h = np.zeros(len(position.fit.parameters))
            h[:3] = -geometry.line_of_sight_n[row]
            h[3 + position.clocks[sight.satellite.constellation]] = 1.0
            y = sight.pseudorange - float(geometry.distance[row]) - float(geometry.delay[row])
            sd = float(geometry.sd[row])
            innovation, t = innovation_test(h, y, sd, position.fit)
            elevation, azimuth = float(geometry.elevation[row]), float(geometry.azimuth[row])
            tested = elevation, azimuth, sd, innovation, t
            found.append(SatelliteFinding(sight.satellite, *tested, None, None, None, excluded=True))
        return tuple(found)


def _findings(position: PositionFit, lambda_: float, missed_detection_rate: float) -> tuple[SatelliteFinding, ...]:
    """Test and protection of each satellite of the solution."""
    fit, geometry = position.fit, position.geometry
    measured = (geometry.elevation, geometry.azimuth, fit.sd, fit.residuals, fit.w)
    bounds = (
        minimal_detectable_biases(fit, lambda_),
        minimal_identifiable_biases(fit, lambda_, missed_detection_rate),
        horizontal_levels(fit, lambda_),
    )
    return tuple(
        _finding(satellite, *([float(values[row]) for values in group] for group in (measured, bounds)))
        for row, satellite in enumerate(position.satellites)
    )


def _finding(satellite: SatelliteId, measured: list[float], bounds: list[float]) -> SatelliteFinding:
    elevation, azimuth, sd, residual, w = measured
    mdb, mib, level = (bound if isfinite(bound) else None for bound in bounds)
    return SatelliteFinding(satellite, elevation, azimuth, sd, residual, w, mdb, mib, level)


def no_redundancy(position: PositionFit) -> Explanation:
    """Say that the satellites of a solution determine it, and no more."""
    return explain(
        Code.NO_REDUNDANCY, satellites_count=len(position.satellites), clocks_count=len(position.clocks)
    )  # fmt: skip


def _why(tested: _Tested, position: PositionFit, level_m: float | None) -> Explanation:
    """What the exclusion came to."""
    used = len(position.satellites)
    if not tested.passes:
        return explain(Code.UNRESOLVED, satellites_count=used)
    if not tested.excluded:
        code = Code.AGREE_WITHOUT_LEVEL if level_m is None else Code.AGREE
        return explain(code, satellites_count=used, redundancy_count=position.fit.dof, level_m=level_m)
    excluded = references(sight.satellite for sight in tested.excluded)
    if not tested.suspects:
        return explain(Code.EXCLUDED, satellites=excluded, satellites_count=used)
    return explain(
        Code.EXCLUDED_OR, satellites=excluded, suspected_satellites=references(tested.suspects), satellites_count=used
    )  # fmt: skip
