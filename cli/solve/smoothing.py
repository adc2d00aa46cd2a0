"""Track and metrics of the smoothed drive."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from services.core.fusion.inertial import error_model as em
from services.core.fusion.inertial.filter import ErrorStateFilter
from shared.maths.rotation import roll_pitch_yaw_of_quaternion

from .metrics.errors import errors_against
from .metrics.metrics import METRICS, Run, Value, metrics_of
from .reference_track import Reference
from .track import FRD, NAMES, NED, Track

PREFIX = "smoothed_"
KINDS = ("horizontal_", "vertical_", "velocity_", "roll_", "pitch_", "yaw_", "mounting_", "within_", "outage_")
INSIDE = {
    "outage_inside_median_m": "horizontal error within the outages, median",
    "outage_inside_max_m": "horizontal error within the outages, maximum",
}
# Metrics added by --smooth: the filter's errors within outages, and all error metrics of the smoothed drive.
SMOOTHED_METRICS: dict[str, str] = INSIDE | {
    PREFIX + name: f"`{name}` of the smoothed drive" for name in (*METRICS, *INSIDE) if name.startswith(KINDS)
}
STATE = (
    *("latitude_deg", "longitude_deg", "height_ellipsoid_m"),
    *(f"velocity_{axis}_m_s" for axis in NED),
    *("roll_rad", "pitch_rad", "yaw_rad"),
    *(f"position_sd_{axis}_m" for axis in NED),
    *(f"velocity_sd_{axis}_m_s" for axis in NED),
    *(f"attitude_sd_{axis}_rad" for axis in NED),
    *(f"angular_rate_{axis}_rad_s" for axis in FRD),
    *(f"accelerometer_bias_{axis}_m_s2" for axis in FRD),
    *(f"gyroscope_bias_{axis}_rad_s" for axis in FRD),
)
COPIED_FIELDS = ("stationary", "gnss_age_s")  # copied from the filtered track


def smoothed_track(newest_first: Iterable[ErrorStateFilter], filtered: Track) -> Track:
    """Collect smoothed states in a track.

    Parameters
    ----------
    newest_first : iterable of ErrorStateFilter
        Smoothed states, newest first.
    filtered : Track
        Valid part of the filtered track, source of phase, standstill and age of GNSS.

    Returns
    -------
    Track
        Stamps are those of the smoothed states; columns without a smoothed value are NaN.
    """
    stamps, rows = [], []
    for state in newest_first:
        stamps.append(state.inertial.time_ns)
        rows.append(_row(state))
    found, order = np.unique(np.array(stamps, dtype=np.int64), return_index=True)
    values = np.full((len(found), len(NAMES)), np.nan)
    values[:, [NAMES.index(name) for name in STATE]] = np.array(rows).reshape(-1, len(STATE))[order]
    nearest = np.clip(np.searchsorted(filtered.stamps_ns, found), 0, len(filtered) - 1)
    kept = [NAMES.index(name) for name in COPIED_FIELDS]
    values[:, kept] = filtered.values[nearest][:, kept]
    return Track(found, [filtered.phases[k] for k in nearest.tolist()], values)


def _row(state: ErrorStateFilter) -> list[float]:
    latitude, longitude, height = state.published_position
    variances = state.P.diagonal()
    sd = np.sqrt(np.concatenate([variances[part] for part in (em.POSITION, em.VELOCITY, em.ATTITUDE)]))
    return [
        *np.degrees([latitude, longitude]).tolist(),
        height,
        *state.inertial.velocity,
        *roll_pitch_yaw_of_quaternion(state.quaternion),
        *sd.tolist(),
        *state.rate,
        *state.imu.accelerometer_bias,
        *state.imu.gyroscope_bias,
    ]


def smoothed_run(run: Run, track: Track, reference: Reference | None, lever_arm_b: tuple[float, float, float]) -> Run:
    """Evaluate a smoothed track like the filtered one."""
    errors = errors_against(reference, track, lever_arm_b=lever_arm_b) if reference else None
    return replace(run, track=track, errors=errors)


def smoothed_metrics(filtered: Run, smoothed: Run) -> dict[str, Value]:
    """Compute the metrics of `SMOOTHED_METRICS`, in its order."""
    found = _inside(filtered) | {
        PREFIX + name: value for name, value in (metrics_of(smoothed) | _inside(smoothed)).items()
    }
    return {name: found[name] for name in SMOOTHED_METRICS}


def _inside(run: Run) -> dict[str, Value]:
    """Statistics of the errors at all times of the truth within outages."""
    errors = run.errors
    if errors is None or errors.position_n is None or not run.gaps:
        return dict.fromkeys(INSIDE)
    inside = np.zeros(len(errors), dtype=bool)
    for first, last in run.gaps:
        inside |= (errors.stamps_ns >= first) & (errors.stamps_ns < last)
    error = np.hypot(*errors.position_n[inside, :2].T)
    values = (float(np.median(error)), float(error.max())) if len(error) else (None, None)
    return {name: None if value is None else round(value, 6) for name, value in zip(INSIDE, values, strict=True)}
