"""The mean of a rotation while it happens, from SciPy's matrix exponential: an oracle."""

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from shared.maths.rotation import skew


def mean_rotation(turn: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Mean of exp(s sk(a)) over s = 0..1, shape (3, 3): the upper right block of exp([[sk(a), I], [0, 0]])."""
    A = np.zeros((6, 6))
    A[:3, :3], A[:3, 3:] = skew(np.asarray(turn, dtype=np.float64)), np.eye(3)
    mean: npt.NDArray[np.float64] = expm(A)[:3, 3:]
    return mean
