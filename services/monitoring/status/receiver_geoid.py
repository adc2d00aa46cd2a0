"""The geoid of the receiver, as a correction of the coarse grid: constant from one fix to the next that states it."""

from shared.maths.geoid.geoid import separation_m
from shared.messages.gnss import GnssFix

PLAUSIBLE_M = 30.0  # the grid is off by 24 m at most


def correction_m(fix: GnssFix) -> float | None:
    """Separation that a fix states less that of the grid there [m]; None of a fix without it, or that cannot be."""
    if fix.latitude_deg is None or fix.longitude_deg is None:
        return None
    if fix.height_ellipsoid_m is None or fix.height_msl_m is None:
        return None
    stated_m = fix.height_ellipsoid_m - fix.height_msl_m
    difference_m = stated_m - separation_m(fix.latitude_deg, fix.longitude_deg)
    return difference_m if abs(difference_m) <= PLAUSIBLE_M else None
