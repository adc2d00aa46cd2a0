"""Track width and ratio of the wheels: convergence, consistency of their spread, and wheels that slip."""

import numpy as np
import pytest

from services.core.spoofing.gyroscope.axle import SLIP_SHARE, TRACK_M, TRACK_SD_M, Axle, AxleRate, AxleSecond, combined

NOISE = 0.008  # [m/s] of a second


def driven(rng: np.random.Generator, track_m: float, ratio: float, *, seconds: int = 300, slips: float = 0.0) -> Axle:
    """Axle that has learned over a drive in which every fifth second is in a bend."""
    axle = Axle()
    for k in range(seconds):
        w = float(rng.normal(0.0, 0.3 if k % 5 == 0 else 0.003))
        v = float(rng.uniform(5.0, 25.0))
        slip = 1.0 if rng.random() < slips else 0.0
        share = 1.0 + SLIP_SHARE * float(rng.normal())
        axle.learn(AxleSecond(track_m * w * share + ratio * v + NOISE * float(rng.normal()) + slip, v), w)
    return axle


def test_track_width_ratio_and_noise_are_learned() -> None:
    axle = driven(np.random.default_rng(1), 1.47, 0.0031)
    assert axle.track_m == pytest.approx(1.47, abs=0.05)
    assert axle.ratio == pytest.approx(0.0031, abs=1e-4)
    assert axle.noise == pytest.approx(NOISE, rel=0.4)


def test_their_errors_are_those_that_the_spread_states() -> None:
    squares = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        track, ratio = TRACK_M + TRACK_SD_M * float(rng.normal()), 0.01 * float(rng.normal())
        axle = driven(rng, track, ratio, seconds=120)
        sds = axle.sds
        squares.append([((axle.track_m - track) / sds[0]) ** 2, ((axle.ratio - ratio) / sds[1]) ** 2])
    mean = np.mean(squares, axis=0)
    assert (mean > 0.2).all() and (mean < 2.0).all(), mean


def test_wheels_that_spin_for_a_second_in_fifty_do_not_mislead_it() -> None:
    axle = driven(np.random.default_rng(2), 1.6, 0.002, slips=0.02)
    assert axle.ratio == pytest.approx(0.002, abs=5e-4)


def test_the_yaw_rate_is_right_with_what_was_learned_and_uncertain_before() -> None:
    rng = np.random.default_rng(3)
    second = AxleSecond(1.47 * 0.2 + 0.0031 * 10.0, 10.0)
    assert Axle().rate(second).learned ** 0.5 > 0.06, "1 % of 10 m/s over 1.6 m"
    known = driven(rng, 1.47, 0.0031).rate(second)
    assert known.rate == pytest.approx(0.2, rel=0.03) and known.learned**0.5 < 0.2 * 0.05


def test_two_axles_are_weighted_by_their_variances_and_slip_is_common() -> None:
    first, second = AxleRate(0.10, 4e-4, 1e-6), AxleRate(0.12, 1e-4, 3e-6)
    rate, variance = combined([(first, 10), (second, 20)], [0.0, 0.0])
    a, b = 1.0 / (4e-5 + 1e-6), 1.0 / (5e-6 + 3e-6)
    assert rate == pytest.approx((a * 0.10 + b * 0.12) / (a + b)) and variance == pytest.approx(1.0 / (a + b))
    bends = [0.3, 0.3, -0.3, -0.3]
    assert combined([(first, 10)], bends)[1] == pytest.approx(4.1e-5 + SLIP_SHARE**2 * 0.09 / 4)
    assert combined([(first, 10)], [0.3] * 4)[1] == pytest.approx(4.1e-5 + SLIP_SHARE**2 * 0.09 * 1.25)
