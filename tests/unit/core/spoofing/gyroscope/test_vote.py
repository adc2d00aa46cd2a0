"""Chi-square of the yaw rates' differences against independent algebra, its false-alarm rate, and who is named."""

from math import inf, radians

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from services.core.spoofing.gyroscope.vote import ACQUIT_RATE, Difference, Source, chi_square, vote

SD = radians(0.05)
COMMON = radians(0.01) ** 2
RATE = 1e-6


def differences(**degrees_s: float) -> dict[Source, Difference]:
    """Differences [deg/s] by the name of the source, all of the same spread."""
    return {Source[name.upper()]: Difference(radians(value), SD**2) for name, value in degrees_s.items()}


@pytest.mark.parametrize("seed", range(5))
def test_chi_square_is_that_of_the_whole_covariance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    d, v, c = rng.normal(size=4), rng.uniform(0.5, 2.0, 4), 0.7
    found = {source: Difference(*pair) for source, pair in zip(Source, zip(d, v, strict=True), strict=True)}
    C = np.diag(v) + c * np.ones((4, 4))
    assert chi_square(found, c) == pytest.approx(float(d @ np.linalg.solve(C, d)), rel=1e-9)


def test_with_an_unknown_error_of_the_gyroscope_it_is_the_least_of_all_such_errors() -> None:
    found = {
        Source.WHEELS: Difference(1.0, 0.5),
        Source.COURSE: Difference(1.4, 0.2),
        Source.ANTENNA: Difference(0.7, 1),
    }

    def off(b: float) -> float:
        return sum((difference.rate - b) ** 2 / difference.variance for difference in found.values())

    assert chi_square(found, inf) == pytest.approx(minimize_scalar(off).fun, rel=1e-9)


def test_the_threshold_is_exceeded_as_often_as_stated() -> None:
    rng, rate, n = np.random.default_rng(1), 0.01, 20_000
    noise = SD * rng.normal(size=(n, 3)) + COMMON**0.5 * rng.normal(size=(n, 1))
    hard = (Source.WHEELS, Source.COURSE, Source.ANTENNA)
    above = 0
    for row in noise.tolist():
        ballot = vote({s: Difference(d, SD**2) for s, d in zip(hard, row, strict=True)}, COMMON, rate)
        assert ballot is not None
        above += ballot.statistic > ballot.threshold
    assert abs(above - n * rate) < 4.0 * (n * rate) ** 0.5


@pytest.mark.parametrize(
    ("found", "suspects"),
    [
        pytest.param(differences(wheels=0.5, course=0.5), ("imu",), id="gyroscope against two that agree"),
        pytest.param(differences(wheels=0.0, course=0.5), ("gnss",), id="course against two that agree"),
        pytest.param(differences(wheels=0.5, course=0.0), ("odometer",), id="wheels against two that agree"),
        pytest.param(differences(wheels=0.5, antenna=0.5), ("imu",), id="the second antenna in place of the course"),
        pytest.param(differences(wheels=0.5), ("imu", "odometer"), id="gyroscope and wheels alone"),
        pytest.param(differences(course=0.5), ("gnss", "imu"), id="gyroscope and course alone"),
        pytest.param(differences(course=0.5, antenna=0.5), ("gnss", "imu"), id="both by GNSS"),
        pytest.param(differences(course=0.5, compass=0.0), ("gnss",), id="the magnetometer decides"),
        pytest.param(differences(wheels=0.5, course=-0.9), ("gnss", "imu", "odometer"), id="no single fault"),
    ],
)
def test_who_may_be_wrong(found: dict[Source, Difference], suspects: tuple[str, ...]) -> None:
    ballot = vote(found, COMMON, RATE)
    assert ballot is not None and ballot.statistic > ballot.threshold
    assert ballot.suspects == suspects


def test_the_magnetometer_accuses_nobody() -> None:
    assert vote(differences(compass=90.0), COMMON, RATE) is None
    ballot = vote(differences(wheels=0.0, compass=90.0), COMMON, RATE)
    assert ballot is not None and ballot.statistic < 1e-9


def test_who_is_acquitted_for_an_episode_is_so_at_a_smaller_rate_than_who_is_no_suspect_now() -> None:
    doubtful = {Source.WHEELS: Difference(3.8 * SD, SD**2), Source.COURSE: Difference(20.0 * SD, SD**2)}
    ballot = vote(doubtful, 1e-12, RATE)
    assert ballot is not None and ballot.suspects == ("gnss", "imu", "odometer") and ballot.acquitted == ()
    certain = vote(differences(wheels=0.5, course=0.5), COMMON, RATE)
    assert certain is not None and set(certain.acquitted) == {"gnss", "odometer"} and ACQUIT_RATE < 1e-3
