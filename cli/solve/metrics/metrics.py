"""The figures that a solved drive is judged by: stable names, units in the names, None where unknown."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.maths.earth import FloatArray, Geodetic, ned_track
from shared.messages.navigation import AidingKind

from ..outages import Gap
from ..track import Track
from .counters import Tally
from .drift import Drift, drifts, horizontal_error
from .errors import Errors
from .integrity import INTEGRITY, integrity_metrics
from .mounting import without_mounting

Value = float | int | None

# Name and meaning of each metric, in the order of the files; docs/reference/metrics.md is printed from here.
METRICS: dict[str, str] = {
    "duration_s": "length of the recording, from its first input to its last",
    "alignment_s": "from the first input until the filter navigates",
    "solution_count": "solutions while the filter navigates or coasts",
    "distance_m": "way travelled while the filter navigates or coasts, standstill left out",
    "fixes_recorded": "GNSS fixes of the recording that hold a position",
    "fixes_removed": "fixes that were taken away by --outage",
    "fixes_used": "GNSS positions that the filter used",
    "fixes_rejected": "GNSS positions that the filter's gate rejected",
    "filter_resets": "times that the filter had to begin anew",
    "innovation_horizontal_rms_m": "horizontal difference of a used GNSS position and its prediction: the error of "
    "predicting one fix ahead, which no fix has corrected yet",
    "innovation_velocity_rms_m_s": "the same for the horizontal GNSS velocity",
    "normalised_innovation_rms": "innovations of used GNSS positions over their standard deviation: 1 if the filter "
    "knows its errors, above 1 if it is too sure",
    "truth_count": "instants at which the solution is compared with the truth",
    "horizontal_rmse_m": "horizontal position error, root mean square",
    "horizontal_p95_m": "horizontal position error that 95 % of the instants stay below",
    "horizontal_max_m": "largest horizontal position error",
    "vertical_rmse_m": "vertical position error, root mean square",
    "velocity_rmse_m_s": "error of the velocity vector, root mean square of its length",
    "velocity_horizontal_rmse_m_s": "error of the horizontal velocity, root mean square of its length",
    "roll_rmse_rad": "error of the roll, root mean square",
    "pitch_rmse_rad": "error of the pitch, root mean square",
    "yaw_rmse_rad": "error of the heading, root mean square",
    "yaw_mean_error_rad": "mean error of the heading; a mounting angle between IMU and reference shows here",
    "yaw_sd_rad": "error of the heading about its mean: what is left once a mounting angle is removed",
    "mounting_roll_rad": "roll of the IMU's axes in those of the reference, as one constant rotation of the drive",
    "mounting_pitch_rad": "the same, pitch",
    "mounting_yaw_rad": "the same, yaw",
    "roll_rmse_mounted_rad": "error of the roll once that constant rotation is removed, root mean square",
    "pitch_rmse_mounted_rad": "the same, pitch",
    "yaw_rmse_mounted_rad": "the same, heading",
    "within_3_sigma_fraction": "share of the position errors (north, east and down counted one by one) within three "
    "of their standard deviations: 0.997 if the filter knows its errors",
    "outage_count": "GNSS outages made by --outage that could be judged",
    "outage_end_error_median_m": "horizontal error at the last truth before GNSS comes back, median of the outages",
    "outage_end_error_p95_m": "the same, 95th percentile",
    "outage_end_error_max_m": "the same, the worst",
    "outage_end_error_share_median": "horizontal error at the end over the distance that was driven in the outage, "
    "median of the outages that are longer than 10 m",
    "outage_largest_error_rms_m": "largest horizontal error within each outage, root mean square of the outages",
    "outage_largest_error_max_m": "the same, the worst",
    **INTEGRITY,
}
# Printed, but in no file: they differ from run to run.
TIMINGS: dict[str, str] = {
    "solve_seconds": "time that the processes took for the whole recording",
    "realtime_factor": "seconds of driving that were worked off in one second",
}


@dataclass(frozen=True)
class Run:
    """All that came out of one pass over a recording."""

    track: Track  # while the filter navigates
    tally: Tally
    errors: Errors | None
    gaps: Sequence[Gap]
    first_ns: int
    last_ns: int
    fixes_recorded: int
    fixes_removed: int
    scored_from_ns: int = 0  # errors before this instant are in no mean and no count, but in outages
    alert_limits_m: tuple[float, float] = (10.0, 20.0)  # horizontal, vertical

    def scored(self) -> Errors | None:
        """Errors that are judged."""
        return None if self.errors is None else self.errors.since(self.scored_from_ns)

    def drifts(self) -> list[Drift]:
        """Judge the outages that were made."""
        return [] if self.errors is None else drifts(self.errors, self.gaps)


def metrics_of(run: Run) -> dict[str, Value]:
    """Compute every metric.

    Parameters
    ----------
    run : Run
        One pass over a recording.

    Returns
    -------
    dict
        The names of `METRICS`, in their order; None for what cannot be known.
    """
    scored = run.scored()
    found: dict[str, Value] = {
        "duration_s": (run.last_ns - run.first_ns) * 1e-9,
        "alignment_s": None if run.tally.aligned_ns is None else (run.tally.aligned_ns - run.first_ns) * 1e-9,
        "solution_count": len(run.track),
        "distance_m": _distance(run.track),
        "fixes_recorded": run.fixes_recorded,
        "fixes_removed": run.fixes_removed,
        "filter_resets": None if run.tally.state is None else run.tally.state.resets,
        **_innovations(run.tally),
        **({} if scored is None else _against_truth(scored)),
        **({} if scored is None else integrity_metrics(scored, run.alert_limits_m)),
        **(_outages(run.drifts()) if run.gaps and run.errors and run.errors.position_n is not None else {}),
    }
    return {name: _rounded(found.get(name)) for name in METRICS}


def _innovations(tally: Tally) -> dict[str, Value]:
    position, velocity = tally.updates(AidingKind.GNSS_POSITION), tally.updates(AidingKind.GNSS_VELOCITY)
    kept = position.innovation[position.used]
    normalised = kept / position.innovation_sd[position.used]
    return {
        "fixes_used": int(position.used.sum()),
        "fixes_rejected": int((~position.used).sum()),
        "innovation_horizontal_rms_m": _rms(np.hypot(kept[:, 0], kept[:, 1])),
        "innovation_velocity_rms_m_s": _rms(np.hypot(*velocity.innovation[velocity.used, :2].T)),
        "normalised_innovation_rms": _rms(normalised.ravel()),
    }


def _against_truth(errors: Errors) -> dict[str, Value]:
    found: dict[str, Value] = {"truth_count": len(errors)}
    if errors.position_n is not None:
        horizontal = horizontal_error(errors.position_n)
        found |= {
            "horizontal_rmse_m": _rms(horizontal),
            "horizontal_p95_m": _quantile(horizontal, 0.95),
            "horizontal_max_m": _quantile(horizontal, 1.0),
            "vertical_rmse_m": _rms(errors.position_n[:, 2]),
            "within_3_sigma_fraction": _share(np.abs(errors.position_n) <= 3.0 * errors.position_sd_n),
        }
    if errors.velocity_n is not None:
        found["velocity_rmse_m_s"] = _rms(np.linalg.norm(errors.velocity_n, axis=1))
        found["velocity_horizontal_rmse_m_s"] = _rms(horizontal_error(errors.velocity_n))
    if errors.attitude is not None and len(errors):
        roll, pitch, yaw = errors.attitude.T
        # The mean of angles is that of their directions: -179 and 179 degrees make 180, not 0.
        mean = float(np.angle(np.mean(np.exp(1j * yaw))))
        about_mean = np.angle(np.exp(1j * (yaw - mean)))
        found |= {
            "roll_rmse_rad": _rms(roll),
            "pitch_rmse_rad": _rms(pitch),
            "yaw_rmse_rad": _rms(yaw),
            "yaw_mean_error_rad": mean,
            "yaw_sd_rad": _rms(about_mean),
            **_mounted(errors),
        }
    return found


def _mounted(errors: Errors) -> dict[str, Value]:
    if errors.attitude is None or errors.angles is None:
        return {}
    mounting, left = without_mounting(errors.angles, errors.angles - errors.attitude)
    axes = ("roll", "pitch", "yaw")
    return {
        **{f"mounting_{axis}_rad": float(angle) for axis, angle in zip(axes, mounting, strict=True)},
        **{f"{axis}_rmse_mounted_rad": _rms(column) for axis, column in zip(axes, left.T, strict=True)},
    }


def _outages(found: Sequence[Drift]) -> dict[str, Value]:
    ends, largest = np.array([drift.end_m for drift in found]), np.array([drift.largest_m for drift in found])
    shares = np.array([drift.end_share for drift in found if drift.end_share is not None])
    return {
        "outage_count": len(found),
        "outage_end_error_median_m": _quantile(ends, 0.5),
        "outage_end_error_p95_m": _quantile(ends, 0.95),
        "outage_end_error_max_m": _quantile(ends, 1.0),
        "outage_end_error_share_median": _quantile(shares, 0.5),
        "outage_largest_error_rms_m": _rms(largest),
        "outage_largest_error_max_m": _quantile(largest, 1.0),
    }


def _distance(track: Track) -> float | None:
    moving = track.columns("stationary", 1)[:, 0] < 0.5
    if len(track) < 2:
        return None
    path = ned_track(track.geodetic, Geodetic(*track.geodetic[0].tolist()))
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    return float(steps[moving[1:]].sum())


def _rms(values: FloatArray) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else None


def _share(holds: npt.NDArray[np.bool_]) -> float | None:
    return float(np.mean(holds)) if holds.size else None


def _quantile(values: FloatArray, share: float) -> float | None:
    return float(np.quantile(values, share)) if len(values) else None


def _rounded(value: Value) -> Value:
    return round(value, 6) if isinstance(value, float) else value
