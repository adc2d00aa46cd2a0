"""Two files of the same drive whose clocks differ: the offset is found by the motion, and named."""

import math

import numpy as np
import pytest

from cli.import_drive.estimates.agreement import Motion, agreement_of, motion_of, told
from shared.maths.earth import FloatArray
from shared.messages.gnss import FixType, GnssFix
from shared.messages.imu import ImuSamples
from tests.support.cases import each

DURATION_S, START_S = 120.0, 1_790_000_000.0
TIMES = np.arange(0.0, DURATION_S, 0.02)


def rate_of(seconds: FloatArray) -> FloatArray:
    """Rate of turn [rad/s] of a drive that does not repeat."""
    rate: FloatArray = 0.2 * np.sin(0.3 * seconds + 0.004 * seconds**2) * (seconds > 10.0)
    return rate


SPEED = 10.0 + 3.0 * np.sin(0.2 * TIMES) + 2.0 * np.sin(0.077 * TIMES**1.3)
COURSE = np.cumsum(rate_of(TIMES)) * 0.02


def imu(shift_s: float = 0.0, *, moves: bool = True) -> Motion:
    force, rate = np.gradient(SPEED, 0.02) * moves, rate_of(TIMES) * moves
    message = ImuSamples(
        received_ns=0, source="imu",
        sampled_ns=tuple(round((START_S + shift_s + t) * 1e9) for t in TIMES.tolist()),
        specific_force_body_m_s2=tuple((f, 0.0, -9.8) for f in force.tolist()),
        angular_rate_body_rad_s=tuple((0.0, 0.0, w) for w in rate.tolist()),
    )  # fmt: skip
    found = motion_of([message])
    assert found is not None
    return found


def fixes(shift_s: float = 0.0, *, velocities: bool = True, moves: bool = True) -> Motion:
    velocity = np.column_stack([SPEED * np.cos(COURSE), SPEED * np.sin(COURSE), np.zeros(len(SPEED))]) * moves
    north, east, _ = (np.cumsum(velocity, axis=0) * 0.02).T
    messages = []
    for k in range(0, len(TIMES), 10):
        stamp = round((START_S + shift_s + float(TIMES[k])) * 1e9)
        messages.append(GnssFix(
            sampled_ns=stamp, received_ns=stamp, source="gnss", fix_type=FixType.THREE_D,
            latitude_deg=47.0 + math.degrees(float(north[k]) / 6.37e6),
            longitude_deg=8.0 + math.degrees(float(east[k]) / 6.37e6 / math.cos(math.radians(47.0))),
            velocity_ned_m_s=tuple(velocity[k].tolist()) if velocities else None,
        ))  # fmt: skip
    found = motion_of(messages)
    assert found is not None
    return found


@each("velocities", [True, False])
@each(
    ("shift_s", "named"),
    [
        (18.0, "the leap seconds between GPS time and UTC"), (-18.0, "the leap seconds between GPS time and UTC"),
        (19.0, "the seconds between TAI and GPS time"), (37.0, "the leap seconds between TAI and UTC"),
        (3600.0, "a time zone of 1 h"), (-7200.0, "a time zone of 2 h"), (19_800.0, "a time zone of 5.5 h"),
        (604_800.0, "one week"), (-315_964_800.0, "where GPS time begins"),
    ],
)  # fmt: skip
def test_an_offset_of_the_clocks_is_found_and_named(shift_s: float, named: str, velocities: bool) -> None:
    (said,) = told({"imu.csv": imu(), "gnss.csv": fixes(shift_s, velocities=velocities)})
    assert named in said
    assert f"Add {-shift_s:+.10g} to `offset_s` in `time` of gnss.csv" in said
    assert ("do not overlap in time" in said) == (abs(shift_s) > DURATION_S)
    assert ('set `scale = "gps"` in that of gnss.csv' in said) == (shift_s == 18.0)
    assert ('set `scale = "gps"` in that of imu.csv' in said) == (shift_s == -18.0)


def test_an_offset_that_has_no_name_is_found_by_the_motion() -> None:
    found = agreement_of(imu(), fixes(11.4))
    assert found is not None and found.shift_s == pytest.approx(-11.4, abs=0.2)
    assert found.correlation > 0.9
    assert found.correlation_unshifted < 0.4
    (said,) = told({"imu.csv": imu(), "gnss.csv": fixes(11.4)})
    assert "probably 11.4 s apart" in said


@pytest.mark.parametrize("shift_s", [0.0, 0.3, -0.5])
def test_clocks_that_agree_and_delays_are_not_told(shift_s: float) -> None:
    assert told({"imu.csv": imu(), "gnss.csv": fixes(shift_s)}) == []


def test_a_parked_drive_is_judged_by_its_beginning_and_end() -> None:
    (said,) = told({"imu.csv": imu(moves=False), "gnss.csv": fixes(18.0, moves=False)})
    assert "one begins and ends that much after the other" in said and "leap seconds" in said
    (said,) = told({"imu.csv": imu(moves=False), "gnss.csv": fixes(500.0, moves=False)})
    assert said.startswith("imu.csv and gnss.csv do not overlap in time") and "Check the clock of each" in said
    assert told({"imu.csv": imu(moves=False), "gnss.csv": fixes(7.0, moves=False)}) == []
