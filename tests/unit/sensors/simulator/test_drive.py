from dataclasses import replace

import numpy as np
import pytest

from services.sensors.simulator.drive import simulate
from services.sensors.simulator.gnss.gnss_errors import BASE_SD, ErrorKind, InjectedError, position_errors
from services.sensors.simulator.scenarios import BY_NAME, DEGRADED_RMSE, with_error
from tests.support.cases import each

SETTLED = slice(14, None)  # fixes of t >= 15 s
KINDS = [ErrorKind.WHITE, ErrorKind.GAUSS_MARKOV, ErrorKind.WIENER]


@each("number", range(1, 6))
@each("seed", [0, 7])
def test_the_degraded_gnss_has_exactly_the_rmse_of_the_paper(number: int, seed: int) -> None:
    drive = simulate(f"degraded-{number}", seed)
    rmse = np.sqrt((drive.fix_error_n[SETTLED] ** 2).mean(axis=0))
    assert rmse == pytest.approx(DEGRADED_RMSE[number - 1], rel=1e-12)
    assert drive.fix_position_sd_n[0] == pytest.approx(rmse)


@pytest.mark.parametrize("kind", KINDS)
def test_an_error_of_any_kind_is_scaled_exactly(kind: ErrorKind) -> None:
    error = InjectedError(kind, (3.07, 1.99, 1.56), correlation_s=20.0, exact=True)
    drive = simulate(with_error(BY_NAME["parking_lot"], error), seed=3)
    assert np.sqrt((drive.fix_error_n[SETTLED] ** 2).mean(axis=0)) == pytest.approx((3.07, 1.99, 1.56), rel=1e-12)


def test_an_exact_rmse_below_the_receiver_noise_is_rejected() -> None:
    with pytest.raises(ValueError, match="receiver noise"):
        position_errors(InjectedError(ErrorKind.WHITE, (0.1, 0.1, 0.1), exact=True), 240, 1.0, seed=(1,))


def test_the_autocorrelation_of_a_gauss_markov_error_decays_with_its_correlation_time() -> None:
    error = InjectedError(ErrorKind.GAUSS_MARKOV, (1.0, 1.0, 1.0), correlation_s=5.0)
    walk = position_errors(error, 200_000, 1.0, seed=(4,)).injected
    lagged = (walk[5:] * walk[:-5]).mean(axis=0) / (walk**2).mean(axis=0)
    # The 200,000 epochs hold about 20,000 independent values: 0.7 % at 1 sigma.
    assert lagged == pytest.approx(np.full(3, np.exp(-1.0)), abs=0.03)
    assert walk.std(axis=0) == pytest.approx(np.ones(3), rel=0.03)


def test_a_gauss_markov_error_is_continuous_from_period_to_period() -> None:
    error = InjectedError(ErrorKind.GAUSS_MARKOV, (1.0, 1.0, 1.0), correlation_s=500.0)
    first = position_errors(error, 100, 1.0, seed=(1, 0))
    second = position_errors(error, 100, 1.0, seed=(1, 1), last=first.last)
    assert np.abs(second.injected[0] - first.injected[-1]).max() < 0.3


@pytest.mark.parametrize("name", ["parking_lot", "highway", "urban"])
def test_reported_standard_deviations_match_the_errors(name: str) -> None:
    drives = [simulate(name, seed, duration_s=240.0) for seed in range(4)]
    ratio = np.concatenate([(d.fix_error_n / d.fix_position_sd_n)[d.fix_valid] for d in drives])
    # The urban errors have a correlation time of 5 s: about 100 independent values per axis, 7 % at 1 sigma.
    assert np.sqrt((ratio**2).mean(axis=0)) == pytest.approx(np.ones(3), abs=0.25)
    drive = drives[0]
    index = drive.fix_ns // 10_000_000 - 1
    lever = np.cross(drive.ideal_rate_b[index], drive.lever_arm_b)
    velocity_error = drive.fix_velocity_n - drive.velocity_n[index]
    still = np.linalg.norm(lever, axis=1) < 1e-3
    normalised = (velocity_error / drive.fix_velocity_sd_n)[still & drive.fix_valid]
    assert normalised.std() == pytest.approx(1.0, abs=0.15)


def test_the_noise_of_an_autonomous_fix_has_the_stated_standard_deviation() -> None:
    errors = np.concatenate([simulate("parking_lot", seed).fix_error_n for seed in range(5)])
    assert errors.std(axis=0) == pytest.approx(BASE_SD["none"], rel=0.1)


def test_the_parking_lot_drive_has_the_length_stops_and_speed_of_the_paper() -> None:
    for seed in range(5):
        drive = simulate("parking_lot", seed)
        speed = np.linalg.norm(drive.velocity_n, axis=1)
        assert len(drive.t_ns) == 24_000
        assert len(drive.fix_ns) == 240
        assert not speed[:1500].any()
        assert 680.0 < speed.sum() * 0.01 < 890.0
        assert 0.21 < (speed == 0.0).mean() < 0.30
        assert speed.max() < 7.0
        assert np.abs(drive.ideal_rate_b[:, 2]).max() > 4.0 / 6.0 - 0.05


def test_equal_seeds_give_equal_drives_and_different_seeds_differ() -> None:
    first, again, other = simulate("urban", 1, 30.0), simulate("urban", 1, 30.0), simulate("urban", 2, 30.0)
    assert np.array_equal(first.force_b, again.force_b)
    assert np.array_equal(first.fix_position, again.fix_position)
    assert not np.array_equal(first.force_b, other.force_b)


def test_all_measurements_have_noise() -> None:
    drive = simulate("parking_lot", 0, 30.0)
    for measured, ideal in ((drive.force_b, drive.ideal_force_b), (drive.rate_b, drive.ideal_rate_b)):
        assert (np.ptp(measured - ideal, axis=0) > 0.0).all()
    assert (drive.fix_error_n != 0.0).all()
    assert (drive.odometer[drive.odometer > 0.0] % 0.01 != 0.0).any()


def test_fixes_end_in_a_tunnel_and_the_ambiguity_state_recovers_from_none_over_float_to_fixed() -> None:
    drive = simulate("tunnel", 1)
    edges = np.flatnonzero(np.diff(drive.fix_valid.astype(int)))
    assert len(edges) >= 4
    lost = np.diff(drive.fix_ns[edges])[::2]
    assert lost.min() > 10e9
    assert lost.max() > 35e9
    assert np.array_equal(drive.fix_position[edges[0] + 1], drive.fix_position[edges[0]]), "position is repeated"
    rtk = simulate(replace(BY_NAME["tunnel"], carrier="fixed"), 1)
    back = edges[1] + 1
    assert rtk.fix_position_sd_n[back, 0] == BASE_SD["none"][0]
    assert rtk.fix_position_sd_n[back + 10, 0] == BASE_SD["float"][0]
    assert rtk.fix_position_sd_n[back + 30, 0] == BASE_SD["fixed"][0]


def test_the_error_for_an_unknown_scenario_lists_the_known_ones() -> None:
    with pytest.raises(ValueError, match="unknown scenario 'moon'; try one of parking_lot"):
        simulate("moon")


def test_a_drive_too_short_for_a_fix_is_rejected() -> None:
    with pytest.raises(ValueError, match="no fix"):
        simulate("urban", duration_s=0.5)
