"""What core.trust made of a drive: seconds of each verdict, exclusions, and the harm they did."""

from dataclasses import dataclass, replace

import numpy as np

from shared.maths.earth import FloatArray, Geodetic, ned_track
from shared.messages.base import Vector3
from shared.messages.trust import TrustLevel
from shared.words.words import words

from ..attitude import rotations
from ..reference_track import Reference
from ..track import Track
from ..verdicts import Verdicts
from .errors import Stamps, errors_against

SETTLING_TIME_NS = 60_000_000_000  # from the first input on
WORDS = {level: words().name("state", level) for level in TrustLevel}
# A name with a dot is a key of an object in metrics.json.
TRUST: dict[str, str] = {
    **{f"trust_seconds.{level}": f"seconds with the verdict {word} of core.trust" for level, word in WORDS.items()},
    **{
        f"trust_seconds_after_60s.{level}": f"seconds with the verdict {word}, the first 60 s of the recording excluded"
        for level, word in WORDS.items()
    },
    "gnss_excluded_s": "seconds during which core.trust excluded GNSS",
    "errors_above_level_horizontal": "fraction of times with a horizontal error above the published protection level",
    "errors_above_level_vertical": "fraction of times with a vertical error above the published protection level",
    "harm_ratio": "horizontal error, root mean square, over that of a run without core.trust at the same times of the "
    "truth: above 1 the exclusions did harm. Where the solution is missing, the last one is held. 1 if nothing was "
    "excluded",
}


@dataclass(frozen=True)
class Trust:
    """The verdicts of a run, and the harm of its exclusions."""

    verdicts: Verdicts
    harm_ratio: float | None  # None without truth


def trust_metrics(trust: Trust, first_ns: int, above_level: tuple[float | None, float | None]) -> dict[str, float]:
    """Compute the metrics of `TRUST` that are known.

    Parameters
    ----------
    trust : Trust
        Of the run with core.trust.
    first_ns : int
        [ns] Arrival of the first input.
    above_level : tuple of float or None
        [-] Fraction of errors above the protection level, horizontal and vertical.
    """
    whole, settled = trust.verdicts.seconds(first_ns), trust.verdicts.seconds(first_ns + SETTLING_TIME_NS)
    found: dict[str, float | None] = {
        **{f"trust_seconds.{level}": seconds for level, seconds in whole.items()},
        **{f"trust_seconds_after_60s.{level}": seconds for level, seconds in settled.items()},
        "gnss_excluded_s": trust.verdicts.excluded_s(),
        "errors_above_level_horizontal": above_level[0],
        "errors_above_level_vertical": above_level[1],
        "harm_ratio": trust.harm_ratio,
    }
    return {name: value for name, value in found.items() if value is not None}


@dataclass(frozen=True)
class Harm:
    """Horizontal error [m], root mean square, with and without core.trust at the same times."""

    with_trust_m: float
    without_trust_m: float

    @property
    def ratio(self) -> float | None:
        """The first over the second; None where that is zero."""
        return self.with_trust_m / self.without_trust_m if self.without_trust_m > 0.0 else None


def harm_of(
    reference: Reference, with_trust: Track, without_trust: Track, *, lever_arm_b: Vector3, since_ns: int = 0
) -> Harm | None:
    """Compare the errors of two runs over one drive.

    Parameters
    ----------
    reference : Reference
        The truth.
    with_trust, without_trust : Track
        Solutions at the IMU while the filter navigates or coasts.
    lever_arm_b : tuple of float
        [m, body] Lever arm from the IMU to the antenna; used if the reference is at the antenna.
    since_ns : int, optional
        [ns] Earlier times are not counted.

    Returns
    -------
    Harm or None
        None without a common time.

    Notes
    -----
    The times are those of the truth at which the run without core.trust has a solution. Where the run with it has none,
    its last one counts, as held by a user who has no other: a run must not look better because it says nothing. Times
    before its first solution are not counted.
    """
    if reference.geodetic is None or not len(with_trust) or not len(without_trust):
        return None
    stamps, rows = np.unique(reference.stamps_ns, return_index=True)
    truth = replace(
        reference, stamps_ns=stamps, geodetic=reference.geodetic[rows], velocity_n=None, attitude=None,
        position_sd_n=None, velocity_delay_ns=0,
    )  # fmt: skip
    plain = errors_against(truth, without_trust, lever_arm_b=lever_arm_b)
    known = (plain.stamps_ns >= since_ns) & (plain.stamps_ns >= with_trust.stamps_ns[0])
    if plain.position_n is None or not known.any():
        return None
    common = plain.stamps_ns[known]
    found = _held(truth, with_trust, common, lever_arm_b)
    there = errors_against(truth, with_trust, lever_arm_b=lever_arm_b)
    if there.position_n is not None:
        _, of_common, of_there = np.intersect1d(common, there.stamps_ns, assume_unique=True, return_indices=True)
        found[of_common] = there.position_n[of_there]
    return Harm(_horizontal_rms(found), _horizontal_rms(plain.position_n[known]))


def _held(truth: Reference, track: Track, stamps_ns: Stamps, lever_arm_b: Vector3) -> FloatArray:
    """Last solution before each time minus the truth [m, NED], shape (n, 3)."""
    rows = np.searchsorted(track.stamps_ns, stamps_ns, side="right") - 1
    positions = np.asarray(truth.geodetic)[np.searchsorted(truth.stamps_ns, stamps_ns)]
    origin = Geodetic(*positions[len(positions) // 2].tolist())
    arm = np.array(lever_arm_b if truth.at_antenna else (0.0, 0.0, 0.0))
    turned = rotations(track.columns("roll_rad")[rows]).apply(arm)
    held: FloatArray = ned_track(track.geodetic[rows], origin) + turned - ned_track(positions, origin)
    return held


def _horizontal_rms(position_n: FloatArray) -> float:
    return float(np.sqrt(np.mean(position_n[:, 0] ** 2 + position_n[:, 1] ** 2)))
