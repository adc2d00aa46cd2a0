"""Result of one check of the set-up."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.messages.explanation import Explanation
from shared.messages.navigation import SetUpVerdict as Verdict

__all__ = ["Check", "Verdict", "matrix_text"]


@dataclass(frozen=True)
class Check:
    """What a check has found: unknown until the drive has shown enough."""

    name: str
    verdict: Verdict = Verdict.UNKNOWN
    why: Explanation | None = None
    statistic: float | None = None  # in `unit`
    sd: float | None = None
    expected: float | None = None
    limit: float | None = None  # of the difference
    unit: str = "-"
    setting: str | None = None  # to paste into the vehicle's file or the mapping of the import
    turn: tuple[float, float] | None = None  # [rad] of the vehicle's axes about the published axis down, and its 1 σ


def matrix_text(matrix: npt.NDArray[np.float64]) -> str:
    """Matrix as TOML, with four digits."""
    rows = ("[" + ", ".join(f"{value + 0.0:.4g}" for value in row) + "]" for row in np.round(matrix, 4).tolist())
    return "[" + ", ".join(rows) + "]"
