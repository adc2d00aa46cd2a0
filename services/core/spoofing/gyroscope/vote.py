"""Which of several yaw rates is wrong: chi-square tests of the gyroscope's differences from all others at once."""

from collections.abc import Mapping
from enum import StrEnum
from typing import NamedTuple

from shared.maths.quantiles import chi_square_limit
from shared.trust.accused import GNSS, IMU, ODOMETER


class Source(StrEnum):
    """What measures a yaw rate beside the gyroscope."""

    WHEELS = "wheels"
    COURSE = "course"  # of the GNSS velocity
    ANTENNA = "second_antenna"
    COMPASS = "magnetometer"  # decides between others, and accuses nobody


OWNERS: Mapping[Source, str] = {Source.WHEELS: ODOMETER, Source.COURSE: GNSS, Source.ANTENNA: GNSS}
# Probability with which a right hypothesis is discarded: at 1e-3 one that is 3.3 standard deviations off.
DISCARD_RATE = 1e-3
# The same for the rest of an episode, in which the same sensor is wrong: 4.4 standard deviations, for an episode has
# some hundred evaluations.
ACQUIT_RATE = 1e-5


class Difference(NamedTuple):
    """Yaw rate of the gyroscope minus that of a source, with the variance of the source alone."""

    rate: float  # [rad/s]
    variance: float  # [rad²/s²]


class Vote(NamedTuple):
    """Statistic of all differences, its limit, and who may be wrong where it is exceeded."""

    statistic: float
    threshold: float
    suspects: tuple[str, ...]
    acquitted: tuple[str, ...]  # beyond reasonable doubt
    differences: Mapping[Source, Difference]

    def exceeds(self, false_alarm_rate: float) -> bool:
        """Whether the statistic is above what it exceeds by chance with a probability."""
        freedom = sum(source is not Source.COMPASS for source in self.differences)
        return self.statistic > chi_square_limit(freedom, false_alarm_rate)


def chi_square(differences: Mapping[Source, Difference], common: float) -> float:
    """Squared length of the differences against their covariance.

    Parameters
    ----------
    differences : mapping
        [rad/s] Of each source.
    common : float
        [rad²/s²] Variance of the gyroscope, which all differences share; infinite if it may be anything.

    Returns
    -------
    float
        [-] Chi-square with as many degrees of freedom as there are differences, one less for an infinite variance.

    Notes
    -----
    With C = diag(v) + c 1 1^T, by the identity of Sherman and Morrison::

        d^T C^-1 d = sum d²/v - (sum d/v)² / (1/c + sum 1/v)
    """
    if not differences:
        return 0.0
    weights = sum(1.0 / difference.variance for difference in differences.values())
    first = sum(difference.rate / difference.variance for difference in differences.values())
    second = sum(difference.rate**2 / difference.variance for difference in differences.values())
    return max(0.0, second - first**2 / (1.0 / common + weights))


def vote(differences: Mapping[Source, Difference], common: float, false_alarm_rate: float) -> Vote | None:
    """Test whether all yaw rates agree, and whose error would explain what does not.

    Parameters
    ----------
    differences : mapping
        [rad/s] Of each source, at least one beside the magnetometer.
    common : float
        [rad²/s²] Variance of the gyroscope's rate.
    false_alarm_rate : float
        [-] Probability of exceeding the threshold while nothing is wrong.

    Returns
    -------
    Vote or None
        None without a source that can accuse.

    Notes
    -----
    A sensor is a suspect if the yaw rates agree without it. With the gyroscope left out its error is a free parameter,
    common to all differences; with another left out the gyroscope counts with its own spread. If no single sensor
    explains the differences, all are suspects.
    """
    hard: dict[Source, Difference] = {
        source: difference for source, difference in differences.items() if source is not Source.COMPASS
    }
    if not hard:
        return None
    involved = [name for name in (GNSS, IMU, ODOMETER) if name == IMU or any(OWNERS[source] == name for source in hard)]
    suspects = tuple(name for name in involved if _explains(name, differences, common, DISCARD_RATE))
    acquitted = tuple(name for name in involved if not _explains(name, differences, common, ACQUIT_RATE))
    return Vote(
        chi_square(hard, common),
        chi_square_limit(len(hard), false_alarm_rate),
        suspects or tuple(involved),
        acquitted if suspects else (),
        differences,
    )


def _explains(name: str, differences: Mapping[Source, Difference], common: float, rate: float) -> bool:
    """Whether the yaw rates agree if this sensor is left out."""
    if name == IMU:
        freedom, statistic = len(differences) - 1, chi_square(differences, float("inf"))
    else:
        rest = {source: difference for source, difference in differences.items() if OWNERS.get(source) != name}
        freedom, statistic = len(rest), chi_square(rest, common)
    return freedom == 0 or statistic <= chi_square_limit(freedom, rate)
