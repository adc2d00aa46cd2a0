"""The metrics of a solved drive: stable names with units, None if unknown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.maths.earth import FloatArray, Geodetic, ned_track
from shared.messages.navigation import AidingKind, NavigationPhase

from ..outages import Gap
from ..track import Track
from .counters import Counters
from .drift import Drift, drifts, horizontal_error
from .errors import Errors
from .gnss_alone import GnssAlone
from .integrity import INTEGRITY, integrity_metrics
from .mounting import without_mounting
from .trust import TRUST, Trust, trust_metrics

Value = float | int | None
MAX_STEP_NS = 2_000_000_000  # between two solutions, above which there is none

GNSS_ALONE: dict[str, str] = {
    "gnss_alone_count": "fixes given to the filter that are compared with an independent truth, at the antenna",
    "gnss_alone_horizontal_rmse_m": "horizontal error of these fixes: receiver only, root mean square",
    "gnss_alone_vertical_rmse_m": "vertical error of these fixes, root mean square",
    "at_fixes_horizontal_rmse_m": "horizontal error of the solution at these fixes, root mean square",
    "gnss_alone_standstill_horizontal_rmse_m": "horizontal error of these fixes while standstill is detected",
    "at_fixes_vertical_rmse_m": "vertical error of the solution at these fixes, root mean square",
}
# Name and meaning of each metric, in the order of the files; docs/reference/metrics.md is printed from here.
METRICS: dict[str, str] = {
    "duration_s": "length of the recording, from its first input to its last",
    "alignment_s": "from the first input until the filter navigates",
    "solution_count": "solutions, of the filter or of fixes alone",
    "without_solution_s": "seconds without a solution after the first one: intervals of more than 2 s between two "
    "solutions, or between the last one and the end of the recording",
    "gnss_only_s": "seconds in which fixes alone are published, because inertial samples are missing",
    "distance_m": "distance travelled while there is a solution, standstill excluded",
    "fixes_recorded": "GNSS fixes with a position in the recording",
    "fixes_removed": "GNSS fixes removed by --outage",
    "fixes_used": "GNSS positions used by the filter",
    "fixes_rejected": "GNSS positions rejected by the innovation gate",
    "fixes_offered": "epochs of GNSS positions from the alignment on, those removed by --outage excluded",
    "fixes_used_fraction": "fraction of these that the filter used",
    "filter_resets": "number of filter resets",
    "innovation_horizontal_rms_m": "horizontal innovation of used GNSS positions, root mean square: the error of the "
    "prediction to the next fix",
    "innovation_velocity_rms_m_s": "horizontal innovation of used GNSS velocities, root mean square",
    "normalised_innovation_rms": "innovations of used GNSS positions over their standard deviation, root mean square: "
    "1 for a consistent filter, above 1 for an overconfident one",
    "truth_count": "number of times at which the solution is compared with the truth",
    "horizontal_rmse_m": "horizontal position error, root mean square",
    "horizontal_p95_m": "horizontal position error, 95th percentile",
    "horizontal_max_m": "horizontal position error, maximum",
    "vertical_rmse_m": "vertical position error, root mean square",
    "velocity_rmse_m_s": "magnitude of the velocity error, root mean square",
    "velocity_horizontal_rmse_m_s": "magnitude of the horizontal velocity error, root mean square",
    "roll_rmse_rad": "roll error, root mean square",
    "pitch_rmse_rad": "pitch error, root mean square",
    "yaw_rmse_rad": "heading error, root mean square",
    "yaw_mean_error_rad": "mean heading error, which includes a mounting angle between IMU and reference",
    "yaw_sd_rad": "standard deviation of the heading error about its mean, independent of a mounting angle",
    "mounting_roll_rad": "roll of the IMU axes relative to those of the reference, estimated as a constant rotation",
    "mounting_pitch_rad": "pitch of the same rotation",
    "mounting_yaw_rad": "yaw of the same rotation",
    "roll_rmse_mounted_rad": "roll error after removal of the mounting rotation, root mean square",
    "pitch_rmse_mounted_rad": "pitch error after removal of the mounting rotation, root mean square",
    "yaw_rmse_mounted_rad": "heading error after removal of the mounting rotation, root mean square",
    "standstill_horizontal_rmse_m": "horizontal position error while standstill is detected, root mean square: "
    "independent of the stamps of the truth",
    "within_3_sigma_fraction": "fraction of the position errors (north, east and down counted separately) within three "
    "standard deviations: 0.997 for a consistent filter",
    **GNSS_ALONE,
    "outage_count": "number of evaluated GNSS outages made by --outage",
    "outage_end_error_median_m": "horizontal error at the end of an outage (last truth), median of the outages",
    "outage_end_error_p95_m": "horizontal error at the end of an outage, 95th percentile",
    "outage_end_error_max_m": "horizontal error at the end of an outage, maximum",
    "outage_end_error_share_median": "horizontal error at the end of an outage over the distance travelled in it, "
    "median of the outages longer than 10 m",
    "outage_largest_error_rms_m": "largest horizontal error within an outage, root mean square of the outages",
    "outage_largest_error_max_m": "largest horizontal error within an outage, maximum",
    **INTEGRITY,
    **TRUST,
}
# Printed only, not written to a file: they differ from run to run.
TIMINGS: dict[str, str] = {
    "solve_seconds": "processing time of the whole recording",
    "realtime_factor": "duration of the recording over the processing time",
}


@dataclass(frozen=True)
class Run:
    """The results of one pass over a recording."""

    track: Track  # while the filter navigates
    counters: Counters
    errors: Errors | None
    gaps: Sequence[Gap]
    first_ns: int
    last_ns: int
    fixes_recorded: int
    fixes_removed: int
    scored_from_ns: int = 0  # errors before this time are excluded, except in outages
    alert_limits_m: tuple[float, float] = (10.0, 20.0)  # horizontal, vertical
    gnss_alone: GnssAlone | None = None
    trust: Trust | None = None  # None without core.trust
    utc_offset_ns: int = 0  # UTC less the unit's time line, as the fixes state it
    fixes_offered: int = 0  # epochs with a position from the alignment on

    def scored(self) -> Errors | None:
        """The errors that are evaluated."""
        return None if self.errors is None else self.errors.since(self.scored_from_ns)

    def drifts(self) -> list[Drift]:
        """The drift of each simulated outage."""
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
        The names of `METRICS`, in their order; None if unknown.
    """
    scored = run.scored()
    integrity = {} if scored is None else integrity_metrics(scored, run.alert_limits_m)
    found: dict[str, Value] = {
        "duration_s": (run.last_ns - run.first_ns) * 1e-9,
        "alignment_s": None if run.counters.aligned_ns is None else (run.counters.aligned_ns - run.first_ns) * 1e-9,
        "solution_count": len(run.track),
        "without_solution_s": _without_solution(run),
        "gnss_only_s": _gnss_only(run.track),
        "distance_m": _distance(run.track),
        "fixes_recorded": run.fixes_recorded,
        "fixes_removed": run.fixes_removed,
        "filter_resets": None if run.counters.state is None else run.counters.state.resets,
        **_innovations(run.counters, run.fixes_offered),
        **({} if scored is None else _against_truth(scored)),
        **_standstill(run, scored),
        **({} if run.gnss_alone is None else _gnss_alone(run.gnss_alone.since(run.scored_from_ns))),
        **integrity,
        **({} if run.trust is None else trust_metrics(run.trust, run.first_ns, _above_level(integrity))),
        **(_outages(run.drifts()) if run.gaps and run.errors and run.errors.position_n is not None else {}),
    }
    return {name: _rounded(found.get(name)) for name in METRICS}


def as_objects(metrics: Mapping[str, Value]) -> dict[str, Value | dict[str, Value]]:
    """Lay out metrics as in metrics.json: `a.b` is the key `b` of an object `a`, which is None if all of it is."""
    found: dict[str, Value | dict[str, Value]] = {}
    parts: dict[str, dict[str, Value]] = {}
    for name, value in metrics.items():
        first, _, second = name.partition(".")
        if second:
            parts.setdefault(first, {})[second] = value
            found[first] = parts[first]
        else:
            found[name] = value
    unknown = {first for first, part in parts.items() if not any(value is not None for value in part.values())}
    return {name: None if name in unknown else value for name, value in found.items()}


def _without_solution(run: Run) -> float | None:
    if not len(run.track):
        return None
    steps = np.diff(np.r_[run.track.stamps_ns, max(run.last_ns, int(run.track.stamps_ns[-1]))])
    return float(steps[steps > MAX_STEP_NS].sum() * 1e-9)


def _gnss_only(track: Track) -> float:
    """Time from each solution of fixes alone to the next solution; longer steps are without a solution."""
    steps = np.diff(track.stamps_ns)
    alone = np.array([phase is NavigationPhase.GNSS_ONLY for phase in track.phases[:-1]], dtype=bool)
    return float(steps[alone & (steps <= MAX_STEP_NS)].sum() * 1e-9)


def _above_level(integrity: Mapping[str, Value]) -> tuple[Value, Value]:
    """Fraction of the errors above their protection level, horizontal and vertical."""
    return (
        integrity.get("protection_horizontal_misleading_fraction"),
        integrity.get("protection_vertical_misleading_fraction"),
    )


def _innovations(counters: Counters, offered: int) -> dict[str, Value]:
    position, velocity = counters.updates(AidingKind.GNSS_POSITION), counters.updates(AidingKind.GNSS_VELOCITY)
    kept = position.innovation[position.used]
    normalised = kept / position.innovation_sd[position.used]
    used = int(position.used.sum())
    return {
        "fixes_used": used,
        "fixes_rejected": int((~position.used).sum()),
        "fixes_offered": offered,
        "fixes_used_fraction": min(1.0, used / offered) if offered else None,
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
        # Circular mean: that of -179 and 179 degrees is 180, not 0.
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


def _standstill(run: Run, scored: Errors | None) -> dict[str, Value]:
    """Errors while the vehicle stands, of the solution and of the receiver only."""
    flags = run.track.columns("stationary", 1)[:, 0]

    def still(stamps_ns: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        stands: npt.NDArray[np.bool_] = np.interp(stamps_ns, run.track.stamps_ns, flags) == 1.0
        return stands

    found: dict[str, Value] = {}
    if scored is not None and scored.position_n is not None:
        found["standstill_horizontal_rmse_m"] = _rms(horizontal_error(scored.position_n[still(scored.stamps_ns)]))
    if run.gnss_alone is not None:
        alone = run.gnss_alone.since(run.scored_from_ns)
        errors = horizontal_error(alone.gnss_n[still(alone.stamps_ns)])
        found["gnss_alone_standstill_horizontal_rmse_m"] = _rms(errors)
    return found


def _gnss_alone(found: GnssAlone) -> dict[str, Value]:
    known = ~np.isnan(found.gnss_n[:, 2])  # fixes with a height
    return {
        "gnss_alone_count": len(found),
        "gnss_alone_horizontal_rmse_m": _rms(horizontal_error(found.gnss_n)),
        "gnss_alone_vertical_rmse_m": _rms(found.gnss_n[known, 2]),
        "at_fixes_horizontal_rmse_m": _rms(horizontal_error(found.solution_n)),
        "at_fixes_vertical_rmse_m": _rms(found.solution_n[known, 2]),
    }


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
