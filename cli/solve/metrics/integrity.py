"""Whether errors stay below their protection levels: counts of what a Stanford diagram shows.

Every instant from `--score-from` on at which the truth is known counts, those in outages as well.
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
# Standard deviations by which a reference is off once in a thousand: of a normal pair, and of a number.
DOUBT_SDS = circle_factor(1.0, 1e-3), line_factor(1e-3)
# Names and meanings, for both axes.
_MEANINGS = {
    "median_m": "{axis} protection level, median",
    "available_fraction": "share of the instants whose {axis} protection level is within the alert limit "
    "(`core.fusion.integrity.alert_limit_{axis}_m`)",
    "judged_count": "instants at which the {axis} error is held against its protection level",
    "misleading_count": "instants with a {axis} error above its protection level: misleading information",
    "misleading_fraction": "the same as a share, which the integrity risk should not be below",
    "misleading_proven_fraction": "share of the instants with a {axis} error above its protection level by more than "
    "the reference itself may be off, by its own standard deviation, once in a thousand times",
    "hazardous_fraction": "share of the instants with an error above the alert limit while the protection level is "
    "within it: hazardously misleading information",
    "ratio_median": "{axis} protection level over error, median: near 3 (horizontal) or 5 (vertical) if all errors are "
    "normal and known",
    "error_share_max": "largest {axis} error over its protection level: above 1 it misled",
}
INTEGRITY: dict[str, str] = {
    f"protection_{axis}_{name}": meaning.format(axis=axis) for axis in AXES for name, meaning in _MEANINGS.items()
}


class Region(StrEnum):
    """Where an instant lies in the diagram of error against protection level."""

    NOMINAL = "nominal"
    UNAVAILABLE = "system unavailable"
    MISLEADING = "misleading"
    UNAVAILABLE_MISLEADING = "unavailable and misleading"
    HAZARDOUS = "hazardously misleading"


@dataclass(frozen=True)
class Protected:
    """Error and protection level [m] of one axis at the same instants."""

    axis: str
    error_m: FloatArray  # never negative, shape (n,)
    level_m: FloatArray  # shape (n,)
    alert_limit_m: float
    doubt_m: FloatArray | float = 0.0  # what of the error may be the reference's

    @property
    def proven(self) -> npt.NDArray[np.bool_]:
        """Where the solution misled whatever the reference's own error was.

        The true error is not less than the difference to a reference less the error of that, used by the filter or
        not: ``|x - truth| >= |x - reference| - |reference - truth|``.
        """
        found: npt.NDArray[np.bool_] = self.error_m > self.level_m + self.doubt_m
        return found

    def regions(self) -> dict[Region, int]:
        """Count the instants of each region.

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


def protected(errors: Errors, alert_limits_m: Sequence[float]) -> list[Protected]:
    """Put errors beside protection levels, horizontal and vertical; nothing where one of them is unknown."""
    if errors.position_n is None or errors.protection_m is None:
        return []
    known = np.flatnonzero(np.isfinite(errors.protection_m.sum(axis=1)))
    error, level = errors.position_n[known], errors.protection_m[known]
    if not len(error):
        return []
    sizes = (np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2]))
    sd = np.zeros_like(error) if errors.reference_sd_n is None else errors.reference_sd_n[known]
    doubts = (DOUBT_SDS[0] * sd[:, :2].max(axis=1), DOUBT_SDS[1] * sd[:, 2])
    return [
        Protected(axis, size, level[:, k], alert_limits_m[k], doubts[k])
        for k, (axis, size) in enumerate(zip(AXES, sizes, strict=True))
    ]


def integrity_metrics(errors: Errors, alert_limits_m: Sequence[float]) -> dict[str, float | int | None]:
    """Compute the metrics of `INTEGRITY`; none without truth or without levels."""
    found: dict[str, float | int | None] = {}
    for one in protected(errors, alert_limits_m):
        regions, count = one.regions(), len(one.error_m)
        misled = int((one.error_m > one.level_m).sum())
        share = one.error_m / np.maximum(one.level_m, 1e-9)
        numbers: dict[str, float | int] = {
            "median_m": float(np.median(one.level_m)),
            "available_fraction": float(np.mean(one.level_m <= one.alert_limit_m)),
            "judged_count": count,
            "misleading_count": misled,
            "misleading_fraction": misled / count,
            "misleading_proven_fraction": float(one.proven.mean()),
            "hazardous_fraction": regions[Region.HAZARDOUS] / count,
            "ratio_median": float(1.0 / max(np.median(share), 1e-9)),
            "error_share_max": float(share.max()),
        }
        found |= {f"protection_{one.axis}_{name}": value for name, value in numbers.items()}
    return found
