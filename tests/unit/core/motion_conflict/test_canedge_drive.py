"""A real drive of 39 minutes with OBD-II speed (2 Hz, 1 km/h) and a CAN GNSS receiver (1 Hz): nothing to accuse.

The receiver reports speed 0 with SpeedValid = 0 for the first 106 s, in which the car reaches 46 km/h.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import pytest

from services.core.motion_conflict.monitor import MotionMonitor
from services.core.motion_conflict.tachograph import KM_H
from tests.support.data import recording

pytestmark = pytest.mark.recording
FloatArray = npt.NDArray[np.float64]
Change = Callable[[float, float], float]


@dataclass
class Result:
    """Largest statistic, and first time [s] of an accusation, by test."""

    monitor: MotionMonitor
    largest: dict[str, float] = field(default_factory=dict)
    first_s: dict[str, float] = field(default_factory=dict)


def table(name: str) -> FloatArray:
    return np.loadtxt(recording(f"canedge_obd_gnss/drive164/{name}"), delimiter=",", skiprows=1)


def drive(*, invalid_too: bool = False, gnss: Change | None = None, odometer: Change | None = None) -> Result:
    speeds, obd, positions = table("gnss_speed.csv"), table("obd_speed.csv"), table("gnss_pos.csv")
    events = sorted(
        [(row[0], 0, *row[1:]) for row in obd]
        + [(row[0], 1, *row[1:]) for row in positions]
        + [(row[0], 2, *row[1:]) for row in speeds]
    )
    result = Result(MotionMonitor())
    for time_s, kind, *row in events:
        time_ns = round(time_s * 1e9)
        if kind == 0:
            result.monitor.odometer(time_ns, (odometer(time_s, row[0]) if odometer else row[0]) * KM_H, KM_H)
        elif kind == 1 and row[0] == 1.0:
            result.monitor.position(time_ns, row[1], row[2])
        elif kind == 2:
            valid, speed, sd = row
            reported = gnss(time_s, speed) if gnss else speed
            result.monitor.gnss(time_ns, reported if valid or invalid_too else None, sd or None)
            verdicts = result.monitor.verdicts(time_ns)
            for name in vars(verdicts):
                statistic = getattr(verdicts, name).statistic
                if statistic is not None:
                    result.largest[name] = max(result.largest.get(name, 0.0), statistic)
                if getattr(verdicts, name).accuses:
                    result.first_s.setdefault(name, time_s)
    return result


@pytest.fixture(scope="module")
def nominal() -> Result:
    return drive()


def test_nothing_is_accused_and_the_trimmed_mean_stays_below_0_85_km_h(nominal: Result) -> None:
    result = nominal
    assert result.first_s == {}
    assert result.monitor.rejected == {}
    assert 0.3 * KM_H < result.largest["trimmed_mean"] <= 0.85 * KM_H
    assert result.largest["calibrated"] < result.largest["trimmed_mean"]
    assert {"event", "distance", "scale_step", "scale_range", "fast"} <= set(result.largest)


def test_the_receivers_lag_and_the_odometers_scale_are_learned(nominal: Result) -> None:
    learned = nominal.monitor.calibration.calibration
    assert learned.delay_s == pytest.approx(-0.375, abs=0.06)  # GNSS lags the odometer by 0.35 to 0.40 s
    assert learned.scale == pytest.approx(0.990, abs=0.005)  # 0.988 over the whole drive


def test_speed_0_marked_invalid_raises_the_trimmed_mean_only_if_the_mark_is_ignored(nominal: Result) -> None:
    ignored = drive(invalid_too=True)
    assert ignored.largest["trimmed_mean"] > 2.0 * nominal.largest["trimmed_mean"]


def test_injected_attacks_are_detected() -> None:
    drag_off = drive(gnss=lambda t, v: v + min(8.0, max(0.0, 0.3 * (t - 1500.0))))
    assert 1500.0 < drag_off.first_s["fast"] < 1515.0
    assert drag_off.first_s["event"] < 2100.0
    tyre = drive(odometer=lambda t, v: round(v * (1.04 if t > 1200.0 else 1.0)))
    assert 1200.0 < tyre.first_s["scale_step"] < 1330.0
    assert "trimmed_mean" not in tyre.first_s
    dead = drive(odometer=lambda t, v: 0.0 if t > 1200.0 else v)
    assert dead.first_s["motion_sensor"] < 1200.0 + 75.0
    assert dead.first_s["event"] < 1200.0 + 450.0
