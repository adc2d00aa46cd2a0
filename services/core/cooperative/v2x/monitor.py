"""V2X-assisted satellite monitor: the leave-one-out bank on raw epochs, neighbours' reports and the road."""

from dataclasses import dataclass, field, replace
from itertools import groupby
from math import inf, log, sqrt

import numpy as np

from shared.maths.earth import geodetic_from_ecef, ned_from_ecef
from shared.maths.frequency_offset import CARRIER_FREQUENCY, MAX_OFFSET, range_rate_from_cfo
from shared.maths.gnss_signals import SPEED_OF_LIGHT
from shared.messages.explanation import explain
from shared.messages.trust import Outcome

from ..broadcast.store import EphemerisStore
from ..codes import Code
from ..measurements import (
    Constellation,
    FloatArray,
    NeighbourFinding,
    RawEpoch,
    SatelliteFinding,
    SatelliteId,
    SatelliteSolution,
    SatelliteVerdict,
    references,
)
from ..satellites.model import ErrorModel, Geometry, SatelliteMeasurement, Sky, usable_sights, virtual_sights
from .bank import BankSettings, BankTest, LeaveOneOutBank, Pseudoranges
from .construction import construction_test
from .forward import (
    CLOCK,
    DRIFT,
    OSCILLATOR,
    POSITION,
    VELOCITY,
    Estimate,
    ForwardSettings,
    Neighbours,
    correct_range_rates,
    correct_road,
    predict,
)
from .neighbours import NeighbourReport, NeighbourTest, unusable
from .oscillators import SenderOscillators
from .road import Road

CLOCKS = {Constellation.GPS: 0, Constellation.GALILEO: 1}
MAX_NEIGHBOURS = 32  # the nearest ones are used
MIN_DISTANCE = 5.0  # [m] of a neighbour whose direction is known
MAX_VIRTUAL = 9  # candidates, the lowest: 126 sets of 5 are compared


# A car brakes and turns with 2 to 4 m/s², which its neighbours' range-rates show at once: with the 0.5 m/s² of the
# reference scenario they are accused of it.
CAR = ForwardSettings(acceleration_sd=1.0, vertical_acceleration_sd=0.2)


@dataclass(frozen=True)
class CooperativeSettings:
    """All settings of the monitor."""

    bank: BankSettings = field(default_factory=BankSettings)
    forward: ForwardSettings = CAR
    model: ErrorModel = field(default_factory=ErrorModel)
    missed_detection_rate: float = 1e-4
    longest_gap_s: float = 5.0  # after which the filters restart
    paper_construction: bool = False  # the paper's test instead of the bank; for comparison, it absorbs slow ramps
    forget_after_s: float = 60.0  # satellites and neighbours that are not received
    start_sd_m: float = 30.0  # of position and clocks: the start was solved with the satellites under test
    clock_jump_m: float = 1000.0  # innovation that all satellites have in common
    farthest_from_origin_m: float = 50_000.0
    learn_oscillators: bool = False  # of neighbours that publish no offset


class CooperativeMonitor:
    """Judges raw epochs with the help of neighbours and map; starts from a fault-free least-squares solution."""

    def __init__(self, settings: CooperativeSettings | None = None) -> None:
        self._settings = settings or CooperativeSettings()
        self._bank: LeaveOneOutBank | None = None
        bank = self._settings.bank
        self._neighbour_test = NeighbourTest(
            bank.false_alarm_rate, bank.readmission_epochs, bank.readmission_t, self._settings.forget_after_s
        )
        self._oscillators = SenderOscillators()
        self._satellites: tuple[SatelliteId, ...] = ()
        self._seen_ns: dict[SatelliteId, int] = {}
        self._time_ns = 0
        self.alert_limit_m = inf  # of the paper's construction: a larger level selects the virtual satellites anew
        self.construction_level_m = 0.0  # HPL of the paper's construction, where that is selected
        self._origin_e: FloatArray = np.zeros(3)
        self._ned_from_ecef: FloatArray = np.eye(3)

    def runs_until(self, gps_time_ns: int) -> bool:
        """Whether the filters can be propagated to a time, so that no start is needed."""
        gap_s = (gps_time_ns - self._time_ns) * 1e-9
        return self._bank is not None and 0.0 < gap_s <= self._settings.longest_gap_s

    def restart(self) -> None:
        """Forget the filters, and whom they have excluded: the next epoch needs a start."""
        self._bank = None
        self._neighbour_test.clear()
        self._oscillators.clear()

    def exclude(self, satellites: frozenset[SatelliteId]) -> None:
        """Exclude satellites that another test has found in the epoch that was evaluated last."""
        for number, satellite in enumerate(self._satellites):
            if self._bank is not None and satellite in satellites:
                self._bank.exclude(number)

    def evaluate(
        self,
        epoch: RawEpoch,
        store: EphemerisStore,
        neighbours: tuple[NeighbourReport, ...],
        *,
        road_e: FloatArray | None,
        start: SatelliteSolution | None,
    ) -> SatelliteVerdict:
        """Test an epoch.

        Parameters
        ----------
        epoch : RawEpoch
            Raw measurements.
        store : EphemerisStore
            Broadcast ephemerides and ionosphere.
        neighbours : tuple of NeighbourReport
            Reports since the epoch before, in the order of their times.
        road_e : ndarray, shape (m, 3), or None
            [m, ECEF] Centre line of the road that the vehicle is on.
        start : SatelliteSolution or None
            Solution of this epoch, from which the filters start where they have none of their own: as it was solved
            with the satellites under test, only its velocity and clock drift count, which are of Doppler.

        Returns
        -------
        SatelliteVerdict
            Not evaluated without a start, and without a usable neighbour and a road. Neighbours that contradict the
            others are excluded; alone they do not make it accuse.
        """
        settings = self._settings
        sights, rejected = usable_sights(epoch, store, settings.model)
        if not self.runs_until(epoch.gps_time_ns):
            self._bank = None
            if start is None:
                return SatelliteVerdict(Outcome.NOT_EVALUATED, explain(Code.NO_START), rejected=rejected)
            self._start(start)
            self._time_ns = epoch.gps_time_ns
            neighbours = ()  # their directions are not known before satellites have corrected the start
        assert self._bank is not None
        bank = self._bank

        estimate, tested = self._with_neighbours(neighbours, epoch.gps_time_ns, rejected)
        helped = any(not finding.excluded for finding in tested)
        road = None if road_e is None or len(road_e) < 2 else Road((road_e - self._origin_e) @ self._ned_from_ecef.T)
        if road is not None:
            estimate = correct_road(estimate, road, settings.forward)
        bank.estimate = estimate

        sky = Sky(sights, epoch.gps_time_ns, store.ionosphere, settings.model)
        above, geometry = self._above_mask(sky, estimate, rejected)
        if geometry is None:
            return SatelliteVerdict(Outcome.NOT_EVALUATED, explain(Code.NO_SATELLITE), rejected=rejected)
        self._arrange(above, epoch.gps_time_ns)
        ranges = self._pseudoranges(above, geometry)
        predicted = self._without_clock_jump(ranges)
        if settings.paper_construction:
            bank.estimate = predicted
            test = self._paper_test(store, ranges, geometry.position_e)
        else:
            test = bank.advance(predicted, ranges)
        if test is None or not (helped or road):
            why = explain(Code.NO_NEIGHBOUR if test else Code.FEW_VIRTUAL)
            return SatelliteVerdict(
                Outcome.NOT_EVALUATED, why, rejected=rejected, solution=self._solution(), neighbours=tested
            )
        return self._verdict(test, above, geometry, tested, rejected)

    def _start(self, start: SatelliteSolution) -> None:
        place = geodetic_from_ecef(start.position_e)
        self._origin_e = np.array(start.position_e)
        self._ned_from_ecef = ned_from_ecef(place.latitude, place.longitude)
        size = CLOCK + len(CLOCKS)
        x, P = np.zeros(size), np.zeros((size, size))
        P[POSITION, POSITION] = self._settings.start_sd_m**2 * np.eye(3)
        P[VELOCITY, VELOCITY] = 30.0**2 * np.eye(3)
        if start.velocity_e is not None and start.velocity_cov_e is not None:
            x[VELOCITY] = self._ned_from_ecef @ np.array(start.velocity_e)
            P[VELOCITY, VELOCITY] = self._ned_from_ecef @ start.velocity_cov_e @ self._ned_from_ecef.T
        x[DRIFT], P[DRIFT, DRIFT] = start.clock_drift_m_s or 0.0, 1.0 if start.clock_drift_m_s is not None else 300.0**2
        P[OSCILLATOR, OSCILLATOR] = (SPEED_OF_LIGHT * MAX_OFFSET / 5.0) ** 2
        known = list(start.clock_m.values())
        for constellation, number in CLOCKS.items():
            x[CLOCK + number] = start.clock_m.get(constellation, known[0] if known else 0.0)
            sd = self._settings.start_sd_m if constellation in start.clock_m else 1000.0
            P[CLOCK + number, CLOCK + number] = sd**2
        self._bank = LeaveOneOutBank(Estimate(x, P), 0, self._settings.bank)
        self._satellites, self._seen_ns = (), {}

    def _with_neighbours(
        self, reports: tuple[NeighbourReport, ...], epoch_ns: int, rejected: dict[str, int]
    ) -> tuple[Estimate, tuple[NeighbourFinding, ...]]:
        """Propagate to each time of neighbours, use those that agree, and go on to the epoch."""
        assert self._bank is not None
        estimate, at_ns, settings = self._bank.estimate, self._time_ns, self._settings.forward
        tested: dict[str, NeighbourFinding] = {}  # the latest of each neighbour
        for time_ns, group in groupby(reports, key=lambda report: report.gps_time_ns or epoch_ns):
            together = tuple(group)
            if not at_ns <= time_ns <= epoch_ns:
                rejected["late_neighbour"] = rejected.get("late_neighbour", 0) + len(together)
                continue
            estimate, at_ns = _propagated(estimate, time_ns - at_ns, settings), time_ns
            names, neighbours = self._neighbours(together, estimate, rejected)
            if neighbours is None:
                continue
            last = Estimate(estimate.x[-1], estimate.P[-1])  # of all satellites
            used, findings = self._neighbour_test.evaluate(names, levelled(neighbours, last), last, time_ns)
            tested.update({finding.name: finding for finding in findings})
            agreeing = Neighbours(*(column[used] for column in neighbours))
            estimate = correct_range_rates(estimate, levelled(agreeing, estimate))
        self._time_ns = epoch_ns
        return _propagated(estimate, epoch_ns - at_ns, settings), tuple(tested.values())

    def _neighbours(
        self, reports: tuple[NeighbourReport, ...], estimate: Estimate, rejected: dict[str, int]
    ) -> tuple[tuple[str, ...], Neighbours | None]:
        """Neighbours whose range-rate can be used, in the local frame; the others are counted by reason."""
        own, own_velocity = estimate.x[-1, POSITION], estimate.x[-1, VELOCITY]
        own_sd = sqrt(float(np.linalg.eigvalsh(estimate.P[-1, :2, :2])[-1]))
        usable = []
        for published in reports:
            report = published
            position = self._ned_from_ecef @ (np.array(report.position_e) - self._origin_e)
            velocity = self._ned_from_ecef @ np.array(report.velocity_e)
            distance, speed = float(np.linalg.norm((position - own)[:2])), float(np.linalg.norm(velocity))
            if self._settings.learn_oscillators and report.oscillator_offset is None:
                report = self._with_oscillator(report, position - own, velocity - own_velocity, estimate)
            reason = unusable(report, distance, speed, float(np.linalg.norm(velocity - own_velocity)), own_sd)
            if reason is not None:
                rejected[reason] = rejected.get(reason, 0) + 1
                continue
            assert report.cfo_hz is not None and report.oscillator_offset is not None
            assert report.cfo_sd_hz is not None and report.velocity_sd_m_s is not None
            shifted = range_rate_from_cfo(report.cfo_hz, report.oscillator_offset, 0.0)
            sd = np.hypot(SPEED_OF_LIGHT / CARRIER_FREQUENCY * report.cfo_sd_hz, report.velocity_sd_m_s)
            usable.append((distance, report.name, position, velocity, shifted, report.position_sd_m, sd))
        usable.sort(key=lambda row: row[0])
        if len(usable) > MAX_NEIGHBOURS:
            rejected["too_many_neighbours"] = rejected.get("too_many_neighbours", 0) + len(usable) - MAX_NEIGHBOURS
        if not usable:
            return (), None
        _, names, *columns = zip(*usable[:MAX_NEIGHBOURS], strict=True)
        return tuple(names), Neighbours(*(np.array(column, dtype=np.float64) for column in columns))

    def _with_oscillator(
        self, report: NeighbourReport, away: FloatArray, relative: FloatArray, estimate: Estimate
    ) -> NeighbourReport:
        """A report with the offset that earlier messages of its sender have, and learn from it; as it is without one.

        What is left of that offset adds to the noise of the frequency.
        """
        distance, cfo_hz, velocity_sd = float(np.linalg.norm(away)), report.cfo_hz, report.velocity_sd_m_s
        if cfo_hz is None or report.cfo_sd_hz is None or velocity_sd is None or not distance > MIN_DISTANCE:
            return report
        if abs(cfo_hz) > 2.0 * MAX_OFFSET * CARRIER_FREQUENCY:
            return report
        time_ns = self._time_ns if report.gps_time_ns is None else report.gps_time_ns
        known = self._oscillators.known(report.name, time_ns)
        per_hz = SPEED_OF_LIGHT / CARRIER_FREQUENCY
        own_sd = sqrt(float(np.linalg.eigvalsh(estimate.P[-1, VELOCITY, VELOCITY])[-1]))
        offset = per_hz * cfo_hz + float(relative @ away) / distance + float(estimate.x[-1, OSCILLATOR])
        self._oscillators.learn(report.name, time_ns, offset, float(np.hypot(per_hz * report.cfo_sd_hz, velocity_sd)),
                                own_sd)  # fmt: skip
        if known is None:
            return report
        cfo_sd_hz = float(np.hypot(report.cfo_sd_hz, known.sd / per_hz))
        return replace(report, oscillator_offset=known.value / SPEED_OF_LIGHT, cfo_sd_hz=cfo_sd_hz)

    def _above_mask(
        self, sky: Sky, estimate: Estimate, rejected: dict[str, int]
    ) -> tuple[tuple[SatelliteMeasurement, ...], Geometry | None]:
        if not sky.sights:
            return (), None
        position_e = self._origin_e + self._ned_from_ecef.T @ estimate.x[-1, POSITION]
        elevation = sky.geometry(position_e).elevation
        kept = []
        for sight, angle in zip(sky.sights, elevation.tolist(), strict=True):
            if angle >= self._settings.model.elevation_mask_rad:
                kept.append(sight)
            else:
                reason = "below_horizon" if angle < 0.0 else "below_elevation_mask"
                rejected[reason] = rejected.get(reason, 0) + 1
        if not kept:
            return (), None
        return tuple(kept), replace(sky, sights=tuple(kept)).geometry(position_e)

    def _arrange(self, sights: tuple[SatelliteMeasurement, ...], now_ns: int) -> None:
        """Give new satellites a filter, and take it from those that were not received for long."""
        assert self._bank is not None
        for sight in sights:
            self._seen_ns[sight.satellite] = now_ns
        oldest = now_ns - round(self._settings.forget_after_s * 1e9)
        self._seen_ns = {satellite: seen for satellite, seen in self._seen_ns.items() if seen >= oldest}
        satellites = tuple(self._seen_ns)
        if satellites != self._satellites:
            former = {satellite: number for number, satellite in enumerate(self._satellites)}
            self._bank.rearrange([former.get(satellite) for satellite in satellites])
            self._satellites = satellites

    def _pseudoranges(self, sights: tuple[SatelliteMeasurement, ...], geometry: Geometry) -> Pseudoranges:
        """Observations linear in the local position: y = rho - range(p0) - delay - u p0, at the estimate p0."""
        n = len(self._satellites)
        row_of = {satellite: row for row, satellite in enumerate(self._satellites)}
        sight_n, visible = np.zeros((n, 3)), np.zeros(n, dtype=np.bool_)
        y, sd, correlated_sd = np.zeros(n), np.ones(n), np.zeros(n)
        at = self._ned_from_ecef @ (geometry.position_e - self._origin_e)
        towards = geometry.line_of_sight_n @ geometry.ned_from_ecef @ self._ned_from_ecef.T
        for k, sight in enumerate(sights):
            row = row_of[sight.satellite]
            sight_n[row], sd[row], visible[row] = towards[k], geometry.noise_sd[k], True
            correlated_sd[row] = sqrt(geometry.sd[k] ** 2 - geometry.noise_sd[k] ** 2)
            y[row] = sight.pseudorange - geometry.distance[k] - geometry.delay[k] - towards[k] @ at
        clocks = tuple(CLOCKS[satellite.constellation] for satellite in self._satellites)
        return Pseudoranges(sight_n, clocks, y, sd, correlated_sd, visible)

    def _without_clock_jump(self, ranges: Pseudoranges) -> Estimate:
        """Move the clocks by what most innovations have in common, where the receiver has set its clock."""
        assert self._bank is not None
        x = self._bank.estimate.x
        innovations = (ranges.y - ranges.rows(x.shape[-1]) @ x[-1])[ranges.visible]
        jump = np.median(innovations)
        if abs(jump) > self._settings.clock_jump_m:
            self._bank.shift_clocks(np.asarray(jump))
        return self._bank.estimate

    def _paper_test(self, store: EphemerisStore, ranges: Pseudoranges, at_e: FloatArray) -> BankTest | None:
        """Test through virtual satellites, and correct the forward estimate by what is not excluded."""
        assert self._bank is not None
        sights = virtual_sights(store, self._time_ns, frozenset(self._satellites))
        if not sights:
            return None
        sky = Sky(sights, self._time_ns, store.ionosphere, self._settings.model).geometry(at_e)
        rising = [row for row in np.argsort(sky.elevation).tolist() if sky.elevation[row] > 0.0][:MAX_VIRTUAL]
        n = len(rising)
        candidates = Pseudoranges(
            sky.line_of_sight_n[rising] @ sky.ned_from_ecef @ self._ned_from_ecef.T,
            tuple(CLOCKS[sights[row].satellite.constellation] for row in rising),
            np.zeros(n), np.ones(n), np.zeros(n), np.ones(n, dtype=np.bool_),
        )  # fmt: skip
        settings = self._settings
        found = construction_test(
            self._bank.estimate.x[-1], ranges, candidates, false_alarm_rate=settings.bank.false_alarm_rate,
            missed_detection_rate=settings.missed_detection_rate, alert_limit_m=self.alert_limit_m,
        )  # fmt: skip
        if found is None:
            return None
        self._bank.excluded = found.test.excluded
        self._bank.correct_all(ranges)
        self.construction_level_m = found.hpl_m
        return found.test

    def _solution(self) -> SatelliteSolution:
        assert self._bank is not None
        estimate, to_ecef = self._bank.fault_free, self._ned_from_ecef.T
        x, y, z = (self._origin_e + to_ecef @ estimate.x[POSITION]).tolist()
        vx, vy, vz = (to_ecef @ estimate.x[VELOCITY]).tolist()
        used = {satellite.constellation for satellite in self._satellites}
        clocks = {constellation: float(estimate.x[CLOCK + CLOCKS[constellation]]) for constellation in used}
        cov = [to_ecef @ estimate.P[block, block] @ to_ecef.T for block in (POSITION, VELOCITY)]
        return SatelliteSolution((x, y, z), cov[0], clocks, (vx, vy, vz), cov[1], float(estimate.x[DRIFT]))

    def _level(self) -> float:
        """Solution separation: the largest distance to a filter without one satellite, and that filter's own bound.

        ::

            HPL = max_i ( |x - x_i| + sqrt(-2 ln P_MD) sigma_i ),   sigma_i² the largest horizontal variance of filter i
        """
        assert self._bank is not None
        x, P = self._bank.estimate.x, self._bank.estimate.P
        rows = [row for row, out in enumerate(self._bank.excluded.tolist()) if not out]
        apart = np.hypot(*(x[rows, :2] - x[-1, :2]).T)
        largest = np.linalg.eigvalsh(P[rows, :2, :2])[:, -1]
        return float((apart + sqrt(-2.0 * log(self._settings.missed_detection_rate)) * np.sqrt(largest)).max())

    def _verdict(
        self,
        test: BankTest,
        sights: tuple[SatelliteMeasurement, ...],
        geometry: Geometry,
        neighbours: tuple[NeighbourFinding, ...],
        rejected: dict[str, int],
    ) -> SatelliteVerdict:
        out = test.excluded.tolist()
        excluded = tuple(satellite for satellite, accused in zip(self._satellites, out, strict=True) if accused)
        findings = []
        for k, sight in enumerate(sights):
            row = self._satellites.index(sight.satellite)
            measured = float(geometry.elevation[k]), float(geometry.azimuth[k]), float(geometry.sd[k])
            tested = float(test.innovation[row]), float(test.t[row])
            findings.append(SatelliteFinding(sight.satellite, *measured, *tested, None, None, None, bool(out[row])))
        used = [finding.w for finding in findings if not finding.excluded]
        solution = self._solution()
        if np.linalg.norm(np.array(solution.position_e) - self._origin_e) > self._settings.farthest_from_origin_m:
            self._bank = None  # the next epoch starts in a new local frame
        helping = sum(not finding.excluded for finding in neighbours)
        if excluded:
            why = explain(
                Code.EXCLUDED_WITH_NEIGHBOURS, satellites=references(excluded), neighbours_count=helping
            )  # fmt: skip
        else:
            why = explain(Code.AGREE_WITH_NEIGHBOURS, satellites_count=len(used), neighbours_count=helping)
        level = max(self._level(), self.construction_level_m) if used and self._bank is not None else None
        return SatelliteVerdict(
            Outcome.ACCUSES if excluded else Outcome.PASS,
            why,
            statistic=max(used) if used else None,
            threshold=test.threshold,
            false_alarm_rate=self._settings.bank.false_alarm_rate,
            excluded=excluded,
            fault_free=bool(used),
            solution=solution,
            hpl_m=level,
            findings=tuple(findings),
            neighbours=neighbours,
            rejected=rejected,
        )


def levelled(neighbours: Neighbours, estimate: Estimate) -> Neighbours:
    """Put the neighbours at the height of each filter, shape (..., m, 3).

    By the heights that satellites give, a car close by could be far above: they share an error of the atmosphere of
    ten metres before the coefficients of the ionosphere are received. A slope of 10 % bends a range-rate by 0.5 %.
    """
    shape = (*estimate.x.shape[:-1], *neighbours.position_n.shape)
    position_n = np.broadcast_to(neighbours.position_n, shape).copy()
    position_n[..., 2] = estimate.x[..., np.newaxis, 2]
    return neighbours._replace(position_n=position_n)


def _propagated(estimate: Estimate, duration_ns: int, settings: ForwardSettings) -> Estimate:
    return predict(estimate, duration_ns * 1e-9, settings) if duration_ns else estimate
