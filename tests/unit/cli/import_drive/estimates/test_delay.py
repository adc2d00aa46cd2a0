"""Estimates of known delays of stamps."""

import math
from operator import attrgetter

import numpy as np
import pytest

from cli.import_drive.estimates.delay import delay_of_fixes, delay_of_reference
from services.sensors.simulator.drive import simulate
from shared.errors import UserError
from shared.messages.gnss import FixType, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import TruthState
from shared.runtime.config import VehicleFile, parse_vehicle
from tests.support.drives.tracks import START_NS, solution

S = 1_000_000_000
LATE_S, SET_S = 0.31, 0.1


def fix(time_s: float, error_m: float) -> GnssFix:
    s = solution(time_s, error_n=(error_m, -error_m, 0.0))
    return GnssFix(
        sampled_ns=s.sampled_ns, received_ns=s.sampled_ns, source="gnss", fix_type=FixType.THREE_D,
        latitude_deg=s.latitude_deg, longitude_deg=s.longitude_deg, height_ellipsoid_m=s.height_ellipsoid_m,
    )  # fmt: skip


def truth(time_s: float) -> TruthState:
    s = solution(time_s)
    return TruthState(
        sampled_ns=s.sampled_ns + round(LATE_S * S), latitude_deg=s.latitude_deg, longitude_deg=s.longitude_deg,
        height_ellipsoid_m=s.height_ellipsoid_m,
    )  # fmt: skip


def test_the_delay_of_a_reference_is_found_beside_a_constant_offset() -> None:
    rng = np.random.default_rng(1)
    fixes = [fix(0.5 * k, 2.0 + rng.normal(0.0, 0.3)) for k in range(240)]
    found = delay_of_reference([truth(0.9 + k) for k in range(110)], fixes)
    assert found.seconds == pytest.approx(LATE_S, abs=5.0 * found.sd_s + 0.01)
    assert found.sd_s < 0.02


def test_a_reference_at_standstill_or_beyond_the_range_is_an_error() -> None:
    still = [truth(0.0).model_copy(update={"sampled_ns": START_NS + k * S}) for k in range(100)]
    fixes = [fix(0.5 * k, 0.0) for k in range(240)]
    with pytest.raises(UserError, match="standstill"):
        delay_of_reference(still, fixes)
    with pytest.raises(UserError, match="so few positions"):
        delay_of_reference(still[:5], fixes)


def as_received(duration_s: float) -> tuple[list[ImuSamples | GnssFix], VehicleFile]:
    """A simulated drive at 50 Hz whose fixes are stamped late, and a vehicle file that corrects 0.1 s of it."""
    drive = simulate("parking_lot", seed=3, duration_s=duration_s)
    stamps, force, rate = drive.t_ns[1::2], *(x.reshape(-1, 2, 3).mean(axis=1) for x in (drive.force_b, drive.rate_b))
    imu = [
        ImuSamples(
            received_ns=t, source="imu", sampled_ns=(t,), specific_force_body_m_s2=(tuple(f),),
            angular_rate_body_rad_s=(tuple(w),),
        )
        for t, f, w in zip(stamps.tolist(), force.tolist(), rate.tolist(), strict=True)
    ]  # fmt: skip
    late = round(LATE_S * S)
    fixes = [
        GnssFix(
            sampled_ns=int(drive.fix_ns[k]) + late, received_ns=int(drive.fix_ns[k]) + late, source="gnss",
            fix_type=FixType.THREE_D, latitude_deg=math.degrees(drive.fix_position[k, 0]),
            longitude_deg=math.degrees(drive.fix_position[k, 1]), height_ellipsoid_m=float(drive.fix_position[k, 2]),
            velocity_ned_m_s=tuple(drive.fix_velocity_n[k].tolist()),
        )
        for k in np.flatnonzero(drive.fix_valid).tolist()
    ]  # fmt: skip
    text = (
        f"[vehicle]\nname = 'made'\n[vehicle.gnss]\nlever_arm_body_m = {list(drive.lever_arm_b)}\n"
        f"[core.fusion.gnss]\ndelay_s = {SET_S}\n"
    )
    return sorted([*imu, *fixes], key=attrgetter("received_ns")), parse_vehicle(text)


def test_the_delay_of_fixes_stamped_on_arrival_is_what_the_settings_lack_of_that_of_the_simulation() -> None:
    found = delay_of_fixes(*as_received(80.0))
    assert found.seconds == pytest.approx(LATE_S - SET_S, abs=0.02)
    assert 0.01 < found.sd_s < 0.05


def test_a_delay_that_no_motion_has_shown_is_an_error() -> None:
    inputs, vehicle = as_received(20.0)
    with pytest.raises(UserError, match="too few turns"):
        delay_of_fixes(inputs, vehicle)
    with pytest.raises(UserError, match="too few turns"):
        delay_of_fixes([message for message in inputs if isinstance(message, GnssFix)], vehicle)
