import numpy as np
import pytest

from cli.import_drive.estimates.clocks import offset_of, shifted
from cli.import_drive.mapping.mapping import parse_mapping
from shared.errors import UserError
from shared.maths.earth import Geodetic, geodetic_from_ned_difference
from shared.messages.gnss import FixType, GnssFix
from shared.messages.vehicle import VehicleSpeed

PLACE = Geodetic(0.56, 0.6, 200.0)
S = 1_000_000_000


def speed_at(time_s: float) -> float:
    """Speed of a car with standstill at both ends, without periodicity."""
    return max(0.0, 5.0 + 4.0 * np.sin(0.11 * time_s) + 2.0 * np.sin(0.043 * time_s + 1.0)) if time_s > 10.0 else 0.0


def fixes(duration_s: float = 120.0, *, with_velocity: bool) -> list[GnssFix]:
    """Fixes at 5 Hz on a track to the north, with RTK noise."""
    rng, made, north = np.random.default_rng(1), [], 0.0
    for k in range(round(duration_s * 5)):
        time_s = 0.2 * k
        north += 0.2 * speed_at(time_s - 0.1)
        place = geodetic_from_ned_difference((north + rng.normal(0.0, 0.01), rng.normal(0.0, 0.01), 0.0), PLACE)
        velocity = (speed_at(time_s), 0.0, 0.0) if with_velocity else None
        made.append(GnssFix(
            sampled_ns=round(time_s * S), received_ns=round(time_s * S), source="gnss", fix_type=FixType.THREE_D,
            latitude_deg=float(np.degrees(place.latitude)), longitude_deg=float(np.degrees(place.longitude)),
            height_ellipsoid_m=place.height, velocity_ned_m_s=velocity,
        ))  # fmt: skip
    return made


def speeds(offset_s: float, first_s: float, last_s: float) -> list[VehicleSpeed]:
    """A wheel speed at 100 Hz with a clock offset."""
    times = np.arange(first_s, last_s, 0.01).tolist()
    stamps = [round((t - offset_s) * S) for t in times]
    return [
        VehicleSpeed(sampled_ns=stamp, received_ns=stamp, source="wheel", speed_m_s=float(speed_at(t)))
        for stamp, t in zip(stamps, times, strict=True)
    ]


@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize(("offset_s", "first_s", "last_s"), [(-715.13, 0.3, 119.0), (2000.0, 40.0, 180.0)])
def test_the_clock_offset_of_a_wheel_is_estimated_from_its_speed(
    offset_s: float, first_s: float, last_s: float, with_velocity: bool
) -> None:
    found = offset_of(speeds(offset_s, first_s, last_s), fixes(with_velocity=with_velocity))
    # Speeds between positions have 0.07 m/s of noise; over 400 of them the clock is known to a few milliseconds.
    assert found.seconds == pytest.approx(offset_s, abs=0.02)
    assert found.rms_m_s < (0.02 if with_velocity else 0.1)


def test_shifted_speeds_differ_in_their_stamps_only() -> None:
    before = speeds(5.0, 20.0, 21.0)
    after = shifted(before, 5.0)
    assert [a.sampled_ns - b.sampled_ns for a, b in zip(after, before, strict=True)] == [5 * S] * len(before)
    assert after[0].speed_m_s == before[0].speed_m_s and after[0].received_ns == after[0].sampled_ns


def test_the_clock_offset_of_a_parked_vehicle_is_not_observable() -> None:
    with pytest.raises(UserError, match="nearly constant"):
        offset_of(speeds(0.0, 0.0, 9.0), fixes(with_velocity=True))


def test_a_rotation_rate_requires_a_wheel_radius_and_clock_by_speed_requires_fixes() -> None:
    wheel = '[speed]\nfile = "w.csv"\ntime = { column = "t" }\ncolumn = "w"\nunit = "deg/s"\n'
    with pytest.raises(UserError, match="`wheel_radius_m` is required"):
        parse_mapping('name = "drive"\n' + wheel, "m.toml")
    with pytest.raises(UserError, match="neither a unit of speed"):
        parse_mapping('name = "drive"\n' + wheel.replace("deg/s", "deg"), "m.toml")
    with pytest.raises(UserError, match=r"requires a \[gnss\] table"):
        parse_mapping('name = "drive"\n' + wheel + "wheel_radius_m = 0.3\nclock_by_speed = true\n", "m.toml")
