"""What is published while a sensor is missing: solution, covariance, verdict and sentence."""

from collections.abc import Iterator, Sequence
from functools import cache
from math import degrees, hypot, radians

import numpy as np
import numpy.typing as npt
import pytest

from services.core.fusion.process import Config, Process
from services.core.trust.process import Config as TrustConfig
from services.core.trust.process import Process as Trust
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic, ned_from_geodetic_difference, wrap_angle
from shared.messages.base import Message, Tick
from shared.messages.gnss import FixType, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import LastPosition, NavigationPhase, NavigationSolution, NavigationState
from shared.messages.trust import TrustLevel, TrustState
from shared.missing_sensors import NO_GNSS_YET, NO_INERTIAL_UNIT
from shared.runtime.config import GnssAntenna, Vehicle

EPOCH_NS = 1_790_000_000_000_000_000
S = 1_000_000_000
BATCH = 2
SOLVED = (NavigationPhase.NAVIGATING, NavigationPhase.COASTING)


@cache
def drive() -> Drive:
    return simulate("urban", seed=4, duration_s=90.0)


def fixes(begin_s: float = 0.0, end_s: float = 1e9) -> list[GnssFix]:
    d, found = drive(), []
    for k, at_ns in enumerate(d.fix_ns.tolist()):
        if not begin_s <= at_ns / S < end_s:
            continue
        latitude, longitude = np.degrees(d.fix_position[k, :2]).tolist()
        found.append(
            GnssFix(
                sampled_ns=EPOCH_NS + at_ns, received_ns=EPOCH_NS + at_ns + 80_000_000, source="gnss",
                fix_type=FixType.THREE_D, latitude_deg=latitude, longitude_deg=longitude,
                height_ellipsoid_m=float(d.fix_position[k, 2]),
                velocity_ned_m_s=tuple(d.fix_velocity_n[k].tolist()),
                position_sd_ned_m=tuple(d.fix_position_sd_n[k].tolist()),
                velocity_sd_ned_m_s=tuple(d.fix_velocity_sd_n[k].tolist()),
            )
        )  # fmt: skip
    return found


def samples(*gaps: tuple[float, float]) -> list[ImuSamples]:
    d, found = drive(), []
    for i in range(0, len(d.t_ns) - BATCH, BATCH):
        stamps = d.t_ns[i : i + BATCH]
        if any(begin_s * S <= stamps[0] < end_s * S for begin_s, end_s in gaps):
            continue
        found.append(
            ImuSamples(
                received_ns=EPOCH_NS + int(stamps[-1]) + 2_000_000, source="imu",
                sampled_ns=tuple((EPOCH_NS + stamps).tolist()),
                specific_force_body_m_s2=tuple(map(tuple, d.force_b[i : i + BATCH].tolist())),
                angular_rate_body_rad_s=tuple(map(tuple, d.rate_b[i : i + BATCH].tolist())),
            )
        )  # fmt: skip
    return found


def parked(*, stationary: bool = True) -> LastPosition:
    """Position and heading that were saved where the drive begins."""
    place, attitude = drive().position[0].tolist(), drive().attitude[0].tolist()
    return LastPosition(
        sampled_ns=EPOCH_NS - 10**12, latitude_deg=degrees(place[0]), longitude_deg=degrees(place[1]),
        height_ellipsoid_m=place[2], yaw_rad=attitude[2], position_sd_ned_m=(1.0, 1.0, 2.0), yaw_sd_rad=0.02,
        stationary=stationary, earlier_life=True,
    )  # fmt: skip


def run(
    messages: Sequence[GnssFix | ImuSamples],
    last: LastPosition | None = None,
    settings: dict[str, object] | None = None,
) -> Iterator[Message]:
    """Outputs of fusion and trust, with a tick of trust each second."""
    vehicle = Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive().lever_arm_b))
    fusion = Process(Config(vehicle=vehicle).with_values(settings or {}))
    trust, second = Trust(TrustConfig()), 0
    if last is not None:
        yield from fusion.handle(last)
    for message in sorted(messages, key=lambda m: m.received_ns):
        now_ns = message.received_ns
        if now_ns // S != second:
            second = now_ns // S
            yield from trust.handle(Tick(now_ns=now_ns))
        for out in fusion.handle(message):
            yield out
            if isinstance(out, NavigationSolution | NavigationState):
                yield from trust.handle(out)


def solutions(out: Sequence[Message]) -> list[NavigationSolution]:
    return [message for message in out if isinstance(message, NavigationSolution)]


def errors(solution: NavigationSolution) -> tuple[npt.NDArray[np.float64], float]:
    """Error of the position [m, NED] and of the heading [rad]."""
    d = drive()
    i = int(np.searchsorted(d.t_ns, solution.sampled_ns - EPOCH_NS))
    i = min(i, len(d.t_ns) - 1)
    place = Geodetic(radians(solution.latitude_deg), radians(solution.longitude_deg), solution.height_ellipsoid_m)
    apart = np.array(ned_from_geodetic_difference(place, Geodetic(*d.position[i].tolist())))
    return apart, wrap_angle(solution.yaw_rad - float(d.attitude[i, 2]))


def test_without_an_imu_each_fix_is_published_and_the_verdict_is_caution() -> None:
    out = list(run(fixes()))
    found = solutions(out)
    assert len(found) >= len(fixes()) - 6
    assert {navigation_solution.phase for navigation_solution in found} == {NavigationPhase.GNSS_ONLY}
    outside = [
        hypot(*errors(navigation_solution)[0][:2]) > (navigation_solution.protection_level_horizontal_m or 0.0)
        for navigation_solution in found
    ]
    assert not any(outside)
    moving = [
        navigation_solution for navigation_solution in found if hypot(*navigation_solution.velocity_ned_m_s) > 5.0
    ]
    assert max(abs(degrees(errors(navigation_solution)[1])) for navigation_solution in moving) < 15.0
    verdicts = [message for message in out if isinstance(message, TrustState)]
    assert verdicts[0].state is TrustLevel.INITIALISING
    assert verdicts[-1].state is TrustLevel.CAUTION
    assert verdicts[-1].reason_codes[0].code == NO_INERTIAL_UNIT


def test_with_neither_imu_nor_gnss_there_is_no_fix() -> None:
    nothing = [fix.model_copy(update={"fix_type": FixType.NONE, "latitude_deg": None}) for fix in fixes(40.0)]
    out = list(run([*fixes(0.0, 40.0), *nothing]))
    assert max(solution.sampled_ns for solution in solutions(out)) < EPOCH_NS + 40 * S
    assert [message for message in out if isinstance(message, TrustState)][-1].state is TrustLevel.NO_FIX


@pytest.mark.parametrize(
    "gaps",
    [
        pytest.param(((35.0, 40.0),), id="5 s", marks=pytest.mark.slow),
        pytest.param(((50.0, 67.0),), id="17 s", marks=pytest.mark.slow),
        pytest.param(((50.0, 52.0), (52.5, 54.0), (54.3, 60.0)), id="three in a row"),
    ],
)
def test_a_gap_of_the_imu_is_survived_by_fixes_and_the_kept_heading(gaps: tuple[tuple[float, float], ...]) -> None:
    """At 1 Hz two positions are 2 s apart at most, and the filter goes on 1.3 s after the gap at the latest."""
    found = solutions(list(run([*fixes(), *samples(*gaps)])))
    times_s = np.array([(navigation_solution.sampled_ns - EPOCH_NS) / S for navigation_solution in found])
    begin_s, end_s = gaps[0][0], gaps[-1][1]
    assert np.diff(times_s[times_s > begin_s - 0.5]).max() < 2.05
    during = {
        navigation_solution.phase
        for navigation_solution, at_s in zip(found, times_s, strict=True)
        if begin_s + 1.0 < at_s < end_s - 0.05
    }
    assert NavigationPhase.GNSS_ONLY in during
    after = [
        navigation_solution
        for navigation_solution, at_s in zip(found, times_s, strict=True)
        if at_s > end_s and navigation_solution.phase is NavigationPhase.NAVIGATING
    ]
    assert (after[0].sampled_ns - EPOCH_NS) / S < end_s + 1.35
    kept = [
        navigation_solution
        for navigation_solution in after
        if (navigation_solution.sampled_ns - EPOCH_NS) / S < end_s + 5.0
    ]
    assert (
        max(
            errors(navigation_solution)[1] ** 2 / navigation_solution.attitude_cov_ned_rad2[5]
            for navigation_solution in kept
        )
        < 9.0
    )
    assert max(abs(degrees(errors(navigation_solution)[1])) for navigation_solution in kept) < 6.0
    assert all(
        hypot(*errors(navigation_solution)[0][:2]) < (navigation_solution.protection_level_horizontal_m or 0.0)
        for navigation_solution in found
    )


def test_a_parked_vehicle_keeps_its_heading_over_a_gap() -> None:
    """The drive stands for 20 s; a saved heading starts the filter after levelling for 15 s."""
    begin_s, end_s, stop_s = 16.8, 19.0, 20.4
    received = [sample for sample in samples((begin_s, end_s)) if sample.received_ns < EPOCH_NS + stop_s * S]
    found = [
        solution
        for solution in solutions(list(run([*fixes(0.0, stop_s), *received], parked())))
        if solution.phase in SOLVED
    ]
    times_s = [(navigation_solution.sampled_ns - EPOCH_NS) / S for navigation_solution in found]
    assert min(times_s) < begin_s, "the filter runs before the gap"
    assert min(at_s for at_s in times_s if at_s > end_s) < end_s + 1.35
    assert abs(degrees(errors(found[-1])[1])) < 3.0
    assert found[-1].attitude_cov_ned_rad2[5] < radians(3.0) ** 2


def test_without_gnss_a_parked_vehicle_starts_at_its_saved_position() -> None:
    """Initialising, then dead reckoning from where it was parked; its errors stay within the level."""
    received = [sample for sample in samples() if sample.received_ns < EPOCH_NS + 30 * S]
    out = list(run(received, parked(), {"alignment.without_gnss_s": 17.0}))
    found = solutions(out)
    assert {navigation_solution.phase for navigation_solution in found} == {NavigationPhase.COASTING}
    assert 17.0 < (found[0].sampled_ns - EPOCH_NS) / S < 17.5
    assert all(
        hypot(*errors(navigation_solution)[0][:2]) < (navigation_solution.protection_level_horizontal_m or 0.0)
        for navigation_solution in found
    )
    states = [message for message in out if isinstance(message, TrustState)]
    assert states[0].state is TrustLevel.INITIALISING
    assert TrustLevel.DEAD_RECKONING in {state.state for state in states}
    assert any(state.reason_codes[0].code == NO_GNSS_YET for state in states)


def test_a_position_saved_on_the_move_is_no_place_to_start_from() -> None:
    received = [sample for sample in samples() if sample.received_ns < EPOCH_NS + 25 * S]
    assert not solutions(list(run(received, parked(stationary=False), {"alignment.without_gnss_s": 17.0})))


def test_a_vehicle_that_has_moved_is_not_where_it_was_saved() -> None:
    """It drives off before the time is over."""
    received = [sample for sample in samples() if sample.received_ns < EPOCH_NS + 35 * S]
    assert not solutions(list(run(received, parked(), {"alignment.without_gnss_s": 24.0})))


def test_without_gnss_and_imu_excluded_by_trust_nothing_is_published() -> None:
    """A position of GNSS alone is the excluded one."""
    process = Process(Config())
    excluded = TrustState(
        sampled_ns=EPOCH_NS, state=TrustLevel.DEAD_RECKONING, since_ns=EPOCH_NS, row=5, reasons=("",),
        gnss_excluded=True, suspect_since_ns=EPOCH_NS - 10 * S, alert_limit_horizontal_m=10.0,
        alert_limit_vertical_m=20.0,
    )  # fmt: skip
    out: list[Message] = [*process.handle(excluded)]
    out += [item for fix in fixes() for item in process.handle(fix)]
    assert not solutions(out)
    states = [message for message in out if isinstance(message, NavigationState)]
    assert states[-1].phase is NavigationPhase.WAITING_FOR_IMU
    assert "GNSS is excluded: no position" in states[-1].reason
