import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cli.solve.metrics.mounting import without_mounting
from shared.maths.rotation import ned_from_body

MOUNTING = (0.02, 0.15, -0.06)


def drive(seed: int = 1) -> np.ndarray:
    """Attitudes of a car: small roll and pitch, every heading."""
    rng = np.random.default_rng(seed)
    return np.column_stack([*rng.normal(0.0, 0.05, (2, 500)), rng.uniform(-np.pi, np.pi, 500)])


def mounted(angles: np.ndarray) -> np.ndarray:
    return np.array(
        [Rotation.from_matrix(ned_from_body(*a) @ ned_from_body(*MOUNTING)).as_euler("ZYX")[::-1] for a in angles]
    )


def test_a_constant_mounting_is_estimated_and_removed() -> None:
    mounting, errors = without_mounting(mounted(drive()), drive())
    assert mounting == pytest.approx(MOUNTING, abs=1e-12)
    assert np.abs(errors).max() < 1e-12


def test_an_error_about_the_vertical_remains_a_heading_error() -> None:
    truth = drive()
    late = truth.copy()
    late[::2, 2] += 0.03
    late[1::2, 2] -= 0.03
    mounting, errors = without_mounting(mounted(late), truth)
    assert mounting == pytest.approx(MOUNTING, abs=5e-3)
    assert np.sqrt((errors[:, 2] ** 2).mean()) == pytest.approx(0.03, rel=1e-2)
    assert np.abs(errors[:, :2]).max() < 5e-3


def test_the_mounting_equals_the_mean_rotation_of_scipy() -> None:
    truth, rng = drive(), np.random.default_rng(2)
    solved = mounted(truth) + rng.normal(0.0, 0.05, (500, 3))
    as_rotation = [Rotation.from_matrix([ned_from_body(*a) for a in angles]) for angles in (truth, solved)]
    mean = (as_rotation[0].inv() * as_rotation[1]).mean().as_matrix()
    mounting, _ = without_mounting(solved, truth)
    assert mounting == pytest.approx(Rotation.from_matrix(mean).as_euler("ZYX")[::-1], abs=1e-9)
