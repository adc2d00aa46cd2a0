"""Allan deviation against allantools, and noise parameters against those that samples were made with."""

import numpy as np
import pytest

from cli.calibrate.allan import (
    FLICKER,
    MIN_CLUSTERS,
    FloatArray,
    allan_deviation,
    cluster_counts,
    gauss_markov_variance,
    noise_of,
)
from services.sensors.simulator.imu.imu_errors import SensorErrors, SensorGrade

STEP_S = 0.01


def made(density: float, bias: float, time_s: float, hours: float, seed: int = 1) -> FloatArray:
    """Samples of a standing sensor of the simulator, one axis."""
    grade = SensorGrade(density, bias, time_s, 0.0, 0.0)
    count = round(hours * 3600.0 / STEP_S)
    return SensorErrors(grade, STEP_S, (seed,)).advance(np.zeros(count, dtype=bool))[:, 0]


@pytest.mark.parametrize("samples", [500, 3001])
def test_deviations_are_those_of_allantools(samples: int) -> None:
    allantools = pytest.importorskip("allantools", reason="allantools is not installed: pip install allantools")
    values = np.random.default_rng(1).normal(3.0, 1.0, samples).cumsum() * 0.01 + 5.0
    counts = cluster_counts(samples)
    found = allan_deviation(values, STEP_S, counts)
    times, deviations, _, _ = allantools.oadev(values, rate=1.0 / STEP_S, data_type="freq", taus=found.times_s)
    assert np.allclose(times, found.times_s)
    assert np.allclose(found.deviation, deviations, rtol=1e-9)


def test_of_white_noise_the_deviation_falls_with_the_root_of_time() -> None:
    values = np.random.default_rng(2).normal(0.0, 2.0, 100_000)
    found = allan_deviation(values, 1.0, cluster_counts(len(values)))
    ratio = found.deviation * np.sqrt(found.times_s) / 2.0 - 1.0
    assert np.abs(ratio / found.relative_sd).max() < 4.0


def test_a_constant_has_no_deviation_and_large_offsets_cost_no_digits() -> None:
    noise = np.random.default_rng(3).normal(0.0, 1e-6, 10_000)
    counts = cluster_counts(len(noise))
    without = allan_deviation(noise, STEP_S, counts).deviation
    assert np.allclose(allan_deviation(noise + 9.81, STEP_S, counts).deviation, without, rtol=1e-4)
    assert allan_deviation(np.full(1000, 9.81), STEP_S, cluster_counts(1000)).deviation.max() < 1e-12


def test_clusters_end_at_a_ninth_of_the_samples() -> None:
    counts = cluster_counts(9000)
    assert counts[0] == 1 and counts[-1] == 9000 // MIN_CLUSTERS
    assert len(cluster_counts(MIN_CLUSTERS - 1)) == 0
    with pytest.raises(ValueError, match="need twice as many"):
        allan_deviation(np.zeros(10), 1.0, np.array([6]))


def test_the_variance_of_gauss_markov_has_the_limits_of_a_random_walk_and_of_white_noise() -> None:
    short, long = np.array([1e-5, 1e-4, 0.01]), np.array([1e3, 1e4])
    assert gauss_markov_variance(short, 1.0) == pytest.approx(2.0 * short / 3.0, rel=0.01)
    assert gauss_markov_variance(long, 1.0) == pytest.approx(2.0 / long, rel=2e-3)
    joined = gauss_markov_variance(np.array([0.999e-3, 1.001e-3]), 1.0)
    assert joined[1] / joined[0] == pytest.approx(1.001 / 0.999, rel=1e-3)


def test_the_parameters_of_a_simulated_sensor_are_found() -> None:
    """Two hours hold 360 correlation times of 20 s: the variance of the bias is known to about 8 %."""
    density, bias, time_s = 1e-4, 2e-4, 20.0
    values = made(density, bias, time_s, 2.0)
    noise = noise_of(allan_deviation(values, STEP_S, cluster_counts(len(values))))
    assert noise.random_walk == pytest.approx(density, rel=0.03)
    assert noise.bias_sd == pytest.approx(bias, rel=0.15)
    assert noise.correlation_s == pytest.approx(time_s, rel=0.3)
    assert noise.bias_psd == pytest.approx(2.0 * bias**2 / time_s, rel=0.3)
    # Where the falling white noise and the rising bias are equal: N / sqrt(t) and B sqrt(2 t / (3 T)).
    assert noise.minimum_seen
    assert 1.0 < noise.instability_time_s < 10.0
    crossing_s = np.sqrt(1.5 * density**2 * time_s / bias**2)
    assert noise.instability == pytest.approx(np.sqrt(2.0) * density / np.sqrt(crossing_s) / FLICKER, rel=0.15)


def test_of_white_noise_alone_no_bias_is_stated() -> None:
    values = made(1e-4, 0.0, 100.0, 0.2)
    noise = noise_of(allan_deviation(values, STEP_S, cluster_counts(len(values))))
    assert noise.random_walk == pytest.approx(1e-4, rel=0.05)
    assert noise.bias_sd is None and noise.bias_psd is None and noise.correlation_s is None


def test_a_silent_axis_has_no_noise() -> None:
    noise = noise_of(allan_deviation(np.zeros(1000), STEP_S, cluster_counts(1000)))
    assert (noise.random_walk, noise.bias_sd) == (0.0, None)
