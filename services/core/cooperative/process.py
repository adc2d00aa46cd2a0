"""Finds the satellite whose pseudorange contradicts the others, by plain RAIM and with the help of neighbours."""

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import replace
from math import radians
from typing import Literal

import numpy as np
from pydantic import Field

from shared.chosen import ChosenSource, receiver_choice
from shared.maths.earth import Geodetic, ecef_from_geodetic, ned_from_ecef
from shared.messages.base import Symmetric3, Tick
from shared.messages.explanation import Explanation, explain
from shared.messages.gnss import (
    CarrierDisplacement,
    FaultFreeFix,
    GnssFix,
    GnssNavigationBits,
    GnssRawEpoch,
    RawMeasurement,
)
from shared.messages.neighbours import Neighbour, NeighbourStates
from shared.messages.operation import ModeState
from shared.messages.trust import Outcome, TrustHypotheses, TrustMonitor
from shared.runtime.config import VehicleSettings

from .broadcast.store import EphemerisStore
from .carrier.track import CarrierTrack
from .codes import Code
from .fault_free import fault_free_fix
from .hypotheses import satellite_hypotheses
from .measurements import Constellation, Measurement, RawEpoch, SatelliteId, SatelliteVerdict
from .satellites.model import ErrorModel
from .satellites.monitor import RaimSettings, SatelliteMonitor
from .satellites.solution import PositionFit
from .statements import SatelliteStatements, why_not, why_silent
from .v2x.bank import BankSettings
from .v2x.monitor import CooperativeMonitor, CooperativeSettings
from .v2x.neighbours import NeighbourReport

In = GnssRawEpoch | GnssNavigationBits | GnssFix | NeighbourStates | ModeState | Tick
Out = TrustMonitor | FaultFreeFix | TrustHypotheses | CarrierDisplacement
MAX_LISTS = 20  # of neighbours between two epochs; the newest are used
MAX_FAULTY = 2  # satellites that fail at a time; more that agree with all others are not what is wrong
MAX_LEAD_NS = 3_000_000_000  # by which a list's stamp may be later than the newest tick or epoch
PERIOD_NS = 900_000_000  # epochs that follow faster are not evaluated: one a second is enough
SIGNALS = {("gps", "1C"), ("galileo", "1C"), ("galileo", "1B")}  # on 1575.42 MHz, with broadcast ephemerides
# Reasons for which a measurement is not used in the ordinary course of things; the others are rejects.
ORDINARY_REJECTS = {
    "no_ephemeris",
    "below_elevation_mask",
    "weak_signal",
    "alone_in_constellation",
    "neighbour_too_near",
}


class Config(VehicleSettings):
    """Design rates of the tests, the method, and limits of what is used; the alert limit is that of `[vehicle]`."""

    method: Literal["bank", "paper", "plain"] = Field(
        default="bank",
        description="test with the help of neighbours: leave-one-out bank, the paper's construction, or none",
    )
    false_alarm_rate: float = Field(
        default=1e-5, gt=0.0, lt=0.5, description="per epoch, of the global test and of the test with neighbours each"
    )
    missed_detection_rate: float = Field(
        default=1e-4,
        gt=0.0,
        lt=0.5,
        description="missed-detection rate of a bias of the minimal detectable size, per epoch",
    )
    elevation_mask_deg: float = Field(
        default=10.0, ge=0.0, lt=90.0, description="elevation below which satellites are not used"
    )
    integrity_risk: float = Field(
        default=1e-3,
        gt=0.0,
        lt=0.5,
        description="probability with which the position without a satellite is beyond its protection level",
    )
    unsigned_neighbours: bool = Field(
        default=False,
        description="also use neighbours whose CAM are not authenticated: anybody may state them",
    )
    learn_oscillators: bool = Field(
        default=False,
        description="learn the oscillators of neighbours that publish no offset, as of received CAM, by the carrier "
        "frequency of their messages",
    )
    silent_after_s: float = Field(
        default=3.0, gt=0.0, description="time without raw measurements after which the satellites are not evaluated"
    )


class Process:
    """Publishes the statement `satellites` and positions without satellites, or once a second why there are none."""

    def __init__(self, config: Config) -> None:
        self._silent_ns = round(config.silent_after_s * 1e9)
        self._uses_unsigned = config.unsigned_neighbours
        self._rate, self._risk = config.false_alarm_rate, config.integrity_risk
        model = replace(ErrorModel(), elevation_mask_rad=radians(config.elevation_mask_deg))
        self._plain = SatelliteMonitor(RaimSettings(config.false_alarm_rate, config.missed_detection_rate, model=model))
        self._carrier = CarrierTrack(model)
        self._cooperative: CooperativeMonitor | None = None
        if config.method != "plain":
            self._cooperative = CooperativeMonitor(
                CooperativeSettings(
                    BankSettings(config.false_alarm_rate),
                    model=model,
                    missed_detection_rate=config.missed_detection_rate,
                    paper_construction=config.method == "paper",
                    learn_oscillators=config.learn_oscillators,
                )
            )
            self._cooperative.alert_limit_m = config.vehicle.alert_limit_horizontal_m
        self._plainly_excluded: frozenset[SatelliteId] = frozenset()  # by plain RAIM, in the epoch before
        self._neighbours: deque[NeighbourStates] = deque()
        self._radio: str | None = None
        self._radio_ns = 0  # of its newest list
        self._now_ns: int | None = None
        self._store = EphemerisStore()
        self._rejected: Counter[str] = Counter()
        self._gps_minus_obu_ns: int | None = None
        self._receivers = ChosenSource(receiver_choice)
        self._epoch_ns: int | None = None  # stamp of the newest epoch that was evaluated
        self._statements = SatelliteStatements(config.vehicle.alert_limit_horizontal_m)

    @property
    def rejects(self) -> Counter[str]:
        """Rejected measurements and navigation words by reason."""
        return self._rejected + Counter(self._store.rejected)

    def handle(self, message: In) -> Iterator[Out]:
        """Use measurements and navigation words."""
        match message:
            case GnssRawEpoch():
                yield from self._use_epoch(message)
            case GnssNavigationBits():
                self._use_bits(message)
            case GnssFix():
                if message.gps_time_ns is not None:
                    self._gps_minus_obu_ns = message.gps_time_ns - message.sampled_ns
            case ModeState():
                self._receivers.follow(message)
            case NeighbourStates():
                self._use_neighbours(message)
            case Tick():
                self._now(message.now_ns)
                if self._is_silent(message.now_ns):
                    yield self._statements.silent(message.now_ns, self._epoch_ns)
                    yield self._hypotheses(None, why_silent(message.now_ns, self._epoch_ns), message.now_ns)

    def _use_epoch(self, message: GnssRawEpoch) -> Iterator[Out]:
        if not self._receivers.takes(message.source, message.received_ns):
            self._rejected["second_receiver"] += 1
            return
        self._gps_minus_obu_ns = message.gps_time_ns - message.sampled_ns
        epoch = RawEpoch(message.gps_time_ns, tuple(filter(None, map(_measurement, message.measurements))))
        displaced = self._carrier.follow(epoch, message.source, message.sampled_ns, message.received_ns, self._store)
        if displaced is not None:
            yield displaced
        if self._epoch_ns is not None and 0 <= message.sampled_ns - self._epoch_ns < PERIOD_NS:
            return
        self._epoch_ns = message.sampled_ns
        self._now(message.sampled_ns)
        reports = tuple(self._reports_until(message.sampled_ns))
        plain, cooperative = self._evaluate(epoch, reports)
        if plain.solution is not None:
            self._carrier.locate(plain.solution, epoch.gps_time_ns)
        counted = {**(cooperative.rejected if cooperative else {}), **plain.rejected}
        self._rejected.update({reason: n for reason, n in counted.items() if reason not in ORDINARY_REJECTS})
        yield self._statements.of_epoch(plain, cooperative, epoch, message.sampled_ns)
        if (fix := fault_free_fix(plain, message)) is not None:
            yield fix
        all_in_view = self._plain.all_in_view()
        yield self._hypotheses(
            all_in_view, None if all_in_view or plain.evaluated else why_not(plain, epoch), message.sampled_ns
        )

    def _hypotheses(self, all_in_view: PositionFit | None, why: Explanation | None, time_ns: int) -> TrustHypotheses:
        return satellite_hypotheses(all_in_view, why, time_ns, false_alarm_rate=self._rate, risk=self._risk)

    def _evaluate(
        self, epoch: RawEpoch, reports: tuple[NeighbourReport, ...]
    ) -> tuple[SatelliteVerdict, SatelliteVerdict | None]:
        """Test with neighbours first, and then plainly what is left.

        The filters start from a plain solution that has passed its test: without redundancy, as while ephemerides are
        collected after a gap, an error of any size may be in it, and healthy satellites would be excluded for it.
        What plain RAIM excludes in an epoch the filters do not use from then on. Where the filters exclude more than
        two satellites and all of them agree with one another, no satellite is at fault: all signals are false and the
        neighbours contradict them, or they were false and are true again. GNSS is accused as a whole in that epoch, and
        the filters start anew.
        """
        cooperative, plain = self._cooperative, None
        if cooperative is None:
            return self._plain.evaluate(epoch, self._store), None
        if not cooperative.runs_until(epoch.gps_time_ns):
            plain = self._plain.evaluate(epoch, self._store)
        start = plain.solution if plain and plain.fault_free else None
        helped = cooperative.evaluate(epoch, self._store, reports, road_e=None, start=start)
        restarts = len(helped.excluded) > MAX_FAULTY and self._plain.all_agree(epoch, self._store)
        if restarts:
            cooperative.restart()
            helped = SatelliteVerdict(
                Outcome.NOT_EVALUATED, explain(Code.FILTERS_RESTART), neighbours=helped.neighbours,
                rejected=helped.rejected,
            )  # fmt: skip
        plain = plain or self._plain.evaluate(epoch, self._store, frozenset(helped.excluded))
        if restarts:
            plain = replace(plain, outcome=Outcome.ACCUSES, fault_free=False, why=helped.why)
        if plain.fault_free:
            excluded = frozenset(plain.excluded)
            cooperative.exclude(excluded - self._plainly_excluded)
            self._plainly_excluded = excluded
        return plain, helped

    def _use_neighbours(self, message: NeighbourStates) -> None:
        if self._now_ns is not None and message.sampled_ns > self._now_ns + MAX_LEAD_NS:
            self._rejected["neighbour_from_the_future"] += len(message.neighbours)
            return
        if self._radio is None or abs(message.sampled_ns - self._radio_ns) > self._silent_ns:
            self._radio = message.source  # the first one, or the former one is silent
            self._neighbours.clear()
        if message.source != self._radio:
            self._rejected["second_radio"] += 1
            return
        self._radio_ns = max(self._radio_ns, message.sampled_ns)
        if self._neighbours and message.sampled_ns <= self._neighbours[-1].sampled_ns:
            self._rejected["late_neighbour"] += len(message.neighbours)
        else:
            self._neighbours.append(message)
        while len(self._neighbours) > MAX_LISTS:
            self._rejected["too_many_neighbours"] += len(self._neighbours.popleft().neighbours)

    def _now(self, time_ns: int) -> None:
        """Note the time, and drop lists of a later one: they came before the time was known."""
        self._now_ns = time_ns
        for states in [neighbour for neighbour in self._neighbours if neighbour.sampled_ns > time_ns + MAX_LEAD_NS]:
            self._rejected["neighbour_from_the_future"] += len(states.neighbours)
            self._neighbours.remove(states)
        self._radio_ns = min(self._radio_ns, time_ns + MAX_LEAD_NS)

    def _reports_until(self, time_ns: int) -> Iterator[NeighbourReport]:
        """Neighbours of lists up to a time; those of later lists wait for the next epoch."""
        assert self._gps_minus_obu_ns is not None
        while self._neighbours and self._neighbours[0].sampled_ns <= time_ns:
            states = self._neighbours.popleft()
            gps_time_ns = states.sampled_ns + self._gps_minus_obu_ns
            for neighbour in states.neighbours:
                if neighbour.authenticated is False and not self._uses_unsigned:
                    self._rejected["neighbour_not_authenticated"] += 1
                else:
                    yield _report(neighbour, gps_time_ns)

    def _use_bits(self, message: GnssNavigationBits) -> None:
        if (message.constellation.value, message.signal) not in SIGNALS:
            return
        if self._gps_minus_obu_ns is None:
            self._rejected["navigation_words_without_time"] += 1
            return
        satellite = SatelliteId(Constellation(message.constellation.value), message.number)
        self._store.add_words(satellite, message.words, message.received_ns + self._gps_minus_obu_ns)

    def _is_silent(self, now_ns: int) -> bool:
        return self._epoch_ns is None or abs(now_ns - self._epoch_ns) > self._silent_ns


def _measurement(one: RawMeasurement) -> Measurement | None:
    """Measurement of a signal on L1 or E1 with a valid pseudorange; None of any other."""
    if (one.constellation.value, one.signal) not in SIGNALS or one.pseudorange_m is None:
        return None
    satellite = SatelliteId(Constellation(one.constellation.value), one.number)
    return Measurement(
        satellite, one.pseudorange_m, one.doppler_hz, one.cn0_db_hz, one.carrier_phase_cycles, one.lock_time_s,
        one.half_cycle_resolved,
    )  # fmt: skip


def _report(one: Neighbour, gps_time_ns: int) -> NeighbourReport:
    """Report in ECEF; an accuracy is the largest standard deviation in any direction."""
    place = Geodetic(radians(one.latitude_deg), radians(one.longitude_deg), one.height_ellipsoid_m)
    vx, vy, vz = (ned_from_ecef(place.latitude, place.longitude).T @ np.array(one.velocity_ned_m_s)).tolist()
    return NeighbourReport(
        str(one.station_id), ecef_from_geodetic(place), (vx, vy, vz),
        largest_sd(one.position_cov_ned_m2), largest_sd(one.velocity_cov_ned_m2_s2),
        one.cfo_hz, one.oscillator_offset, one.cfo_sd_hz, gps_time_ns,
    )  # fmt: skip


def largest_sd(cov: Symmetric3) -> float | None:
    """Root of the largest eigenvalue of a covariance, upper triangle row by row; None of what is none."""
    matrix = np.zeros((3, 3))
    matrix[np.triu_indices(3)] = cov
    if not np.abs(matrix).max() < 1e12:
        return None
    variances = np.linalg.eigvalsh(matrix, UPLO="U")
    return float(np.sqrt(variances[-1])) if variances[0] > 0.0 else None
