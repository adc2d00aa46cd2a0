"""GNSS error model given by settings: equal to a certain hypothesis of the bank, and consistent."""

from dataclasses import replace
from functools import cache
from math import radians

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import chi2

from cli.papers.navigation import navigate, saved_heading
from services.core.fusion.aids.gnss import position_errors
from services.core.fusion.aids.gnss.correlated import position_errors_of
from services.core.fusion.aids.gnss.fix import GnssPosition
from services.core.fusion.aids.gnss.position_errors import (
    HYPOTHESES,
    SCALES,
    UNKNOWN_ERRORS,
    GnssErrorBank,
    KnownGnssErrors,
    mean_at_rest,
)
from services.core.fusion.aids.gnss.settings import GnssSettings
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.start.alignment import Alignment
from services.core.fusion.start.initial_position import first_place
from services.sensors.simulator.drive import Drive, simulate
from services.sensors.simulator.gnss.gnss_errors import ErrorKind, InjectedError
from services.sensors.simulator.scenarios import scenario_of, with_error
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference

FloatArray = npt.NDArray[np.float64]
RMSE = (3.07, 1.99, 1.56)
SD = np.array(RMSE)
DURATION_S, RUNS = 60.0, 6
PERIOD_S = scenario_of("parking_lot").duration_s  # [s] over which a simulated random walk has the stated mean square
TIME_S, SHARE = 5.0, 0.01  # as one of the hypotheses
GIVEN: dict[str, float | bool] = {"gnss.correlation_time_s": TIME_S, "gnss.white_noise_share": SHARE}
ORIGIN = Geodetic(0.74, 0.23, 700.0)


def certain() -> GnssErrorBank:
    """Bank with overwhelming evidence for one hypothesis and one scale."""
    evidence = np.zeros_like(UNKNOWN_ERRORS.evidence)
    evidence[:, HYPOTHESES.index((TIME_S, SHARE)), SCALES.tolist().index(1.0)] = 1e6
    return replace(UNKNOWN_ERRORS, evidence=evidence)


@cache
def drive_of(kind: ErrorKind, seed: int) -> Drive:
    error = InjectedError(kind, RMSE, correlation_s=TIME_S)
    return simulate(with_error(scenario_of("parking_lot"), error), seed, duration_s=DURATION_S)


@cache
def navigated(kind: ErrorKind, seed: int, **settings: float | bool) -> Navigator:
    """Navigator at the end of a drive."""
    drive = drive_of(kind, seed)
    navigator = Navigator(Settings().with_values({"vehicle.gnss.lever_arm_body_m": drive.lever_arm_b, **settings}))
    navigator.use_prior(saved_heading(drive, radians(1.5)))
    navigate(drive, navigator)
    return navigator


def fixes_at_rest() -> list[GnssPosition]:
    """One fix a second at given distances to the north."""
    places = [geodetic_from_ned_difference((north, 0.0, 0.0), ORIGIN) for north in (0.0, 0.4, 0.3, 0.9)]
    return [
        GnssPosition(i * 10**9, i * 10**9, "", place, np.diag(SD**2), 3, (0.0, 0.0, 0.0), 0.0, time_correlated=True)
        for i, place in enumerate(places)
    ]


def test_a_stated_error_model_equals_a_bank_with_one_certain_hypothesis() -> None:
    stated, bank = KnownGnssErrors(TIME_S, 1.0 - SHARE), certain()
    assert (bank.correlation_s, bank.correlated_share) == pytest.approx((TIME_S, 1.0 - SHARE))
    assert stated.unit == pytest.approx(bank.unit)
    assert stated.scaled(np.diag(SD**2)) == pytest.approx(bank.scaled(np.diag(SD**2)))
    one, other = first_place(fixes_at_rest(), stated), first_place(fixes_at_rest(), bank)
    assert one.position == pytest.approx(other.position, abs=1e-12)
    assert one.error == pytest.approx(other.error, abs=1e-9)
    assert one.cross_cov == pytest.approx(other.cross_cov)


def test_a_drive_with_a_stated_error_model_equals_one_with_a_certain_hypothesis(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """To a micrometre: the weights of the bank are rounded."""
    stated = navigated(ErrorKind.GAUSS_MARKOV, 1, **GIVEN).solution()
    monkeypatch.setattr(position_errors, "UNKNOWN_ERRORS", certain())
    certainly = navigated.__wrapped__(ErrorKind.GAUSS_MARKOV, 1).solution()
    assert stated is not None and certainly is not None
    apart = ned_from_geodetic_difference(stated.position, certainly.position)
    assert apart == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert stated.position_cov == pytest.approx(certainly.position_cov, rel=1e-6)


def test_without_a_stated_error_model_it_is_estimated() -> None:
    filter_ = navigated(ErrorKind.GAUSS_MARKOV, 1).engine.filter
    assert filter_ is not None
    learned = position_errors_of(filter_)
    assert isinstance(learned, GnssErrorBank) and learned.time_ns is not None, "updated by fixes"
    stated = navigated(ErrorKind.GAUSS_MARKOV, 1, **GIVEN).engine.filter
    assert stated is not None and position_errors_of(stated) == KnownGnssErrors(TIME_S, 1.0 - SHARE)


def test_an_error_that_was_zero_long_ago_has_the_stationary_covariance() -> None:
    times = np.array([-9.0, -5.0, -4.0, 0.0])
    for mine, known in zip(mean_at_rest(times, 0.7, 6.0), mean_at_rest(times, 0.7, 6.0, -1e6), strict=True):
        assert (mine == known).all(), "zero many correlation times ago"


def test_the_covariance_of_errors_that_start_at_zero_agrees_with_drawn_errors() -> None:
    """20,000 draws of processes that are zero one second before the first fix; 4 % tolerance."""
    times, zero, correlated_share, time_s = np.array([-9.0, -5.0, -4.0, -1.0, 0.0]), -10.0, 0.9, 20.0
    weights, joint = mean_at_rest(times, correlated_share, time_s, zero)
    rng, state, before, rows = np.random.default_rng(0), np.zeros(20_000), zero, []
    for time in times.tolist():
        phi = np.exp(-(time - before) / time_s)
        state = phi * state + np.sqrt(correlated_share * (1.0 - phi**2)) * rng.standard_normal(20_000)
        rows.append(state)
        before = time
    fixes = np.array(rows).T + np.sqrt(1.0 - correlated_share) * rng.standard_normal((20_000, 5))
    wrong = fixes @ weights.T - np.column_stack([np.zeros(20_000), rows[-1]])
    assert np.cov(wrong.T) == pytest.approx(joint, rel=0.04, abs=0.005)


def test_with_errors_that_start_at_zero_the_initial_position_is_the_first_fix() -> None:
    """The position has the accuracy of the white part of a fix, and the error grows from there."""
    first = first_place(fixes_at_rest(), KnownGnssErrors(240.0, 1.0 - 1e-4), zero_ns=0)
    assert ned_from_geodetic_difference(first.position, ORIGIN) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    assert np.sqrt(np.diag(first.cov)) == pytest.approx(0.01 * SD, rel=0.05)
    assert first.error[0] * SD[0] == pytest.approx(0.9, abs=0.05)


def test_only_the_first_alignment_assumes_a_zero_error() -> None:
    """After a reset the errors have grown since the first alignment."""
    settings = Settings(gnss=GnssSettings(correlation_time_s=240.0, zero_error_at_start=True))
    first, second = Alignment(settings), Alignment(settings, first=False)
    fix = fixes_at_rest()[0]
    for start in (first, second):
        start.start_at(fix)
    assert first._first_place(fix).cov[0, 0] < 0.05 * SD[0] ** 2
    assert second._first_place(fix).cov[0, 0] == pytest.approx(SD[0] ** 2)


@pytest.mark.parametrize(
    ("kind", "given"),
    [
        (ErrorKind.GAUSS_MARKOV, GIVEN),
        (ErrorKind.WIENER, {"gnss.correlation_time_s": PERIOD_S, "gnss.zero_error_at_start": True}),
    ],
    ids=["5 s", "walk"],
)
def test_with_a_stated_error_model_the_nees_is_in_the_99_percent_band(
    kind: ErrorKind, given: dict[str, float | bool]
) -> None:
    """Sum of normalised errors squared of six runs, in the 99 % band of chi-square of 18."""
    nees = 0.0
    for seed in range(RUNS):
        drive = drive_of(kind, seed)
        solution = navigated(kind, seed, **given).solution()
        assert solution is not None
        error = np.array(ned_from_geodetic_difference(solution.position, Geodetic(*drive.position[-1].tolist())))
        nees += float(error @ np.linalg.solve(solution.position_cov, error))
    assert chi2.ppf(0.005, 3 * RUNS) < nees < chi2.isf(0.005, 3 * RUNS), nees / (3 * RUNS)
