"""The paper's construction on one epoch: virtual satellites are chosen, and the residuals tested through them."""

import numpy as np

from ..measurements import FloatArray
from .bank import BankTest, Pseudoranges
from .forward import CLOCK, POSITION
from .virtual import choose_virtual, prediction_matrix, residual_cov, residual_test


def construction_test(
    x: FloatArray, ranges: Pseudoranges, candidates: Pseudoranges, false_alarm_rate: float
) -> BankTest | None:
    """Test the visible satellites against a forward estimate.

    Parameters
    ----------
    x : ndarray, shape (size,)
        State of the forward filter; the virtual pseudoranges are computed from it, noise-free.
    ranges : Pseudoranges
        Of the real satellites.
    candidates : Pseudoranges
        Directions and clocks of satellites that may serve as virtual ones; their y is not used.
    false_alarm_rate : float
        [-] P_FA.

    Returns
    -------
    BankTest or None
        With n real and u = 3 + c virtual satellites; None where the candidates do not determine position and clocks.
    """
    size = len(x)
    seen = np.flatnonzero(ranges.visible)
    clocks = sorted({CLOCK + ranges.clock[row] for row in seen.tolist()})
    columns = [*range(POSITION.start, POSITION.stop), *clocks]
    usable = [row for row, clock in enumerate(candidates.clock) if CLOCK + clock in clocks]
    rows = ranges.rows(size)
    H_real, H_virtual = rows[seen][:, columns], candidates.rows(size)[usable][:, columns]
    chosen = choose_virtual(H_real, H_virtual, count=len(columns))
    if chosen is None:
        return None
    sd = np.hypot(ranges.sd, ranges.correlated_sd)[seen]
    omega = prediction_matrix(H_real, H_virtual[list(chosen)])
    W = residual_cov(omega, sd, np.full(len(chosen), float(np.median(sd))))
    innovation = ranges.y - rows @ x
    test = residual_test(innovation[seen], W, false_alarm_rate)
    t, excluded = np.zeros(len(ranges.sd)), np.zeros(len(ranges.sd), dtype=np.bool_)
    t[seen], excluded[seen] = test.t, test.excluded
    return BankTest(innovation, t, t, test.local, excluded, excluded)
