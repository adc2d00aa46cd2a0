"""False alarms of core.cooperative in fault-free epochs: `python -m benchmarks.false_alarms_satellites`.

Errors are as large as the error model says. Each row counts what begins an alarm:

- plain RAIM, the whole monitor on raw epochs of the simulator's satellites at many places and times, with independent
  errors: epochs whose global test fails. The same epochs serve all design rates.
- leave-one-out bank with four neighbours, on vehicles that drive as its filters expect, on the satellites of one of
  those places. Windows overlap, so that an exclusion counts once, in the epoch in which it begins. Errors are white, or
  a part of them is a Gauss-Markov process, as the error model has it: then the bank allows for constant errors, and
  false alarms are rarer than designed.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from math import exp, radians, sqrt

import numpy as np
from rich.console import Console

from benchmarks.false_alarms import CAMPAIGN, Count, table
from cli import campaign
from cli.papers.report import printed
from services.core.cooperative.broadcast.store import EphemerisStore
from services.core.cooperative.measurements import (
    Constellation,
    FloatArray,
    Measurement,
    RawEpoch,
    SatelliteId,
)
from services.core.cooperative.satellites.model import ErrorModel, Geometry, Sky, usable_sights
from services.core.cooperative.satellites.monitor import RaimSettings, SatelliteMonitor
from services.core.cooperative.v2x.bank import BankSettings, LeaveOneOutBank, Pseudoranges
from services.core.cooperative.v2x.forward import (
    CLOCK,
    DRIFT,
    OSCILLATOR,
    POSITION,
    VELOCITY,
    Estimate,
    Neighbours,
    correct_range_rates,
    predict,
    range_rates,
)
from services.core.cooperative.v2x.monitor import CAR
from services.sensors.simulator.gnss.navigation_words import inav_page, lnav_subframe
from services.sensors.simulator.gnss.raw_measurements import IONOSPHERE, Phases, RangeErrors, measure
from services.sensors.simulator.gnss.reception import Fix
from services.sensors.simulator.gnss.sky import SkyModel
from shared.maths.earth import Geodetic
from shared.maths.quantiles import chi_square_limit
from shared.messages.trust import Outcome

RATES = (1e-2, 1e-3, 1e-5)
PLACES = 50
BEGIN_S = 2300 * 604_800 + 3600
CORRELATION_S = 1800.0  # of orbits, clocks and atmosphere
CARS = 4
PUBLISHED_SD, PUBLISHED_CORRELATION_S, RATE_SD = 1.0, 30.0, 0.8  # [m], [s], [m/s]
SIZE = CLOCK + 2


def exact_epochs() -> Iterator[tuple[RawEpoch, EphemerisStore, Geometry]]:
    """Error-free epochs with their ephemerides and the geometry at the position of each."""
    model, rng = SkyModel(("gps", "galileo"), (1, 1)), np.random.default_rng(1)
    for _ in range(PLACES):
        time_s = BEGIN_S + float(rng.integers(86_400))
        latitude, longitude = radians(float(rng.uniform(-60, 60))), radians(float(rng.uniform(-180, 180)))
        place = Geodetic(latitude, longitude, 200.0)
        still = (0.0, 0.0, 0.0)
        fix = Fix(True, "none", place, still, still, still, still)
        sky = model.at(time_s, place, mask_deg=10.0, loss_db=0.0, covered=False)
        none = np.zeros_like(sky.residual_m)
        raw = measure(model, replace(sky, residual_m=none), fix, time_s, RangeErrors(none, none), Phases(place, none))
        names = [Constellation.GPS if gnss_id == 0 else Constellation.GALILEO for gnss_id in raw.gnss_id.tolist()]
        numbers = zip(names, raw.number.tolist(), strict=True)
        satellites = [SatelliteId(name, number) for name, number in numbers]
        store = EphemerisStore()
        store.ionosphere = IONOSPHERE
        for satellite, index in zip(satellites, raw.satellite.tolist(), strict=True):
            one, gps = model.orbits.elements(time_s, index), satellite.constellation is Constellation.GPS
            parts = (1, 2, 3) if gps else (1, 2, 3, 4, 5)
            for part in parts:
                words = lnav_subframe(one, part, int(time_s)) if gps else inav_page(one, part, int(time_s))
                store.add_words(satellite, words, round(time_s * 1e9))
        ranges = zip(satellites, raw.pseudorange_m.tolist(), raw.doppler_hz.tolist(), strict=True)
        measured = tuple(Measurement(satellite, m, doppler, 45.0) for satellite, m, doppler in ranges)
        epoch = RawEpoch(round(raw.gps_s * 1e9), measured)
        verdict = SatelliteMonitor().evaluate(epoch, store)
        assert verdict.solution is not None and not verdict.rejected and verdict.statistic is not None
        assert verdict.statistic < 1e-3, "the epoch is free of errors"
        sights, _ = usable_sights(epoch, store, ErrorModel())
        here = np.array(verdict.solution.position_e)
        yield epoch, store, Sky(sights, epoch.gps_time_ns, IONOSPHERE, ErrorModel()).geometry(here)


def plain(rates: tuple[float, ...], epochs: int, seed: int = 1) -> list[Count]:
    """Count epochs whose global test fails, each judged by itself; `rates` ends with the smallest."""
    rng, alarms, each = np.random.default_rng((seed, 1)), dict.fromkeys(rates, 0), epochs // PLACES
    settings = RaimSettings(false_alarm_rate=rates[-1])
    for epoch, store, geometry in exact_epochs():
        for _ in range(each):
            errors = (geometry.sd * rng.standard_normal(len(geometry.sd))).tolist()
            noisy = tuple(
                replace(measurement, pseudorange_m=measurement.pseudorange_m + error)
                for measurement, error in zip(epoch.measurements, errors, strict=True)
            )
            verdict = SatelliteMonitor(settings).evaluate(RawEpoch(epoch.gps_time_ns, noisy), store)
            failed = verdict.outcome is not Outcome.PASS
            for rate in rates:
                assert verdict.statistic is not None
                alarms[rate] += failed or verdict.statistic > chi_square_limit(verdict.dof, rate)
    return [Count("plain RAIM", rate, each * PLACES, alarms[rate], alarms[rate]) for rate in rates]


class Drives:
    """Many vehicles side by side, with true states that follow the forward model."""

    def __init__(self, geometry: Geometry, systems: tuple[int, ...], runs: int, seed: int) -> None:
        self._rng, self._forward, self._runs = np.random.default_rng((seed, 2)), CAR, runs
        n = len(geometry.sd)
        self._correlated_sd = np.sqrt(np.maximum(geometry.sd**2 - geometry.noise_sd**2, 0.0))
        self.ranges = Pseudoranges(
            geometry.line_of_sight_n, systems, np.zeros((runs, n)), geometry.noise_sd, self._correlated_sd,
            np.ones(n, dtype=np.bool_),
        )  # fmt: skip
        variances = np.zeros(SIZE)
        variances[POSITION], variances[VELOCITY], variances[CLOCK:] = 30.0**2, 1.0, 30.0**2
        variances[DRIFT], variances[OSCILLATOR] = 1.0, 100.0**2
        P = np.broadcast_to(np.diag(variances), (runs, SIZE, SIZE)).copy()
        self.start = Estimate(np.zeros((runs, SIZE)), P)
        self._truth = np.sqrt(variances) * self._rng.standard_normal((runs, SIZE))
        Q = predict(Estimate(np.zeros(SIZE), np.zeros((SIZE, SIZE))), 1.0, self._forward).P
        self._step = np.linalg.cholesky(Q + 1e-12 * np.eye(SIZE))
        self._slow = self._correlated_sd * self._rng.standard_normal((runs, n))
        shape = (runs, CARS)
        self._away = np.stack(
            [self._rng.uniform(-150.0, 150.0, shape), self._rng.choice([-25.0, 25.0], shape)], axis=-1
        )
        self._passing = self._rng.uniform(-10.0, 10.0, shape)
        self._published = PUBLISHED_SD * self._rng.standard_normal((runs, CARS, 3))

    def advance(self) -> tuple[Pseudoranges, Neighbours]:
        """Drive for a second, and measure."""
        self._truth = predict(Estimate(self._truth, np.zeros((SIZE, SIZE))), 1.0, self._forward).x
        self._truth += self._rng.standard_normal(self._truth.shape) @ self._step.T
        self._slow = self._kept(self._slow, CORRELATION_S, self._correlated_sd)
        self._published = self._kept(self._published, PUBLISHED_CORRELATION_S, PUBLISHED_SD)
        noise = self.ranges.sd * self._rng.standard_normal(self._slow.shape)
        y = self._truth @ self.ranges.rows(SIZE).T + self._slow + noise
        self._away[..., 0] += self._passing
        truth = self._truth[:, np.newaxis, :]
        position = truth[..., POSITION] + np.concatenate([self._away, np.zeros((self._runs, CARS, 1))], axis=-1)
        velocity = truth[..., VELOCITY] + np.stack([self._passing, 0 * self._passing, 0 * self._passing], axis=-1)
        sds = np.full((self._runs, CARS), PUBLISHED_SD), np.full((self._runs, CARS), RATE_SD)
        exact = Neighbours(position, velocity, np.zeros((self._runs, CARS)), *sds)
        rates = range_rates(self._truth[:, :6], exact) + self._truth[:, OSCILLATOR, np.newaxis]
        measured = rates + RATE_SD * self._rng.standard_normal(rates.shape)
        return replace(self.ranges, y=y), exact._replace(position_n=position + self._published, shifted_rate=measured)

    def _kept(self, errors: FloatArray, correlation_s: float, sd: FloatArray | float) -> FloatArray:
        kept = exp(-1.0 / correlation_s)
        moved: FloatArray = kept * errors + sqrt(1.0 - kept**2) * sd * self._rng.standard_normal(errors.shape)
        return moved


def bank(rate: float, runs: int, epochs: int, white: bool, seed: int = 1) -> list[Count]:
    """Count exclusions that begin."""
    epoch, _, geometry = next(exact_epochs())
    geometry = replace(geometry, noise_sd=geometry.sd) if white else geometry
    systems = tuple(
        int(measurement.satellite.constellation is Constellation.GALILEO) for measurement in epoch.measurements
    )
    drives, alarms, accusing = Drives(geometry, systems, runs, seed), 0, 0
    filters = LeaveOneOutBank(drives.start, len(systems), BankSettings(rate))
    for second in range(epochs):
        ranges, neighbours = drives.advance()
        predicted = predict(filters.estimate, 1.0, CAR)
        if second:
            seen_by_all = Neighbours(*(column[:, np.newaxis] for column in neighbours))
            predicted = correct_range_rates(predicted, seen_by_all)
        test = filters.advance(predicted, ranges)
        alarms += int(test.newly_excluded.any(axis=-1).sum())
        accusing += int(test.excluded.any(axis=-1).sum())
    errors = "white errors" if white else f"errors correlated over {CORRELATION_S:.0f} s"
    return [Count(f"leave-one-out bank, {errors}", rate, runs * epochs, alarms, accusing)]


def main() -> int:
    """Run the campaign; return 1 if a test has more false alarms than designed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.false_alarms_satellites", description=__doc__)
    options = campaign.options_of(parser, None, CAMPAIGN)
    jobs = [campaign.Job("plain RAIM", plain, (RATES, options.runs))] + [
        campaign.Job(f"bank at {rate:g}", bank, (rate, options.runs // 100, 100, white))
        for white in (True, False)
        for rate in RATES
    ]
    outcome = campaign.run("alarms-satellites", jobs, workers=options.workers, fresh=options.fresh, smoke=options.smoke)
    counts = [count for result in outcome.results for count in result]
    console = Console()
    console.print(printed(table("satellites", counts)))
    console.print(CAMPAIGN.note(options.runs))
    campaign.worth_storing(options, outcome)
    return 1 if not outcome.complete or any(count.verdict == "too many" for count in counts) else 0


if __name__ == "__main__":
    raise SystemExit(main())
