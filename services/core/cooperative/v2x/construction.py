"""The paper's construction on one epoch: virtual satellites are chosen, and the residuals tested through them."""

from dataclasses import dataclass

import numpy as np

from ..measurements import FloatArray
from .bank import BankTest, Pseudoranges
from .forward import CLOCK, POSITION
from .virtual import choose_virtual, horizontal_protection_level, prediction_matrix, residual_cov, residual_test


@dataclass(frozen=True)
class Construction:
    """The test through the virtual satellites that were chosen, and the protection level with them."""

    test: BankTest
    hpl_m: float  # bias only; above the alert limit where no choice of virtual satellites is within it


def construction_test(
    x: FloatArray,
    ranges: Pseudoranges,
    candidates: Pseudoranges,
    *,
    false_alarm_rate: float,
    missed_detection_rate: float,
    alert_limit_m: float,
) -> Construction | None:
    """Test the visible satellites against a forward estimate.

    Parameters
    ----------
    x : ndarray, shape (size,)
        State of the forward filter; the virtual pseudoranges are computed from it, noise-free.
    ranges : Pseudoranges
        Of the real satellites.
    candidates : Pseudoranges
        Directions and clocks of satellites that may serve as virtual ones; their y is not used.
    false_alarm_rate, missed_detection_rate : float
        [-] P_FA, P_MD.
    alert_limit_m : float
        [m] HAL: where the protection level exceeds it, other virtual satellites are chosen.

    Returns
    -------
    Construction or None
        With n real and u = 3 + c virtual satellites; None where the candidates do not determine position and clocks.
    """
    size = len(x)
    seen = np.flatnonzero(ranges.visible)
    clocks = sorted({CLOCK + ranges.clock[row] for row in seen.tolist()})
    columns = [*range(POSITION.start, POSITION.stop), *clocks]
    usable = [row for row, clock in enumerate(candidates.clock) if CLOCK + clock in clocks]
    rows = ranges.rows(size)
    H_real, H_virtual = rows[seen][:, columns], candidates.rows(size)[usable][:, columns]
    sd = np.hypot(ranges.sd, ranges.correlated_sd)[seen]

    def level(H_chosen: FloatArray) -> float:
        H = np.vstack([H_chosen, H_real])
        real = range(len(H_chosen), len(H))
        return horizontal_protection_level(
            H, real, float(np.median(sd)), false_alarm_rate=false_alarm_rate,
            missed_detection_rate=missed_detection_rate,
        )  # fmt: skip

    chosen = choose_virtual(H_real, H_virtual, count=len(columns), level=level, limit=alert_limit_m)
    if chosen is None:
        return None
    omega = prediction_matrix(H_real, H_virtual[list(chosen)])
    W = residual_cov(omega, sd, np.full(len(chosen), float(np.median(sd))))
    innovation = ranges.y - rows @ x
    test = residual_test(innovation[seen], W, false_alarm_rate)
    t, excluded = np.zeros(len(ranges.sd)), np.zeros(len(ranges.sd), dtype=np.bool_)
    t[seen], excluded[seen] = test.t, test.excluded
    return Construction(BankTest(innovation, t, t, test.local, excluded, excluded), level(H_virtual[list(chosen)]))
