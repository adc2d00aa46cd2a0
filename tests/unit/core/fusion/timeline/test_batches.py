"""Live and offline: the same samples, in messages of one or of many, give the same solutions."""

from collections.abc import Iterator
from functools import cache
from math import degrees

import pytest

from services.core.fusion.process import Config, Process
from shared.messages.base import Message
from shared.messages.gnss import FixType, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import AidingUpdate, LastPosition, NavigationSolution, NavigationState
from shared.messages.vehicle import WheelSpeeds
from tests.support.drives.on_time import SAMPLE_DELAY_NS, drive, epochs, samples, wheel_stamps

TOGETHER = 10  # samples that arrive together at the driver
Published = list[NavigationSolution | AidingUpdate | NavigationState]


def imu_messages(size: int) -> Iterator[tuple[int, int, Message]]:
    """Samples in messages of a size, with the time of arrival at which the driver has read all that came together."""
    given = samples()
    for begin in range(0, len(given), size):
        part, together = given[begin : begin + size], begin // TOGETHER * TOGETHER
        received_ns = given[together : together + TOGETHER][-1].time_ns + SAMPLE_DELAY_NS
        yield received_ns, 0, ImuSamples(
            received_ns=received_ns, source="imu", sampled_ns=tuple(sample.time_ns for sample in part),
            specific_force_body_m_s2=tuple(sample.force for sample in part),
            angular_rate_body_rad_s=tuple(sample.rate for sample in part),
        )  # fmt: skip


def aiding_messages(late_ns: int) -> Iterator[tuple[int, int, Message]]:
    """Fixes, one of them late, and speeds."""
    d = drive()
    for k in epochs():
        stamp_ns = int(d.fix_ns[k])
        received_ns = stamp_ns + (late_ns if k == epochs()[30] else 80_000_000)
        latitude, longitude, height = d.fix_position[k].tolist()
        north, east, down = d.fix_velocity_n[k].tolist()
        yield received_ns, 1, GnssFix(
            sampled_ns=stamp_ns, received_ns=received_ns, source="gnss", fix_type=FixType.THREE_D,
            latitude_deg=degrees(latitude), longitude_deg=degrees(longitude), height_ellipsoid_m=height,
            velocity_ned_m_s=(north, east, down),
        )  # fmt: skip
    for k in wheel_stamps():
        stamp_ns, speed = int(d.odometer_ns[k]), float(d.odometer[k])
        yield stamp_ns + 7_000_000, 1, WheelSpeeds(
            sampled_ns=stamp_ns, received_ns=stamp_ns + 7_000_000, source="wheels", rear_left_m_s=speed,
            rear_right_m_s=speed,
        )  # fmt: skip


@cache
def published(size: int, late_ns: int) -> Published:
    """What core.fusion publishes of the drive, up to the end of a recording."""
    d = drive()
    latitude, longitude, height = d.position[0].tolist()
    process = Process(
        Config().with_values({"vehicle.gnss.lever_arm_body_m": d.lever_arm_b, "alignment.levelling_s": 1.0})
    )
    parked = LastPosition(
        sampled_ns=0, latitude_deg=degrees(latitude), longitude_deg=degrees(longitude), height_ellipsoid_m=height,
        position_sd_ned_m=(1.0, 1.0, 2.0), yaw_rad=float(d.attitude[0, 2]), yaw_sd_rad=0.02,
    )  # fmt: skip
    by_arrival = sorted([*imu_messages(size), *aiding_messages(late_ns)], key=lambda pair: pair[:2])
    found = list(process.handle(parked))
    for _, _, message in by_arrival:
        found += process.handle(message)  # type: ignore[arg-type]  # of the kinds that it takes
    found += process.finish()
    return [item for item in found if isinstance(item, NavigationSolution | AidingUpdate | NavigationState)]


@pytest.mark.parametrize("late_ns", [80_000_000, 900_000_000])
@pytest.mark.parametrize("size", [5, 10])
def test_the_size_of_a_message_of_samples_does_not_matter(size: int, late_ns: int) -> None:
    one_by_one, together = published(1, late_ns), published(size, late_ns)
    assert sum(isinstance(item, NavigationSolution) for item in one_by_one) > 30
    assert sum(isinstance(item, AidingUpdate) for item in one_by_one) > 100
    if late_ns > 500_000_000:
        assert (
            max(
                navigation_state.measurements_late
                for navigation_state in one_by_one
                if isinstance(navigation_state, NavigationState)
            )
            == 2
        )
    assert together == one_by_one
