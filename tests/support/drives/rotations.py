"""The mean of a rotation while it happens, from SciPy's matrix exponential: an oracle."""

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm


def mean_rotation(turn: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Mean of exp(s sk(a)) over s = 0..1, shape (..., 3, 3): the upper right block of exp([[sk(a), I], [0, 0]])."""
    turns = np.asarray(turn, dtype=np.float64)
    A = np.zeros((*turns.shape[:-1], 6, 6))
    A[..., :3, :3] = np.swapaxes(np.cross(turns[..., np.newaxis, :], np.eye(3)), -1, -2)  # columns: a x e_i
    A[..., :3, 3:] = np.eye(3)
    mean: npt.NDArray[np.float64] = expm(A)[..., :3, 3:]
    return mean
