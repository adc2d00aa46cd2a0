"""core.fusion through its messages."""

from collections.abc import Sequence
from functools import cache
from math import atan2, hypot, radians
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from services.core.fusion.aids.gnss.aid import of_fix
from services.core.fusion.aids.odometer.settings import OdometerSettings
from services.core.fusion.messages import state_message
from services.core.fusion.navigator import Navigator
from services.core.fusion.process import Config, Process
from services.sensors.simulator.drive import Drive, simulate
from shared.bus.codec import decode, encode
from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.messages.base import Message, Tick
from shared.messages.gnss import FixType, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import (
    AidingKind,
    AidingUpdate,
    ConflictRecord,
    FilterState,
    LastPosition,
    NavigationPhase,
    NavigationSolution,
    NavigationState,
)
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds
from shared.runtime.config import GnssAntenna, Vehicle

EPOCH_NS = 1_790_000_000_000_000_000
LATENCY_NS = 80_000_000


@cache
def drive() -> Drive:
    return simulate("parking_lot", seed=4, duration_s=60.0)


@cache
def samples(batch: int = 1) -> tuple[ImuSamples, ...]:
    d = drive()
    messages = []
    for i in range(0, len(d.t_ns), batch):
        stamps = (EPOCH_NS + d.t_ns[i : i + batch]).tolist()
        messages.append(
            ImuSamples(
                received_ns=stamps[-1] + 2_000_000,
                source="imu",
                sampled_ns=tuple(stamps),
                specific_force_body_m_s2=tuple(map(tuple, d.force_b[i : i + batch].tolist())),
                angular_rate_body_rad_s=tuple(map(tuple, d.rate_b[i : i + batch].tolist())),
            )
        )
    return tuple(messages)


def fix(k: int, **changes: object) -> GnssFix:
    d = drive()
    latitude, longitude = np.degrees(d.fix_position[k, :2]).tolist()
    stamp = EPOCH_NS + int(d.fix_ns[k])
    fields: dict[str, object] = {
        "sampled_ns": stamp,
        "received_ns": stamp + LATENCY_NS,
        "source": "gnss",
        "fix_type": FixType.THREE_D,
        "latitude_deg": latitude,
        "longitude_deg": longitude,
        "height_ellipsoid_m": float(d.fix_position[k, 2]),
        "velocity_ned_m_s": tuple(d.fix_velocity_n[k].tolist()),
        "position_sd_ned_m": tuple(d.fix_position_sd_n[k].tolist()),
        "velocity_sd_ned_m_s": tuple(d.fix_velocity_sd_n[k].tolist()),
    }
    return GnssFix.model_validate(fields | changes)


def nmea_fix(k: int) -> GnssFix:
    """A fix of an NMEA receiver: no covariance, speed and course instead of a velocity."""
    north, east, _ = drive().fix_velocity_n[k].tolist()
    speed = hypot(north, east)
    return fix(
        k,
        velocity_ned_m_s=None,
        position_sd_ned_m=None,
        velocity_sd_ned_m_s=None,
        hdop=0.8,
        ground_speed_m_s=speed,
        course_rad=atan2(east, north) if speed > 0.5 else None,
    )


def run(messages: Sequence[Message], process: Process | None = None) -> list[Message]:
    made = process or Process(Config(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive().lever_arm_b))))
    out: list[Message] = []
    for message in sorted(messages, key=lambda m: getattr(m, "received_ns", 0)):
        assert isinstance(
            message, ImuSamples | GnssFix | LastPosition | FilterState | VehicleSpeed | WheelSpeeds | Tick
        )
        out += made.handle(message)
    return out


@cache
def standard_run() -> list[Message]:
    """Outputs for a saved position and all samples and fixes of the drive."""
    return run([saved(), *samples(), *fixes()])


@cache
def unprepared_run() -> list[Message]:
    """Outputs without a saved position."""
    return run([*samples(), *fixes()])


def horizontal_error_m(solution: NavigationSolution) -> float:
    truth = Geodetic(*drive().position[round((solution.sampled_ns - EPOCH_NS) / 1e7) - 1].tolist())
    place = Geodetic(radians(solution.latitude_deg), radians(solution.longitude_deg), solution.height_ellipsoid_m)
    return hypot(*ned_from_geodetic_difference(place, truth)[:2])


@cache
def fixes() -> tuple[GnssFix, ...]:
    return tuple(fix(k) for k in range(len(drive().fix_ns)))


def saved() -> LastPosition:
    d = drive()
    latitude, longitude = np.degrees(d.position[0, :2]).tolist()
    return LastPosition(
        sampled_ns=EPOCH_NS - 10**12,
        utc_ns=None,
        latitude_deg=latitude,
        longitude_deg=longitude,
        height_ellipsoid_m=float(d.position[0, 2]),
        yaw_rad=float(d.attitude[0, 2]),
        position_sd_ned_m=(1.0, 1.0, 2.0),
        yaw_sd_rad=0.02,
    )


def test_the_configured_alert_limits_are_part_of_the_state() -> None:
    limits = Vehicle(alert_limit_horizontal_m=2.5, alert_limit_vertical_m=7.5)
    out = run(samples()[:30], Process(Config(vehicle=limits)))
    [state, *_] = [m for m in out if isinstance(m, NavigationState)]
    assert (state.alert_limit_horizontal_m, state.alert_limit_vertical_m) == (2.5, 7.5)


def test_phases_follow_in_order_and_the_last_solution_is_close_to_the_truth() -> None:
    out = unprepared_run()
    states = [m for m in out if isinstance(m, NavigationState)]
    phases = list(dict.fromkeys(m.phase for m in states))
    assert phases == [NavigationPhase.LEVELLING, NavigationPhase.WAITING_FOR_HEADING, NavigationPhase.NAVIGATING]
    assert all(m.reason for m in states)
    solutions = [m for m in out if isinstance(m, NavigationSolution)]
    assert all(m.phase in (NavigationPhase.NAVIGATING, NavigationPhase.COASTING) for m in solutions)
    assert horizontal_error_m(solutions[-1]) < 0.6
    assert solutions[-1].gnss_age_s == pytest.approx(0.0, abs=1.1)


def test_with_a_saved_heading_the_solution_begins_at_standstill() -> None:
    def first(out: Sequence[Message]) -> float:
        solution = next(m for m in out if isinstance(m, NavigationSolution))
        return (solution.sampled_ns - EPOCH_NS) * 1e-9

    speed = np.hypot(drive().velocity_n[:, 0], drive().velocity_n[:, 1])
    drives_off_s = float(np.argmax(speed > 0.1)) * 0.01
    assert first(standard_run()) < drives_off_s < first(unprepared_run())


def test_a_last_position_of_this_drive_is_no_saved_position() -> None:
    """As the controller stores it while fixes alone are published, because the inertial unit begins later."""
    aside_deg = saved().latitude_deg + 0.02
    own_ns = fix(0).received_ns + 10**9
    own = saved().model_copy(update={"sampled_ns": own_ns, "latitude_deg": aside_deg, "stationary": True})
    made = Process(Config(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive().lever_arm_b))))
    for message in (fix(0), own):
        list(made.handle(message))
    out = run([*samples()[:4000], *fixes()[1:40]], made)
    assert not [m for m in out if isinstance(m, NavigationState) and m.held_horizontal_m]
    first = next(m for m in out if isinstance(m, NavigationSolution) and m.phase is NavigationPhase.NAVIGATING)
    without = next(m for m in unprepared_run() if isinstance(m, NavigationSolution))
    assert first.sampled_ns >= without.sampled_ns, "nor a heading to start with"


def test_solutions_are_published_every_0_1_s_and_states_every_second() -> None:
    out = standard_run()
    solutions = [m.sampled_ns for m in out if isinstance(m, NavigationSolution)]
    assert set(np.diff(solutions)[1:].tolist()) == {100_000_000}, "after the first"
    states = [m.sampled_ns for m in out if isinstance(m, NavigationState)]
    assert max(np.diff(states)) == 1_000_000_000
    assert 60 <= len(states) <= 65


def test_the_period_of_the_solutions_can_be_set() -> None:
    process = Process(
        Config(solution_period_s=0.02, vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive().lever_arm_b)))
    )
    solutions = [m for m in run([saved(), *samples()[:3000], *fixes()[:30]], process)
                 if isinstance(m, NavigationSolution)]  # fmt: skip
    assert np.diff([m.sampled_ns for m in solutions]).max() == 20_000_000


def test_batches_of_ten_samples_result_in_as_many_solutions_and_an_error_below_0_6_m() -> None:
    one, ten = standard_run(), run([saved(), *samples(batch=10), *fixes()])
    errors = [horizontal_error_m(m) for m in ten if isinstance(m, NavigationSolution)]
    assert len([m for m in one if isinstance(m, NavigationSolution)]) == pytest.approx(len(errors), abs=1)
    assert errors[-1] < 0.6


def test_two_runs_agree_to_the_last_bit() -> None:
    assert run([saved(), *samples(), *fixes()]) == standard_run()


def test_ticks_change_nothing() -> None:
    messages: list[Message] = [saved(), *samples(), *fixes()]
    ticks = [Tick(now_ns=EPOCH_NS + k * 10**9) for k in range(60)]
    assert run([*messages, *ticks]) == standard_run()


def wheels(k: int, **changes: float | None) -> WheelSpeeds:
    """Wheel speeds at a stamp of the odometer; the front ones too large, as in bends."""
    stamp, speed = EPOCH_NS + int(drive().odometer_ns[k]), float(drive().odometer[k])
    readings = {"rear_left_m_s": speed - 0.1, "rear_right_m_s": speed + 0.1, "front_left_m_s": 1.5 * speed, **changes}
    return WheelSpeeds(sampled_ns=stamp, received_ns=stamp + 10_000_000, source="can", **readings)


def odometer_updates(messages: Sequence[Message], config: Config | None = None) -> list[AidingUpdate]:
    process = Process(config or Config(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive().lever_arm_b))))
    out = run([saved(), *samples(), *fixes(), *messages], process)
    return [m for m in out if isinstance(m, AidingUpdate) and m.kind is AidingKind.ODOMETER]


def test_the_mean_of_the_rear_wheels_aids_the_filter() -> None:
    readings = range(len(drive().odometer_ns))
    updates = odometer_updates([wheels(k) for k in readings])
    assert len(updates) > 350 and {m.source for m in updates} == {"can"}
    assert np.mean([m.used for m in updates]) > 0.99
    assert np.sqrt(np.mean([m.innovation[0] ** 2 for m in updates])) < 0.1
    without = odometer_updates([wheels(k, rear_left_m_s=None, rear_right_m_s=None) for k in readings])
    assert max(m.innovation[0] for m in without) > 1.0, "the front wheel alone, which is too fast here"


def test_wheel_speeds_without_values_yield_no_update() -> None:
    silent = {"rear_left_m_s": None, "rear_right_m_s": None, "front_left_m_s": None}
    assert odometer_updates([wheels(k, **silent) for k in range(100, 200)]) == []


def test_the_obd_speed_is_used_until_wheel_speeds_are_received_and_weighted_by_its_resolution() -> None:
    d = drive()
    speeds = [
        VehicleSpeed(
            sampled_ns=EPOCH_NS + int(d.odometer_ns[k]),
            received_ns=EPOCH_NS + int(d.odometer_ns[k]) + 10_000_000,
            source="obd",
            speed_m_s=round(float(d.odometer[k]) * 3.6) / 3.6,
            resolution_m_s=1.0 / 3.6,
        )
        for k in range(0, 600, 7)
    ]
    updates = odometer_updates([*speeds, *(wheels(k) for k in range(400, 600))])
    by_source = {name: [m.sampled_ns for m in updates if m.source == name] for name in ("obd", "can")}
    assert max(by_source["obd"]) < min(by_source["can"]) + 10**8
    moving = [m for m in updates if m.source == "obd" and m.used]
    assert min(m.innovation_sd[0] for m in moving) > 1.0 / 3.6 / 12**0.5


def test_a_disabled_odometer_is_not_used() -> None:
    config = Config(
        vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive().lever_arm_b)),
        odometer=OdometerSettings(enabled=False),
    )
    assert odometer_updates([wheels(k) for k in range(600)], config) == []


def test_with_an_nmea_receiver_the_error_is_below_1_5_m() -> None:
    out = run([*samples(), *(nmea_fix(k) for k in range(60))])
    solutions = [m for m in out if isinstance(m, NavigationSolution)]
    assert horizontal_error_m(solutions[-1]) < 1.5


def test_more_than_98_percent_of_the_aiding_updates_were_used() -> None:
    updates = [m for m in standard_run() if isinstance(m, AidingUpdate)]
    assert {m.source for m in updates} == {"gnss", "core.fusion"}
    assert np.mean([m.used for m in updates]) > 0.98
    assert all(len(m.innovation) == len(m.innovation_sd) for m in updates)
    assert {len(m.innovation) for m in updates if m.kind is not AidingKind.NON_HOLONOMIC} == {3}


def test_every_measurement_of_a_late_fix_is_reported_once() -> None:
    updates = [m for m in unprepared_run() if isinstance(m, AidingUpdate) and m.source == "gnss"]
    reported = [(m.sampled_ns, m.kind) for m in updates]
    assert {kind for _, kind in reported} == {AidingKind.GNSS_POSITION, AidingKind.GNSS_VELOCITY}
    assert len(reported) == len(set(reported)) > 50


def test_with_swapped_samples_no_solution_is_published_twice() -> None:
    swapped = list(samples())
    for i in (2000, 2010, 2019, 2029):
        early, late = swapped[i], swapped[i + 1]
        swapped[i] = late.model_copy(update={"received_ns": early.received_ns})
        swapped[i + 1] = early.model_copy(update={"received_ns": late.received_ns})
    process = Process(Config(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive().lever_arm_b))))
    stamps = [m.sampled_ns for m in run([*swapped, *fixes()], process) if isinstance(m, NavigationSolution)]
    assert process.rejects["sample doubled or out of order"] == 4
    assert stamps == sorted(set(stamps)) and len(stamps) > 100


def test_fixes_without_a_position_are_counted() -> None:
    process = Process(Config())
    nothing = fix(0, fix_type=FixType.NONE, latitude_deg=None, longitude_deg=None)
    run([nothing, fix(1, fix_type=FixType.DEAD_RECKONING)], process)
    assert process.rejects["fix without position"] == 2


def test_without_inertial_samples_the_phase_is_waiting_for_imu_and_then_gnss_only() -> None:
    out = run(fixes()[:8])
    waiting, alone = NavigationPhase.WAITING_FOR_IMU, NavigationPhase.GNSS_ONLY
    assert [m.phase for m in out if isinstance(m, NavigationState)] == [waiting] * 5 + [alone] * 3
    assert [m.phase for m in out if isinstance(m, NavigationSolution)] == [alone] * 3
    stopped = run([saved(), *(m for m in samples() if m.received_ns < EPOCH_NS + 30 * 10**9), *fixes()])
    last = [m for m in stopped if isinstance(m, NavigationState)][-1]
    assert last.phase is NavigationPhase.GNSS_ONLY
    assert (last.since_ns - EPOCH_NS) * 1e-9 == pytest.approx(30.0, abs=0.02)


def test_samples_of_a_second_imu_are_rejected_while_the_first_one_sends() -> None:
    process = Process(Config())
    first, second = samples()[:10], samples()[10:20]
    spare = [m.model_copy(update={"source": "spare"}) for m in second]
    run([*first, *spare], process)
    assert process.rejects["samples of a second imu"] == 10
    later = [m.model_copy(update={"source": "spare"}) for m in samples()[300:310]]
    run(later, process)
    assert process.rejects["samples of a second imu"] == 10


def test_a_saved_position_received_late_is_kept_in_the_roll_back_of_a_late_fix() -> None:
    """Received between two fixes that are both out of sequence."""
    early, rest = samples()[:120], samples()[120:]
    process = Process(Config(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive().lever_arm_b))))
    run([*early, fix(0)], process)
    list(process.handle(saved()))
    out = run([*rest[:1600], *fixes()[1:16]], process)
    assert any(isinstance(m, NavigationSolution) for m in out)


def test_a_fix_in_two_dimensions_has_no_height_measurement() -> None:
    _, position = of_fix(fix(0, fix_type=FixType.TWO_D), Config())
    _, missing = of_fix(fix(0, height_ellipsoid_m=None), Config())
    assert getattr(position, "axes", None) == getattr(missing, "axes", None) == 2


def test_a_typo_in_the_settings_is_an_error() -> None:
    with pytest.raises(ValidationError, match="lever_arm"):
        Config().with_values({"lever_arm_m": (0.0, 0.0, 0.0)})


def test_the_process_file_does_no_mathematics() -> None:
    text = Path("services/core/fusion/process.py").read_text(encoding="utf-8")
    assert "numpy" not in text and "import math" not in text


def test_solutions_continue_when_all_stamps_go_back_by_an_hour() -> None:
    """As when a recording is replayed a second time."""
    process = Process(Config(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive().lever_arm_b))))
    first = [m for m in run([*samples(), *fixes()], process) if isinstance(m, NavigationSolution)]
    hour_ns = 3600 * 10**9
    messages: list[ImuSamples | GnssFix] = [*samples(), *fixes()]
    earlier = [
        m.model_copy(
            update={
                "received_ns": m.received_ns - hour_ns,
                "sampled_ns": tuple(t - hour_ns for t in m.sampled_ns)
                if isinstance(m, ImuSamples)
                else m.sampled_ns - hour_ns,
            }
        )
        for m in messages
    ]
    second = [m for m in run(earlier, process) if isinstance(m, NavigationSolution)]
    assert len(second) > 0.9 * len(first) > 100


CRASH_S, RESTART_S = 40.4, 42.6  # the last sample of one process, the first of the next


@cache
def last_state() -> FilterState:
    """The state that is retained when the process is killed."""
    end_ns = EPOCH_NS + CRASH_S * 1e9
    before = [*(m for m in samples() if m.received_ns < end_ns), *(m for m in fixes() if m.received_ns < end_ns)]
    states = [m for m in run([saved(), *before]) if isinstance(m, FilterState)]
    assert np.diff([m.sampled_ns for m in states]).tolist() == [10**9] * (len(states) - 1), "one a second"
    assert len(states) > 20
    return states[-1]


def after_the_crash() -> list[ImuSamples | GnssFix]:
    """Inputs of the restarted process; the first fix after a second."""
    later = [m for m in samples() if m.sampled_ns[0] > EPOCH_NS + RESTART_S * 1e9]
    return [*later, *(m for m in fixes() if m.received_ns > EPOCH_NS + (RESTART_S + 1.0) * 1e9)]


def restart(state: FilterState, config: Config | None = None) -> tuple[Process, list[Message]]:
    process = Process(config or Config(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive().lever_arm_b))))
    return process, [*process.handle(state), *run(after_the_crash(), process)]


def test_a_restarted_process_has_a_solution_at_its_first_sample() -> None:
    process, out = restart(last_state())
    solutions = [m for m in out if isinstance(m, NavigationSolution)]
    assert solutions[0].sampled_ns == after_the_crash()[0].sampled_ns[0]  # type: ignore[index]
    assert all(horizontal_error_m(m) < 3.0 * sd_m(m) for m in solutions)
    assert horizontal_error_m(solutions[-1]) < 0.6
    assert not process.rejects


@cache
def restarted_without_state() -> list[Message]:
    return run(after_the_crash())


def sd_m(solution: NavigationSolution) -> float:
    """Standard deviation of the horizontal position along its worst axis, at most."""
    nn, _, _, ee, _, _ = solution.position_cov_ned_m2
    return float(np.sqrt(nn + ee))


def test_without_a_saved_state_a_restarted_process_needs_more_than_two_seconds_to_align() -> None:
    solutions = [m for m in restarted_without_state() if isinstance(m, NavigationSolution)]
    assert not solutions or solutions[0].sampled_ns > after_the_crash()[0].sampled_ns[0] + 2 * 10**9  # type: ignore[index]


def test_a_saved_state_is_unchanged_by_encoding() -> None:
    payload = encode(last_state())
    again = decode("navigation/filter_state", payload)
    assert again == last_state() and len(payload) < 16_000
    assert isinstance(again, FilterState)
    assert restart(last_state())[1] == restart(again)[1]


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"fingerprint": "0" * 16}, "saved state of other settings"),
        ({"imu": "spare"}, "saved state of another imu"),
        ({"covariance": (1.0, 2.0)}, "saved state of another layout"),
        ({"sampled_ns": EPOCH_NS + 30 * 10**9}, "saved state too old"),
        ({"sampled_ns": EPOCH_NS + 50 * 10**9}, "saved state from the future"),
        ({"covariance": (-1.0,) * len(last_state().covariance)}, "saved state without a positive covariance"),
    ],
)
def test_a_state_that_does_not_fit_is_rejected_and_counted(changes: dict[str, object], reason: str) -> None:
    process, out = restart(last_state().model_copy(update=changes))
    assert process.rejects[reason] == 1
    assert out == restarted_without_state()


def test_a_state_saved_with_another_lever_arm_is_rejected() -> None:
    config = Config(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=(0.0, 0.0, 0.0))))
    assert restart(last_state(), config)[0].rejects["saved state of other settings"] == 1


def test_a_running_process_ignores_saved_states() -> None:
    """It receives those that it publishes itself."""
    messages = [saved(), *samples(), *fixes()]
    process = Process(Config(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive().lever_arm_b))))
    out: list[Message] = []
    for message in sorted(messages, key=lambda m: getattr(m, "received_ns", 0)):
        for published in run([message], process):
            out += [published, *(run([published], process) if isinstance(published, FilterState) else ())]
    assert out == standard_run()


def test_a_fix_received_before_the_newest_samples_does_not_report_a_missing_imu() -> None:
    process = Process(Config())
    newest = samples()[100]
    early = fix(0, received_ns=newest.received_ns - 40_000_000)
    reports = [m for message in (newest, early) for m in process.handle(message) if isinstance(m, NavigationState)]
    assert NavigationPhase.WAITING_FOR_IMU not in [report.phase for report in reports]


@pytest.mark.parametrize(
    ("found", "position_s", "beyond_s"),
    [
        ((0.0, 0.0), None, None),
        ((0.6, 0.6), 0.6, None),
        ((0.5, 0.75), 0.5, 0.25),
        ((0.0, 0.25), None, 0.25),
        ((0.25, 0.0), 0.25, -0.25),
    ],
)
def test_the_state_tells_delays_that_were_found(
    found: tuple[float, float], position_s: float | None, beyond_s: float | None
) -> None:
    navigator = Navigator(Config())
    navigator.correct_delay(*found)
    state = state_message(navigator, EPOCH_NS, delay_known=False)
    assert (state.gnss_delay_s, state.gnss_velocity_delay_s) == (position_s, beyond_s)


def test_what_an_earlier_process_held_is_held_by_the_first_filter_and_a_closed_record_holds_nothing() -> None:
    bounds = []
    for held_m in ((30.0, -40.0, 2.0, 1.0, 2.0, 5.0, 6.0), ()):
        process = Process(Config())
        record = ConflictRecord(sampled_ns=EPOCH_NS - 10**9, held_m=held_m, growth_m_s=(1.0, 0.0))
        assert list(process.handle(record)) == []
        states: list[NavigationState] = []
        arriving: list[ImuSamples | GnssFix] = [*samples(20), *fixes()]
        for message in sorted(arriving, key=lambda item: item.received_ns):
            states += [
                navigation_state
                for navigation_state in process.handle(message)
                if isinstance(navigation_state, NavigationState)
            ]
        assert states[-1].phase is NavigationPhase.NAVIGATING
        bounds.append(states[-1].held_horizontal_m)
    assert bounds[0] >= 55.0, "with the growth since then"
    assert bounds[1] == 0.0


def test_a_record_that_comes_later_is_of_this_process_and_changes_nothing() -> None:
    process = Process(Config())
    list(process.handle(samples(20)[0]))
    list(process.handle(ConflictRecord(sampled_ns=EPOCH_NS, held_m=(30.0, -40.0, 2.0, 1.0, 2.0, 5.0, 6.0))))
    assert process._navigator.engine.remembered is None
