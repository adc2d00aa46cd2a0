from math import cos, log, pi, sin, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import chi2, norm

from shared.maths.quantiles import RATIOS, chi_square_limit, circle_factor, line_factor, principal_variances

RISKS = (1e-1, 1e-3, 1e-5, 1e-7)


@given(st.integers(1, 200), st.floats(1e-9, 0.999))
def test_the_limits_of_chi_square_are_its_quantiles(dimension: int, false_alarm: float) -> None:
    assert chi_square_limit(dimension, false_alarm) == pytest.approx(chi2.isf(false_alarm, dimension), rel=1e-9)


def outside_by_integration(radius: float, sd_major: float, sd_minor: float) -> float:
    """Integrate the density over chords: another way than that of the code."""

    def chord(angle: float) -> float:
        x, reach = radius * sin(angle), radius * cos(angle)
        return float(norm.pdf(x, scale=sd_major) * 2.0 * norm.sf(reach, scale=sd_minor) * reach)

    inside, _ = quad(chord, 0.0, pi / 2.0, epsabs=0.0, epsrel=1e-11, limit=400)
    return float(2.0 * inside + 2.0 * norm.sf(radius, scale=sd_major))


def test_the_limits_are_rayleigh_and_normal() -> None:
    for risk in RISKS:
        assert circle_factor(1.0, risk) == pytest.approx(sqrt(-2.0 * log(risk)), rel=1e-12)
        assert circle_factor(0.0, risk) == pytest.approx(norm.isf(risk / 2.0), rel=1e-12)
        assert line_factor(risk) == pytest.approx(norm.isf(risk / 2.0), rel=1e-12)


@pytest.mark.parametrize("risk", RISKS)
def test_between_the_limits_the_factor_is_exact_to_its_tolerance(risk: float) -> None:
    for ratio in np.linspace(0.03, 0.99, 25).tolist():
        factor = circle_factor(ratio, risk)
        assert outside_by_integration(factor, 1.0, ratio) <= risk * (1.0 + 1e-5), "never too little"
        assert outside_by_integration(factor - 3e-3, 1.0, ratio) >= risk


@pytest.mark.parametrize("risk", [0.9, *RISKS, 1e-9])
def test_at_the_nodes_of_the_table_the_risk_is_met(risk: float) -> None:
    for ratio in RATIOS[1:-1:4].tolist():  # the midpoints of an ellipse of 1 to 32 are exact to a millionth
        found = outside_by_integration(circle_factor(ratio, risk), 1.0, ratio)
        assert found == pytest.approx(risk, rel=2e-6)


def test_at_a_risk_of_one_the_factor_is_zero() -> None:
    assert line_factor(1.0) == circle_factor(0.5, 1.0) == 0.0


@pytest.mark.parametrize("seed", range(5))
def test_the_principal_variances_are_the_eigenvalues(seed: int) -> None:
    A = np.random.default_rng(seed).standard_normal((2, 2))
    (nn, ne), (_, ee) = (A @ A.T).tolist()
    assert principal_variances(nn, ne, ee) == pytest.approx(np.linalg.eigvalsh(A @ A.T)[::-1].tolist())
