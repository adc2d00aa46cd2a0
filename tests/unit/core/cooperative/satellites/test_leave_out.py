"""Positions without a satellite or a constellation: closed forms, consistency, and what the process publishes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from services.core.cooperative.hypotheses import SOLUTIONS_MAXIMUM, _ratio, satellite_hypotheses
from services.core.cooperative.measurements import Constellation, FloatArray, Measurement, RawEpoch, SatelliteId
from services.core.cooperative.process import Config, In, Process
from services.core.cooperative.satellites.leave_out import LINEAR_M, _separation, solutions_without
from services.core.cooperative.satellites.model import ErrorModel, Sky, usable_sights
from services.core.cooperative.satellites.solution import PositionFit, fit_position, fit_velocity, masked
from shared.maths.earth import Geodetic, ecef_from_geodetic
from shared.messages.base import Tick
from shared.messages.trust import Hypothesis, HypothesisSolution, TrustHypotheses
from tests.support.gnss.constellation import filled_store, pushed, raw_epoch
from tests.unit.core.cooperative.satellites.test_satellite_process import HERE, NS, at, informed, message

STORE, RATE, RISK = filled_store(), 1e-5, 1e-3


def fit(epoch: RawEpoch) -> PositionFit:
    model = ErrorModel()
    found, _ = masked(Sky(usable_sights(epoch, STORE, model)[0], epoch.gps_time_ns, STORE.ionosphere, model), HERE)
    assert found is not None
    return found


CLEAN = raw_epoch(HERE)
SD = fit(CLEAN).fit.sd  # all its satellites are above the mask


def noisy(seed: int = 3) -> RawEpoch:
    """The same satellites with the noise that the model of errors expects."""
    rng = np.random.default_rng(seed)
    noise = SD * rng.standard_normal(len(SD))
    measurements = zip(CLEAN.measurements, noise.tolist(), strict=True)
    return replace(
        CLEAN,
        measurements=tuple(
            replace(measurement, pseudorange_m=measurement.pseudorange_m + more) for measurement, more in measurements
        ),
    )


def refit(position: PositionFit, without: tuple[SatelliteId, ...]) -> PositionFit:
    """The others, solved from the start."""
    sights = tuple(sight for sight in position.sky.sights if sight.satellite not in without)
    found = fit_position(replace(position.sky, sights=sights), None)
    assert found is not None
    return found


def place_e(one: PositionFit) -> FloatArray:
    moved: FloatArray = one.geometry.position_e + one.geometry.ned_from_ecef.T @ one.fit.parameters[:3]
    return moved


def published(process: Process, *messages: In) -> list[TrustHypotheses]:
    found = [item for message_ in messages for item in process.handle(message_)]
    return [trust_hypotheses for trust_hypotheses in found if isinstance(trust_hypotheses, TrustHypotheses)]


def named(solutions: tuple[HypothesisSolution, ...], *left_out: str) -> HypothesisSolution:
    return next(solution for solution in solutions if solution.left_out == left_out)


def test_each_position_covariance_and_velocity_is_that_of_a_fit_of_the_others() -> None:
    position = fit(noisy())
    found = solutions_without(position, RATE)
    assert len(found) == len(position.satellites) + 2, "each satellite and each constellation"
    for left_out in found:
        others = refit(position, left_out.satellites)
        apart_e = place_e(position) - place_e(others)
        assert position.geometry.ned_from_ecef @ apart_e == pytest.approx(left_out.apart_n, abs=5e-3), (
            "[m]; delays vary"
        )
        assert left_out.cov_n == pytest.approx(others.fit.cov[:3, :3], rel=1e-3, abs=1e-4)
        assert left_out.innovations == pytest.approx(others.fit.statistic / others.fit.dof, rel=1e-3)
        velocity = fit_velocity(others, RATE)
        assert velocity is not None
        assert position.geometry.ned_from_ecef @ velocity.velocity_e == pytest.approx(left_out.velocity_n, abs=1e-3)


def test_the_separation_of_a_satellite_is_the_square_of_its_w() -> None:
    position = fit(noisy())
    separations = [
        left_out.separation for left_out in solutions_without(position, RATE) if len(left_out.satellites) == 1
    ]
    assert separations == pytest.approx(list(position.fit.w**2))


def test_the_covariance_of_the_difference_is_that_of_the_part_minus_that_of_the_whole() -> None:
    """Over 400 epochs of noise: differences are as large as P_sub - P_all says, and separations are chi-square."""
    apart, expected, separations = [], [], []
    for seed in range(400):
        position = fit(noisy(seed))
        chosen = [left_out for left_out in solutions_without(position, RATE) if len(left_out.satellites) > 1]
        gps = next(left_out for left_out in chosen if left_out.satellites[0].constellation is Constellation.GPS)
        apart.append(gps.apart_n)
        expected.append(gps.cov_n - position.fit.cov[:3, :3])
        separations.append(gps.separation or 0.0)
        assert gps.separation_dof == 2
    measured, mean = np.cov(np.array(apart).T), np.mean(expected, axis=0)
    # a variance of 400 samples has a relative standard deviation of sqrt(2/400) = 7 %
    assert np.diag(measured) == pytest.approx(np.diag(mean), rel=0.25)
    assert np.mean(separations) == pytest.approx(2.0, abs=0.35), "standard deviation of the mean 0.1"
    above = np.mean(np.array(separations) > chi2.isf(0.1, 2))
    assert above == pytest.approx(0.1, abs=0.05), "standard deviation 0.015"


def test_a_faulty_satellite_has_the_smallest_residuals_and_the_largest_separation_without_it() -> None:
    for row in range(0, len(noisy().measurements), 3):
        victim = noisy().measurements[row].satellite
        position = fit(pushed(noisy(row), victim, 60.0))
        singles = [left_out for left_out in solutions_without(position, RATE) if len(left_out.satellites) == 1]
        assert min(singles, key=lambda left_out: left_out.innovations or 0.0).satellites == (victim,)
        assert max(singles, key=lambda left_out: left_out.separation or 0.0).satellites == (victim,)


def test_a_position_far_from_that_of_all_in_view_is_solved_by_iteration() -> None:
    victim = noisy().measurements[2].satellite
    position = fit(pushed(noisy(), victim, 30_000.0))
    (own,) = [left_out for left_out in solutions_without(position, RATE) if left_out.satellites == (victim,)]
    assert np.linalg.norm(own.apart_n) > LINEAR_M
    others = refit(position, (victim,))
    assert own.apart_n == pytest.approx(
        position.geometry.ned_from_ecef @ (place_e(position) - place_e(others)), abs=1e-2
    )
    assert own.innovations is not None and own.innovations < 3.0


def test_without_redundancy_nothing_is_determined_and_without_doppler_nothing_is_published() -> None:
    gps = tuple(
        measurement for measurement in noisy().measurements if measurement.satellite.constellation is Constellation.GPS
    )
    four = fit(RawEpoch(noisy().gps_time_ns, gps[:4]))
    assert solutions_without(four, RATE) == ()
    said = satellite_hypotheses(four, None, NS, false_alarm_rate=RATE, risk=RISK)
    assert [hypothesis for hypothesis, why in said.missing if why] == [Hypothesis.SATELLITES]
    mute = RawEpoch(
        noisy().gps_time_ns,
        tuple(Measurement(measurement.satellite, measurement.pseudorange_m) for measurement in noisy().measurements),
    )
    assert solutions_without(fit(mute), RATE) == ()
    said = satellite_hypotheses(fit(mute), None, NS, false_alarm_rate=RATE, risk=RISK)
    assert "range-rates" in said.missing[0][1]


def test_the_process_publishes_each_position_with_its_distance_level_and_limit() -> None:
    victim = at(1).measurements[3].satellite
    (first, second) = published(informed(), message(at(1), 1.0), message(at(2, push=(victim, 50.0)), 2.0))
    assert (first.source, first.sampled_ns, second.sampled_ns) == ("core.cooperative", NS, 2 * NS)
    assert all(solution.hypothesis is Hypothesis.SATELLITES for solution in first.solutions)
    limits = [(solution.separation or 0.0) / (solution.separation_limit or 1.0) for solution in second.solutions]
    assert limits == sorted(limits, reverse=True)
    assert second.solutions[0].left_out == (str(victim),), "it is left out although RAIM excludes it"
    own = named(second.solutions, str(victim))
    x, y, z = ecef_from_geodetic(
        Geodetic(np.radians(own.latitude_deg), np.radians(own.longitude_deg), own.height_ellipsoid_m)
    )
    error_m = float(np.linalg.norm(np.array([x, y, z]) - HERE))
    assert error_m < np.hypot(own.protection_level_horizontal_m, own.protection_level_vertical_m)
    others = [solution for solution in second.solutions if len(solution.left_out) == 1 and solution is not own]
    assert all((own.innovations or 0.0) < (hypothesis_solution.innovations or 0.0) for hypothesis_solution in others)


def test_levels_hold_the_error_but_for_the_risk() -> None:
    """Levels at 10 %: of 300 positions without one satellite some 30 are beyond, each way."""
    beyond = []
    for seed in range(300):
        position = fit(noisy(seed))
        said = satellite_hypotheses(position, None, NS, false_alarm_rate=RATE, risk=0.1)
        one = named(said.solutions, str(noisy().measurements[0].satellite))
        place = Geodetic(np.radians(one.latitude_deg), np.radians(one.longitude_deg), one.height_ellipsoid_m)
        error = position.geometry.ned_from_ecef @ (np.array(ecef_from_geodetic(place)) - HERE)
        beyond.append(
            [np.hypot(*error[:2]) > one.protection_level_horizontal_m, abs(error[2]) > one.protection_level_vertical_m]
        )
    assert np.mean(beyond, axis=0) == pytest.approx([0.1, 0.1], abs=0.055), "standard deviation 0.017"


def test_a_process_without_raw_measurements_says_why_once_a_second() -> None:
    process = Process(Config())
    first, second = published(process, Tick(now_ns=NS), Tick(now_ns=2 * NS))
    assert first.solutions == () and second.sampled_ns == 2 * NS
    assert first.missing == ((Hypothesis.SATELLITES, "no raw measurements: the receiver has sent none"),)
    assert len(published(informed(), *(message(at(0), 1.0 + 0.1 * k) for k in range(21)))) == 3


@pytest.mark.parametrize("push_m", [1e3, 1e5, 3e6, -3e6])
def test_an_absurd_pseudorange_ends_nothing(push_m: float) -> None:
    victim = at(1).measurements[3].satellite
    (said,) = published(informed(), message(at(1, push=(victim, push_m)), 1.0))
    assert said.solutions or said.missing
    assert all(solution.left_out == (str(victim),) or solution.innovations for solution in said.solutions)


def test_a_message_holds_the_largest_separations_if_there_are_more_than_it_takes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    position = fit(noisy())
    whole = satellite_hypotheses(position, None, NS, false_alarm_rate=RATE, risk=RISK)
    assert len(whole.solutions) == len(position.satellites) + 2 <= SOLUTIONS_MAXIMUM
    monkeypatch.setattr("services.core.cooperative.hypotheses.SOLUTIONS_MAXIMUM", 5)
    part = satellite_hypotheses(position, None, NS, false_alarm_rate=RATE, risk=RISK)
    assert part.solutions == whole.solutions[:5]


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e5])
def test_the_separation_of_two_positions_does_not_depend_on_the_unit_of_length(scale: float) -> None:
    """Against chi-square by its inverse; a direction without an extent does not count."""
    cov = scale**2 * np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 0.0]])
    apart = scale * np.array([1.0, -2.0, 3.0])
    expected = apart[:2] @ np.linalg.solve(cov[:2, :2], apart[:2])
    chi_square, directions = _separation(apart, cov)
    assert chi_square == pytest.approx(float(expected)) and directions == 2
    assert _separation(apart, np.zeros((3, 3))) == (None, 0)


@pytest.mark.parametrize(("separation", "limit", "ratio"), [(15.0, 30.0, 0.5), (None, None, 0.0), (None, 30.0, 0.0)])
def test_a_position_without_a_separation_is_the_last_to_be_shown(
    separation: float | None, limit: float | None, ratio: float
) -> None:
    assert _ratio(HypothesisSolution.model_construct(separation=separation, separation_limit=limit)) == ratio
