"""Key performance indicators of a drive: accuracy, availability, continuity, integrity, geometry, times.

A solution is available up to 2 s after its stamp; it is usable while it is available and the verdict is SAFE, CAUTION
or DEAD RECKONING. Shares of time are counted on a grid of 0.1 s from the first input to the last.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from shared.maths.earth import FloatArray
from shared.messages.gnss import CarrierSolution, GnssFix, GnssSatellites
from shared.messages.power import PowerState
from shared.messages.trust import TrustLevel

from ..solve.metrics.errors import Errors
from ..solve.metrics.gnss_alone import GnssAlone
from ..solve.metrics.integrity import AxisProtection, protected
from ..solve.track import Track
from ..solve.verdicts import Verdicts

NS = 1_000_000_000
GRID_NS = NS // 10
HOLD_TIME_NS = 2 * NS  # deadline of navigation/solution in shared/topics.py
FIX_HELD_NS = 2 * NS
LONGEST_POWER_STEP_S = 10.0  # [s] between two states of a supply, one of which comes every second
LEAST_CHARGE_USED = 0.02  # [-] below it the estimate of the charge is mostly noise of the voltage
CONTINUITY_S = 15.0  # exposure time of an approach (ICAO annex 10), commonly taken for vehicles too
USABLE = (TrustLevel.SAFE, TrustLevel.CAUTION, TrustLevel.DEAD_RECKONING)
Stamps = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
Value = float | int | None


@dataclass(frozen=True)
class Indicator:
    """One row: name, unit, group, and what it means."""

    name: str
    unit: str
    group: str
    meaning: str


MOMENTS = (("mean", "mean"), ("sigma", "standard deviation"))


def _axes(group: str, prefix: str, whose: str) -> list[Indicator]:
    return [
        *(Indicator(f"{prefix}_{axis}_rmse_m", "m", group, f"{whose}: {axis} error, root mean square")
          for axis in ("north", "east", "down")),
        Indicator(f"{prefix}_3d_rmse_m", "m", group, f"{whose}: error in space, root mean square"),
        Indicator(f"{prefix}_horizontal_p50_m", "m", group, f"{whose}: horizontal error, median (CEP)"),
        Indicator(f"{prefix}_horizontal_p95_m", "m", group, f"{whose}: horizontal error, 95th percentile"),
        Indicator(f"{prefix}_horizontal_max_m", "m", group, f"{whose}: horizontal error, maximum"),
        *(Indicator(f"{prefix}_{axis}_{name}_m", "m", group, f"{whose}: {axis} error, {meaning}")
          for axis in ("north", "east", "down") for name, meaning in MOMENTS),
    ]  # fmt: skip


INDICATORS = (
    Indicator("truth_count", "", "accuracy", "times at which the solution is compared with the truth"),
    *_axes("accuracy", "fused", "solution"),
    Indicator("fused_velocity_rmse_m_s", "m/s", "accuracy", "solution: magnitude of the velocity error, RMS"),
    *_axes("accuracy", "gnss", "receiver only, at the same times as its fixes"),
    Indicator("fused_over_gnss", "", "accuracy", "error in space of the solution over that of the receiver, at fixes"),
    Indicator("solution_available_share", "", "availability", "share of time with a solution at most 2 s old"),
    Indicator("usable_share", "", "availability", "share of time with a solution whose verdict allows its use"),
    Indicator("level_within_limit_share", "", "availability", "share of time with such a solution and both protection "
              "levels within their alert limits"),
    Indicator("fix_available_share", "", "availability", "share of time with a fix of the receiver at most 2 s old"),
    Indicator("rtk_fixed_share", "", "availability", "share of the fixes with integer ambiguities"),
    Indicator("rtk_float_share", "", "availability", "share of the fixes with float ambiguities"),
    Indicator("interruptions", "", "continuity", "times at which the solution ceased to be usable"),
    Indicator("longest_interruption_s", "s", "continuity", "longest time until it was usable again, or until the end"),
    Indicator("between_interruptions_s", "s", "continuity", "usable time over the number of interruptions"),
    Indicator("continuity_15s_share", "", "continuity", "share of the times that are usable and stay so for 15 s"),
    *(
        Indicator(f"{axis}_{name}", unit, "integrity", meaning.format(axis=axis))
        for axis in ("horizontal", "vertical")
        for name, unit, meaning in (
            ("level_median_m", "m", "{axis} protection level, median"),
            ("level_p95_m", "m", "{axis} protection level, 95th percentile"),
            ("within_level_share", "", "share of the {axis} errors within their protection level"),
            ("misleading_s", "s", "time with a {axis} error above its protection level"),
            ("misleading_while_usable_s", "s", "the same while the solution was usable"),
            ("hazardous_s", "s", "time with a {axis} error above the alert limit and a level within it"),
        )
    ),
    Indicator("hdop_median", "", "geometry", "horizontal dilution of precision, median of the fixes"),
    Indicator("hdop_p95", "", "geometry", "horizontal dilution of precision, 95th percentile"),
    Indicator("pdop_median", "", "geometry", "dilution of precision in space, median of the fixes"),
    Indicator("vdop_median", "", "geometry", "vertical dilution of precision, median of the fixes"),
    Indicator("gdop_median", "", "geometry", "geometric dilution of precision, median of the fixes"),
    Indicator("tdop_median", "", "geometry", "dilution of precision of time, median of the fixes"),
    *(Indicator(f"receiver_level_{axis}_{name}_m", "m", "geometry", f"{axis} protection level of the receiver itself "
                f"(UBX-NAV-PL), {meaning}")
      for axis in ("north", "east", "down") for name, meaning in MOMENTS),
    Indicator("time_accuracy_mean_s", "s", "geometry", "accuracy of its time, as the receiver states it, mean"),
    Indicator("satellites_tracked_mean", "", "geometry", "satellites with a carrier-to-noise density, mean of epochs"),
    Indicator("satellites_received_mean", "", "geometry", "satellites that the receiver lists, mean of epochs"),
    Indicator("satellites_used_median", "", "geometry", "satellites used by the receiver, median of the fixes"),
    Indicator("satellites_used_min", "", "geometry", "satellites used by the receiver, fewest of the fixes"),
    Indicator("cn0_median_db_hz", "dB-Hz", "geometry", "carrier-to-noise density of used satellites, median"),
    Indicator("duration_s", "s", "times", "from the first input to the last"),
    Indicator("time_to_first_fix_s", "s", "times", "from the first input to the first fix with a position"),
    Indicator("time_to_first_solution_s", "s", "times", "from the first input to the first solution"),
    Indicator("time_to_first_usable_s", "s", "times", "from the first input until the solution is usable"),
    Indicator("without_solution_s", "s", "times", "time without a solution at most 2 s old, behind the first one"),
    Indicator("longest_without_solution_s", "s", "times", "longest such time"),
    Indicator("without_fix_s", "s", "times", "time without a fix at most 2 s old, behind the first one"),
    Indicator("dead_reckoning_s", "s", "times", "time with the verdict DEAD RECKONING"),
    Indicator("unsafe_s", "s", "times", "time with the verdict UNSAFE"),
    Indicator("gnss_excluded_s", "s", "times", "time in which core.trust excluded GNSS"),
    Indicator("on_battery_s", "s", "power", "time on the battery of the supply"),
    Indicator("consumption_mean_w", "W", "power", "power drawn from the battery, mean of the time on it"),
    Indicator("autonomy_h", "h", "power", "time for which a full battery lasts, by the charge that was used in it"),
)  # fmt: skip


@dataclass(frozen=True)
class DriveObservations:
    """What a drive holds. Stamps in ns on the OBU time line."""

    first_ns: int
    last_ns: int
    track: Track  # valid solutions
    verdicts: Verdicts | None
    fixes: Sequence[GnssFix]  # with a position
    satellites: Sequence[GnssSatellites]
    power: Sequence[PowerState]
    errors: Errors | None
    gnss_alone: GnssAlone | None
    alert_limits_m: tuple[float, float]


def indicators_of(drive: DriveObservations) -> dict[str, Value]:
    """Compute every indicator.

    Parameters
    ----------
    drive : Observed
        One drive, as recorded or solved anew.

    Returns
    -------
    dict
        The names of `INDICATORS`, in their order; None if unknown.
    """
    grid = np.arange(drive.first_ns, drive.last_ns, GRID_NS, dtype=np.int64)
    available = _within(grid, drive.track.stamps_ns, HOLD_TIME_NS)
    usable = None if drive.verdicts is None else available & _allowed(drive.verdicts, grid)
    found: dict[str, Value] = {
        **_accuracy(drive),
        **_availability(drive, grid, available, usable),
        **({} if usable is None else _continuity(usable)),
        **_integrity(drive, usable, grid),
        **_geometry(drive),
        **_times(drive, grid, available, usable),
        **_power(drive.power),
    }
    return {row.name: _rounded(found.get(row.name)) for row in INDICATORS}


def _within(grid: Stamps, stamps: Stamps, held_ns: int) -> Mask:
    """Whether each time of the grid has a stamp at most so long before it."""
    if not len(stamps):
        return np.zeros(len(grid), dtype=bool)
    before = np.searchsorted(stamps, grid, side="right") - 1
    mask: Mask = (before >= 0) & (grid - stamps[np.maximum(before, 0)] <= held_ns)
    return mask


def _allowed(verdicts: Verdicts, grid: Stamps) -> Mask:
    return np.array([level in USABLE for level in verdicts.at(grid)], dtype=bool)


def _accuracy(drive: DriveObservations) -> dict[str, Value]:
    found: dict[str, Value] = {}
    errors = drive.errors
    if errors is not None and errors.position_n is not None and len(errors):
        found |= {"truth_count": len(errors), **_errors("fused", errors.position_n)}
    if errors is not None and errors.velocity_n is not None and len(errors):
        found["fused_velocity_rmse_m_s"] = _rms(np.linalg.norm(errors.velocity_n, axis=1))
    if drive.gnss_alone is not None and len(drive.gnss_alone):
        gnss, fused = drive.gnss_alone.gnss_n, drive.gnss_alone.solution_n
        found |= _errors("gnss", gnss)
        whole = np.isfinite(gnss).all(axis=1)
        if whole.any() and (of_gnss := _rms(np.linalg.norm(gnss[whole], axis=1))):
            found["fused_over_gnss"] = float(np.sqrt(np.mean(np.sum(fused[whole] ** 2, axis=1)))) / of_gnss
    return found


def _errors(prefix: str, error_n: FloatArray) -> dict[str, Value]:
    horizontal = np.hypot(error_n[:, 0], error_n[:, 1])
    whole = error_n[np.isfinite(error_n).all(axis=1)]
    names = ("north", "east", "down")
    return {
        **{f"{prefix}_{name}_rmse_m": _rms(error_n[:, axis]) for axis, name in enumerate(names)},
        **{f"{prefix}_{name}_mean_m": _mean(error_n[:, axis]) for axis, name in enumerate(names)},
        **{f"{prefix}_{name}_sigma_m": _sigma(error_n[:, axis]) for axis, name in enumerate(names)},
        f"{prefix}_3d_rmse_m": _rms(np.linalg.norm(whole, axis=1)),
        f"{prefix}_horizontal_p50_m": _quantile(horizontal, 0.5),
        f"{prefix}_horizontal_p95_m": _quantile(horizontal, 0.95),
        f"{prefix}_horizontal_max_m": _quantile(horizontal, 1.0),
    }


def _availability(drive: DriveObservations, grid: Stamps, available: Mask, usable: Mask | None) -> dict[str, Value]:
    found: dict[str, Value] = {
        "solution_available_share": _share(available),
        "usable_share": None if usable is None else _share(usable),
        "fix_available_share": _share(_within(grid, _stamps(drive.fixes), FIX_HELD_NS)),
    }
    levels = drive.track.columns("protection_level_horizontal_m", 2)
    if np.isfinite(levels).any():
        within = np.flatnonzero((levels <= drive.alert_limits_m).all(axis=1))  # NaN is not within
        row = np.searchsorted(drive.track.stamps_ns, grid, side="right") - 1
        found["level_within_limit_share"] = _share(available & np.isin(row, within))
    if drive.fixes:
        for kind, name in ((CarrierSolution.FIXED, "fixed"), (CarrierSolution.FLOAT, "float")):
            count = sum(fix.carrier_solution is kind for fix in drive.fixes)
            found[f"rtk_{name}_share"] = count / len(drive.fixes)
    return found


def _continuity(usable: Mask) -> dict[str, Value]:
    if not usable.any():
        return {}
    from_first = usable[int(np.argmax(usable)) :]
    lengths = _runs(~from_first)
    ahead = round(CONTINUITY_S * NS / GRID_NS)
    kept: Value = None
    if len(from_first) > ahead:
        lost = np.concatenate([[0], np.cumsum(~from_first)])
        starts = np.flatnonzero(from_first[:-ahead])
        kept = float(np.mean(lost[starts + ahead + 1] == lost[starts])) if len(starts) else None
    return {
        "interruptions": len(lengths),
        "longest_interruption_s": max(lengths, default=0) * GRID_NS / NS,
        "between_interruptions_s": float(from_first.sum()) * GRID_NS / NS / len(lengths) if lengths else None,
        "continuity_15s_share": kept,
    }


def _integrity(drive: DriveObservations, usable: Mask | None, grid: Stamps) -> dict[str, Value]:
    levels = drive.track.columns("protection_level_horizontal_m", 2)
    found: dict[str, Value] = {}
    for column, axis in enumerate(("horizontal", "vertical")):
        found[f"{axis}_level_median_m"] = _quantile(levels[:, column], 0.5)
        found[f"{axis}_level_p95_m"] = _quantile(levels[:, column], 0.95)
    if drive.errors is None or drive.errors.protection_m is None:
        return found
    known = np.isfinite(drive.errors.protection_m.sum(axis=1))
    stamps = drive.errors.stamps_ns[known]
    weights = _weights_s(stamps)
    for item in protected(drive.errors, drive.alert_limits_m):
        found |= _protected(item, weights, None if usable is None else _at(usable, grid, stamps))
    return found


def _protected(one: AxisProtection, weights_s: FloatArray, usable: Mask | None) -> dict[str, Value]:
    misled = one.error_m > one.level_m
    hazardous = misled & (one.level_m <= one.alert_limit_m) & (one.error_m > one.alert_limit_m)
    return {
        f"{one.axis}_within_level_share": _share(~misled),
        f"{one.axis}_misleading_s": float(weights_s[misled].sum()),
        f"{one.axis}_misleading_while_usable_s": None if usable is None else float(weights_s[misled & usable].sum()),
        f"{one.axis}_hazardous_s": float(weights_s[hazardous].sum()),
    }


def _weights_s(stamps: Stamps) -> FloatArray:
    """Time [s] for which each true state stands: until the next, at most `HOLD_TIME_NS`; the last as the median."""
    if len(stamps) < 2:
        return np.zeros(len(stamps))
    steps = np.minimum(np.diff(stamps), HOLD_TIME_NS)
    weights: FloatArray = np.append(steps, np.median(steps)) / NS
    return weights


def _at(mask: Mask, grid: Stamps, stamps: Stamps) -> Mask:
    if not len(grid):
        return np.zeros(len(stamps), dtype=bool)
    found: Mask = mask[np.clip(np.searchsorted(grid, stamps, side="right") - 1, 0, len(grid) - 1)]
    return found


def _geometry(drive: DriveObservations) -> dict[str, Value]:
    dops = {
        name: _known([getattr(fix, name) for fix in drive.fixes]) for name in ("hdop", "pdop", "vdop", "gdop", "tdop")
    }
    used = _known([fix.satellites_used for fix in drive.fixes])
    strengths = _known([
        satellite.cn0_db_hz for epoch in drive.satellites for satellite in epoch.satellites if satellite.used
    ])  # fmt: skip
    levels = np.array([fix.stated_level_ned_m for fix in drive.fixes if fix.stated_level_ned_m is not None])
    by_axis = zip(("north", "east", "down"), levels.reshape(-1, 3).T, strict=True)
    return {
        **{
            f"receiver_level_{axis}_{name}_m": of(values)
            for axis, values in by_axis
            for name, of in (("mean", _mean), ("sigma", _sigma))
        },
        "time_accuracy_mean_s": _mean(_known([fix.time_sd_s for fix in drive.fixes])),
        "satellites_tracked_mean": _mean(
            _known(
                [sum(satellite.cn0_db_hz is not None for satellite in epoch.satellites) for epoch in drive.satellites]
            )
        ),
        "satellites_received_mean": _mean(_known([len(epoch.satellites) for epoch in drive.satellites])),
        **{f"{name}_median": _quantile(values, 0.5) for name, values in dops.items()},
        "hdop_p95": _quantile(dops["hdop"], 0.95),
        "satellites_used_median": _quantile(used, 0.5),
        "satellites_used_min": _quantile(used, 0.0),
        "cn0_median_db_hz": _quantile(strengths, 0.5),
    }


def _times(drive: DriveObservations, grid: Stamps, available: Mask, usable: Mask | None) -> dict[str, Value]:
    fixes = _stamps(drive.fixes)
    gaps = _runs(~available[int(np.argmax(available)) :]) if available.any() else []
    fixed = _within(grid, fixes, FIX_HELD_NS)
    found: dict[str, Value] = {
        "duration_s": (drive.last_ns - drive.first_ns) / NS,
        "time_to_first_fix_s": max(int(fixes[0]) - drive.first_ns, 0) / NS if len(fixes) else None,
        "time_to_first_solution_s": (
            max(int(drive.track.stamps_ns[0]) - drive.first_ns, 0) / NS if len(drive.track) else None
        ),
        "time_to_first_usable_s": (
            float(np.argmax(usable)) * GRID_NS / NS if usable is not None and usable.any() else None
        ),
        "without_solution_s": sum(gaps) * GRID_NS / NS if available.any() else None,
        "longest_without_solution_s": max(gaps, default=0) * GRID_NS / NS if available.any() else None,
        "without_fix_s": (float((~fixed[int(np.argmax(fixed)) :]).sum()) * GRID_NS / NS if fixed.any() else None),
    }
    if drive.verdicts is not None:
        seconds: Mapping[TrustLevel, float] = drive.verdicts.seconds(drive.first_ns)
        found |= {
            "dead_reckoning_s": seconds[TrustLevel.DEAD_RECKONING],
            "unsafe_s": seconds[TrustLevel.UNSAFE],
            "gnss_excluded_s": drive.verdicts.excluded_s(),
        }
    return found


def _power(states: Sequence[PowerState]) -> dict[str, Value]:
    """Consumption and autonomy while the unit ran on its battery; the charge is estimated from the voltage."""
    span_s, energy_j, measured_s, used = 0.0, 0.0, 0.0, 0.0
    for before, after in pairwise(states):
        step_s = (after.sampled_ns - before.sampled_ns) / NS
        if not (before.on_battery and after.on_battery and 0.0 < step_s <= LONGEST_POWER_STEP_S):
            continue
        span_s += step_s
        if before.voltage_v is not None and before.current_a is not None and before.current_a < 0.0:
            energy_j += -before.voltage_v * before.current_a * step_s
            measured_s += step_s
        if before.charge_ratio is not None and after.charge_ratio is not None:
            used += before.charge_ratio - after.charge_ratio
    return {
        "on_battery_s": span_s if states else None,
        "consumption_mean_w": energy_j / measured_s if measured_s else None,
        "autonomy_h": span_s / used / 3600.0 if used > LEAST_CHARGE_USED else None,
    }


def _runs(mask: Mask) -> list[int]:
    """Lengths of the runs of true values."""
    steps = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    lengths: list[int] = (np.flatnonzero(steps == -1) - np.flatnonzero(steps == 1)).tolist()
    return lengths


def _stamps(fixes: Sequence[GnssFix]) -> Stamps:
    return np.unique(np.array([fix.sampled_ns for fix in fixes], dtype=np.int64))


def _known(values: Sequence[float | None]) -> FloatArray:
    return np.array([value for value in values if value is not None], dtype=float)


def _mean(values: FloatArray) -> float | None:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else None


def _sigma(values: FloatArray) -> float | None:
    finite = values[np.isfinite(values)]
    return float(finite.std()) if len(finite) else None


def _rms(values: FloatArray) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else None


def _quantile(values: FloatArray, share: float) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, share)) if len(finite) else None


def _share(mask: Mask) -> float | None:
    return float(mask.mean()) if len(mask) else None


def _rounded(value: Value) -> Value:
    return float(f"{value:.6g}") if isinstance(value, float) else value
