"""Integrity metrics: position errors compared with their protection levels (Stanford diagram).

All times from `--score-from` on with a known truth are counted, outages included.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from shared.maths.earth import FloatArray
from shared.maths.quantiles import circle_factor, line_factor

from .errors import Errors

AXES = ("horizontal", "vertical")
# Quantiles of probability 0.001 of a normal error [standard deviations]: two-dimensional, one-dimensional.
REFERENCE_SDS = circle_factor(1.0, 1e-3), line_factor(1e-3)
# Names and meanings, for both axes.
_MEANINGS = {
    "median_m": "{axis} protection level, median",
    "available_fraction": "fraction of times with a {axis} protection level within the alert limit "
    "(`vehicle.alert_limit_{axis}_m`): availability",
    "judged_count": "number of times at which the {axis} error is compared with its protection level",
    "misleading_count": "number of times with a {axis} error above its protection level: misleading information",
    "misleading_fraction": "the same as a fraction; it should not exceed the integrity risk",
    "misleading_proven_fraction": "fraction of times with a {axis} error above its protection level by more than the "
    "error of the reference, taken as its quantile of probability 0.001",
    "hazardous_fraction": "fraction of times with a {axis} error above the alert limit and a protection level within "
    "it: hazardously misleading information",
    "ratio_median": "{axis} protection level over error, median: about 3 (horizontal) or 5 (vertical) for normal "
    "errors of known variance",
    "error_share_max": "largest ratio of {axis} error to protection level: above 1 for misleading information",
}
INTEGRITY: dict[str, str] = {
    f"protection_{axis}_{name}": meaning.format(axis=axis) for axis in AXES for name, meaning in _MEANINGS.items()
}


class Region(StrEnum):
    """Regions of the Stanford diagram."""

    NOMINAL = "nominal"
    UNAVAILABLE = "system unavailable"
    MISLEADING = "misleading"
    UNAVAILABLE_MISLEADING = "unavailable and misleading"
    HAZARDOUS = "hazardously misleading"


@dataclass(frozen=True)
class AxisProtection:
    """Error and protection level [m] of one axis at equal times."""

    axis: str
    error_m: FloatArray  # never negative, shape (n,)
    level_m: FloatArray  # shape (n,)
    alert_limit_m: float
    reference_error_m: FloatArray | float = 0.0  # bound of the reference's error

    @property
    def proven(self) -> npt.NDArray[np.bool_]:
        """Where the error exceeds the protection level even if the reference has its largest error.

        By the triangle inequality, ``|x - truth| >= |x - reference| - |reference - truth|``.
        """
        found: npt.NDArray[np.bool_] = self.error_m > self.level_m + self.reference_error_m
        return found

    def regions(self) -> dict[Region, int]:
        """Number of times in each region.

        Returns
        -------
        dict
            Every region, in the order of `Region`.

        References
        ----------
        M. Tossaint et al., "The Stanford - ESA integrity diagram: a new tool for the user domain SBAS integrity
        assessment", Navigation 54(2), 2007.
        """
        misled, available = self.error_m > self.level_m, self.level_m <= self.alert_limit_m
        beyond = self.error_m > self.alert_limit_m
        masks = {
            Region.NOMINAL: ~misled & available,
            Region.UNAVAILABLE: ~misled & ~available,
            Region.MISLEADING: misled & available & ~beyond,
            Region.UNAVAILABLE_MISLEADING: misled & ~available,
            Region.HAZARDOUS: misled & available & beyond,
        }
        return {region: int(mask.sum()) for region, mask in masks.items()}


def protected(errors: Errors, alert_limits_m: Sequence[float]) -> list[AxisProtection]:
    """Pair errors and protection levels, horizontal and vertical; empty if either is unknown."""
    if errors.position_n is None or errors.protection_m is None:
        return []
    known = np.flatnonzero(np.isfinite(errors.protection_m.sum(axis=1)))
    error, level = errors.position_n[known], errors.protection_m[known]
    if not len(error):
        return []
    sizes = (np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2]))
    sd = np.zeros_like(error) if errors.reference_sd_n is None else errors.reference_sd_n[known]
    reference_errors = (REFERENCE_SDS[0] * sd[:, :2].max(axis=1), REFERENCE_SDS[1] * sd[:, 2])
    return [
        AxisProtection(axis, size, level[:, k], alert_limits_m[k], reference_errors[k])
        for k, (axis, size) in enumerate(zip(AXES, sizes, strict=True))
    ]


def integrity_metrics(errors: Errors, alert_limits_m: Sequence[float]) -> dict[str, float | int | None]:
    """Compute the metrics of `INTEGRITY`; empty without truth or protection levels."""
    found: dict[str, float | int | None] = {}
    for item in protected(errors, alert_limits_m):
        regions, count = item.regions(), len(item.error_m)
        misled = int((item.error_m > item.level_m).sum())
        share = item.error_m / np.maximum(item.level_m, 1e-9)
        numbers: dict[str, float | int] = {
            "median_m": float(np.median(item.level_m)),
            "available_fraction": float(np.mean(item.level_m <= item.alert_limit_m)),
            "judged_count": count,
            "misleading_count": misled,
            "misleading_fraction": misled / count,
            "misleading_proven_fraction": float(item.proven.mean()),
            "hazardous_fraction": regions[Region.HAZARDOUS] / count,
            "ratio_median": float(1.0 / max(np.median(share), 1e-9)),
            "error_share_max": float(share.max()),
        }
        found |= {f"protection_{item.axis}_{name}": value for name, value in numbers.items()}
    return found
