"""What lever arm and delay of GNSS may be off by, as far as no check has measured it on this vehicle.

The covariance knows nothing of either: fixes of a few centimetres make it that small, though the antenna may be a metre
from where the settings have it, or each fix a car's length old. Neither shows in innovations on a straight road.
"""

from dataclasses import dataclass
from math import hypot
from typing import NamedTuple

from shared.runtime.config import GnssAntenna

from ..aids.gnss.settings import GnssSettings
from ..settings import Settings

ARM_SD_M = 0.35  # of a lever arm that was measured by hand: 3.3 of them hold one that is a metre off, and the filter
UNKNOWN_ARM_SD_M = 0.5  # of one that is not given: an antenna on the roof of a car, an IMU anywhere in it
DELAY_SD_S = 0.12  # of stamps at arrival: 3.3 of them hold 0.3 s, as of a serial line, and what the filter adds
KNOWN_DELAY_SD_S = 0.05  # of a delay that is given: checks know it to 0.02 to 0.08 s


class CheckDifference(NamedTuple):
    """Difference from the settings and its standard deviation, by a check."""

    error: float
    sd: float


@dataclass(frozen=True)
class SetUpSpread:
    """Standard deviations of the set-up, which the protection levels hold beside the covariance.

    Attributes
    ----------
    arm_horizontal_m, arm_vertical_m : float
        [m] Of the lever arm, on each horizontal axis and on the vertical one.
    delay_s : float
        [s] Of the delay of positions.
    """

    arm_horizontal_m: float = 0.0
    arm_vertical_m: float = 0.0
    delay_s: float = 0.0

    @classmethod
    def of(
        cls, settings: Settings, arm: CheckDifference | None = None, delay: CheckDifference | None = None
    ) -> "SetUpSpread":
        """Spread by the settings, or by a check where one has agreed.

        Parameters
        ----------
        settings : Settings
            Stated spreads, or lever arm and delay that are given or not.
        arm : Measured, optional
            [m] Lever arm on the ground, by the check; turns show nothing of its vertical part.
        delay : Measured, optional
            [s] Delay that is left, by the check.
        """
        arm_m, delay_s = assumed_arm_sd_m(settings.vehicle.gnss), assumed_delay_sd_s(settings.gnss)
        return cls(_replaced(arm_m, arm), arm_m, _replaced(delay_s, delay))


NO_SPREAD = SetUpSpread()


def assumed_arm_sd_m(antenna: GnssAntenna) -> float:
    """Standard deviation of the lever arm [m] on each axis before any check."""
    if antenna.lever_arm_sd_m is not None:
        return antenna.lever_arm_sd_m
    return ARM_SD_M if any(antenna.lever_arm_body_m) else UNKNOWN_ARM_SD_M


def assumed_delay_sd_s(gnss: GnssSettings) -> float:
    """Standard deviation of the delay of positions [s] before any check."""
    if gnss.delay_sd_s is not None:
        return gnss.delay_sd_s
    return KNOWN_DELAY_SD_S if gnss.delay_s else DELAY_SD_S


def _replaced(assumed: float, measured: CheckDifference | None) -> float:
    """Spread after a check: what it has seen and how well, which is no reason to assume more than before."""
    return assumed if measured is None else min(assumed, hypot(*measured))
