"""Each attack as the parsers and least squares read it. The noise of a seed is the same with and without an attack,
so that the difference of two drives is what the attack does."""

from itertools import pairwise
from math import cos, hypot, radians, sin

import numpy as np
import pytest

from services.core.cooperative.measurements import Constellation, SatelliteId
from services.parsers.imu.process import Config as ImuConfig
from services.parsers.imu.process import Process as ImuProcess
from services.sensors.simulator.attacks.effects import drift
from services.sensors.simulator.scenarios import BY_NAME
from services.sensors.simulator.world import DEFAULT_START_NS, World, messages
from shared.attacks import ScheduledAttack, schedule
from shared.maths.earth import ned_from_geodetic_difference
from shared.maths.gnss_signals import SPEED_OF_LIGHT
from shared.messages.base import Vector3
from shared.messages.gnss import FixType, GnssFix
from shared.messages.imu import ImuRaw, ImuSamples
from shared.messages.simulation import AttackCommand, AttackName, SimulationAttack, SimulationState
from tests.support.cases import each
from tests.support.drives.attacked_drive import NS, Drive, attacked, place, seconds

START_S, END_S = 33.0, 48.0
CONSISTENT = [
    "static_replay", "straight_replay", "replay_drive", "delay", "position_jump", "drag_off", "climb", "time_push",
    "satellite_step", "satellite_ramp", "satellite_step(satellites=2)", "stopwatch(rise=5)", "coherent_scale(rise=5)",
    "cold_start", "staircase(period=4)", "intermittent(on=2,off=3)", "drag_hold", "clock_drift", "utc_drift",
    "accuracy_lie", "masked_drag", "few_satellites", "subset",
]  # fmt: skip


def during(text: str) -> Drive:
    return attacked(f"{text}@{START_S:g}:{END_S - START_S:g}")


def both(drive: Drive, begin_s: float = START_S, end_s: float = END_S) -> list[tuple[GnssFix, GnssFix]]:
    """Fixes of the attacked drive with those of the same epochs without an attack."""
    assert len(drive.fixes) == len(attacked().fixes)
    pairs = zip(drive.fixes, attacked().fixes, strict=True)
    return [(a, b) for a, b in pairs if begin_s <= seconds(b.sampled_ns) < end_s]


def moved(fix: GnssFix, clean: GnssFix) -> tuple[np.ndarray, np.ndarray]:
    """Position [m, NED] and velocity [m/s, NED] of a fix minus those of another."""
    assert fix.velocity_ned_m_s is not None and clean.velocity_ned_m_s is not None
    offset_n = ned_from_geodetic_difference(place(fix), place(clean))
    return np.array(offset_n), np.subtract(fix.velocity_ned_m_s, clean.velocity_ned_m_s)


def heading_at_the_start() -> float:
    """Heading at the first epoch of an attack."""
    begin_ns = attacked().between(START_S, END_S)[0].sampled_ns
    return next(t.yaw_rad for t in attacked().truth if t.sampled_ns >= begin_ns and t.yaw_rad is not None)


@each("text", CONSISTENT)
def test_least_squares_of_the_measurements_are_the_fix_under_attack(text: str) -> None:
    """Within 2 cm/s, as the range-rate leaves out the change of the flight time, and 5 mm; a satellite fault of 50 m
    moves the height by tens of metres, over which the delay of the troposphere varies by centimetres."""
    solved = list(during(text).solved(START_S - 4.0, END_S + 4.0))
    assert len(solved) > 20
    for item in solved:
        tolerance = 0.1 if text.startswith(("satellite", "subset")) else 5e-3
        assert item.position_n == pytest.approx(np.zeros(3), abs=tolerance), item.t_s
        assert item.velocity_n == pytest.approx(np.zeros(3), abs=2e-2), item.t_s


@pytest.mark.parametrize(
    "text", ["straight_replay", "replay_drive", "drag_off", "climb", "masked_drag", "stopwatch(share=0.3,rise=5)"]
)
def test_velocity_is_the_derivative_of_position_during_a_drift(text: str) -> None:
    """The mean of two velocities times 1 s is the step of position, up to noise of 0.25 m and curvature."""
    fixes = during(text).between(START_S + 1.0, END_S)
    assert len(fixes) > 10
    for a, b in pairwise(fixes):
        assert a.velocity_ned_m_s is not None and b.velocity_ned_m_s is not None
        step = ned_from_geodetic_difference(place(b), place(a))
        assert step == pytest.approx(np.add(a.velocity_ned_m_s, b.velocity_ned_m_s) / 2.0, abs=2.5)


@pytest.mark.parametrize("direction", [0.0, 90.0])
def test_a_drag_off_accelerates_to_its_final_speed(direction: float) -> None:
    drive = during(f"drag_off(accel=0.3,speed=3,direction={direction:g})")
    pairs = both(drive)
    angle = heading_at_the_start() + radians(direction)
    axis = np.array([cos(angle), sin(angle), 0.0])
    first_s = seconds(pairs[0][0].sampled_ns)
    for fix, clean in pairs:
        t = seconds(fix.sampled_ns) - first_s
        distance, speed = (0.15 * t * t, 0.3 * t) if t < 10.0 else (15.0 + 3.0 * (t - 10.0), 3.0)
        offset_n, velocity_n = moved(fix, clean)
        assert offset_n == pytest.approx(distance * axis, abs=0.25)
        assert velocity_n == pytest.approx(speed * axis, abs=0.02)
    assert distance > 20.0


def test_a_climb_moves_height_and_vertical_velocity_alone() -> None:
    for fix, clean in both(during("climb(accel=0.5,speed=2)"), END_S - 5.0):
        offset_n, velocity_n = moved(fix, clean)
        assert offset_n[:2] == pytest.approx(np.zeros(2), abs=0.02)
        assert -30.0 < offset_n[2] < -15.0
        assert velocity_n == pytest.approx(np.array([0.0, 0.0, -2.0]), abs=2e-3)


def test_a_jump_moves_the_position_and_leaves_the_velocity() -> None:
    for fix, clean in both(during("position_jump(distance=100)")):
        offset_n, velocity_n = moved(fix, clean)
        assert hypot(*offset_n[:2]) == pytest.approx(100.0, abs=0.02)
        assert velocity_n == pytest.approx(np.zeros(3), abs=2e-3)


def aside_m(drive: Drive, begin_s: float = START_S, end_s: float = END_S) -> list[float]:
    """Distance from the clean fix at each epoch with a fix [m]."""
    pairs = [pair for pair in both(drive, begin_s, end_s) if pair[0].fix_type is FixType.THREE_D]
    for fix, clean in pairs:
        assert moved(fix, clean)[1] == pytest.approx(np.zeros(3), abs=2e-3), "the velocity is that of the vehicle"
    return [round(hypot(*moved(*pair)[0][:2]), 1) for pair in pairs]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("cold_start(distance=50)", [50.0] * 15),
        ("staircase(distance=8,period=5)", [8.0] * 5 + [16.0] * 5 + [24.0] * 5),
        ("intermittent(distance=12,on=2,off=3)", [12.0, 12.0, 0.0, 0.0, 0.0] * 3),
        ("tunnel_return(gap=5,distance=80)", [80.0] * 9),  # 15 s, without the gap and acquisition
        ("ratchet(distance=4,period=7,gap=2)", [4.0] * 4 + [8.0] * 4),
    ],
)
def test_a_position_aside_follows_its_pattern(text: str, expected: list[float]) -> None:
    assert aside_m(during(text)) == pytest.approx(expected, abs=0.1)


def test_a_cold_start_is_aside_from_the_first_epoch_on_and_true_after_it() -> None:
    drive = attacked("cold_start(distance=50)@0:20")
    assert set(aside_m(drive, 0.0, 20.0)) == {50.0}
    assert aside_m(drive, 21.0, 30.0) == pytest.approx([0.0] * 9)


def test_signals_return_beside_the_vehicle_as_it_is_headed_then() -> None:
    pairs = both(during("tunnel_return(gap=5,distance=80)"))
    first = next(k for k, (fix, _) in enumerate(pairs) if fix.fix_type is FixType.THREE_D)
    (fix, clean), returned_ns = pairs[first], pairs[5][1].sampled_ns
    at_return = next(t.yaw_rad for t in attacked().truth if t.sampled_ns >= returned_ns)
    assert at_return is not None
    axis = np.array([cos(at_return + radians(90.0)), sin(at_return + radians(90.0)), 0.0])
    assert moved(fix, clean)[0] == pytest.approx(80.0 * axis, abs=4.0)


def test_a_drag_hold_shows_a_share_of_its_drift_in_the_velocity() -> None:
    pairs = both(during("drag_hold(speed=2,share=0.25)"))
    first_s = seconds(pairs[0][0].sampled_ns)
    for fix, clean in pairs:
        offset_n, velocity_n = moved(fix, clean)
        assert np.linalg.norm(offset_n) == pytest.approx(2.0 * (seconds(fix.sampled_ns) - first_s), abs=0.05)
        assert np.linalg.norm(velocity_n) == pytest.approx(0.5, abs=2e-3)


@pytest.mark.parametrize(
    ("text", "slip"), [("stopwatch(share=0.2,rise=0)", -0.2), ("coherent(factor=1.1,rise=0)", 0.1)]
)
def test_a_drive_that_goes_by_at_another_speed_scales_velocity_and_the_way(text: str, slip: float) -> None:
    drive = during(text.replace("coherent(", "coherent_scale("))
    pairs, way = both(drive), np.zeros(3)
    for (fix, clean), (_, before) in zip(pairs[1:], pairs, strict=False):
        assert clean.velocity_ned_m_s is not None and before.velocity_ned_m_s is not None
        way += slip * 0.5 * np.add(clean.velocity_ned_m_s, before.velocity_ned_m_s)
        offset_n, velocity_n = moved(fix, clean)
        assert velocity_n == pytest.approx(np.multiply(slip, clean.velocity_ned_m_s), abs=0.05), "velocities have noise"
        assert offset_n == pytest.approx(way, abs=0.4)
    scaled = 1.0 + (slip if "coherent" in text else 0.0)
    for a, b in zip(drive.wheels, attacked().wheels, strict=True):
        if START_S + 0.1 < seconds(a.sampled_ns) < END_S - 0.1:
            assert a.rear_left_m_s == pytest.approx(scaled * (b.rear_left_m_s or 0.0), abs=0.01)


def test_a_slow_drive_falls_back_gradually() -> None:
    drive = during("stopwatch(share=0.2,rise=10)")
    for fix, clean in both(drive):
        assert clean.velocity_ned_m_s is not None
        share = 0.2 * min(1.0, (seconds(fix.sampled_ns) - START_S) / 10.0)
        expected = np.multiply(-share, clean.velocity_ned_m_s)
        assert moved(fix, clean)[1] == pytest.approx(expected, abs=0.2), "within the first epoch of its start"


def test_a_clock_drift_delays_all_signals_more_and_more_and_moves_nothing() -> None:
    drive = during("clock_drift(rate=50)")
    clean = {round(solved.t_s): solved for solved in attacked().solved(START_S, END_S)}
    solved = list(drive.solved(START_S, END_S))
    for item in solved:
        late_m = SPEED_OF_LIGHT * 50e-9 * (item.t_s - solved[0].t_s)
        assert item.clock_m - clean[round(item.t_s)].clock_m == pytest.approx(late_m, abs=0.01)
        assert item.drift_m_s - clean[round(item.t_s)].drift_m_s == pytest.approx(SPEED_OF_LIGHT * 50e-9, abs=0.01)
    assert max(float(np.linalg.norm(moved(*pair)[0])) for pair in both(drive)) < 1e-3


def test_a_utc_drift_runs_away_by_its_rate() -> None:
    late = [(fix.utc_ns or 0) - (clean.utc_ns or 0) for fix, clean in both(during("utc_drift(rate=4)"))]
    assert late == [4_000_000 * k for k in range(len(late))]


def test_a_receiver_states_other_accuracies_than_it_has() -> None:
    for fix, clean in both(during("accuracy_lie(accuracy=100)")):
        assert fix.position_sd_ned_m == pytest.approx((100.0 / 2**0.5, 100.0 / 2**0.5, 150.0), rel=1e-3)
        assert moved(fix, clean)[0] == pytest.approx(np.zeros(3), abs=1e-6)
    masked = both(during("masked_drag(deviation=1.2)"))
    assert all(fix.velocity_sd_ned_m_s == pytest.approx((1.2, 1.2, 1.2), rel=1e-3) for fix, _ in masked)
    assert hypot(*moved(*masked[-1])[0][:2]) > 20.0


def test_few_satellites_of_one_constellation_are_left_on_one_side() -> None:
    drive = during("few_satellites(satellites=4)")
    left = [
        [satellite for satellite in sky.satellites if satellite.used] for sky in drive.skies
        if START_S < seconds(sky.sampled_ns) < END_S
    ]  # fmt: skip
    assert len(left) > 10 and all(len(used) == 4 for used in left)
    assert len({(satellite.constellation, satellite.number) for used in left for satellite in used}) == 4, (
        "the same all the time"
    )
    assert len({satellite.constellation for satellite in left[0]}) == 1
    dilution = [fix.pdop for fix, _ in both(drive)]
    assert min(value or 0.0 for value in dilution) > 2.0 * max(
        gnss_fix.pdop or 0.0 for gnss_fix in attacked().between(START_S, END_S)
    )


def test_a_share_of_the_satellites_pulls_the_fix_towards_its_place() -> None:
    drive = during("subset(portion=0.6,distance=60,speed=0)")
    clean = {
        (e.sampled_ns, m.constellation, m.number): m.pseudorange_m for e in attacked().epochs for m in e.measurements
    }
    for epoch in drive.epochs:
        if START_S < seconds(epoch.sampled_ns) < END_S:
            errors = [
                (m.pseudorange_m or 0.0) - (clean[epoch.sampled_ns, m.constellation, m.number] or 0.0)
                for m in epoch.measurements
            ]
            assert 0.5 < np.mean(np.abs(errors) > 1e-3) <= 0.75 and np.max(np.abs(errors)) < 60.0
    assert all(hypot(*moved(*pair)[0][:2]) > 5.0 for pair in both(drive))
    whole = both(during("subset(portion=1,distance=60,speed=0)"))
    assert all(hypot(*moved(*pair)[0][:2]) == pytest.approx(60.0, abs=0.5) for pair in whole)


def test_static_and_straight_replay_begin_where_the_vehicle_was() -> None:
    static, straight = during("static_replay").between(START_S, END_S), during("straight_replay(speed=8)")
    for fix in static:
        assert fix.velocity_ned_m_s == pytest.approx((0.0, 0.0, 0.0), abs=0.4)
        assert ned_from_geodetic_difference(place(fix), place(static[0])) == pytest.approx((0, 0, 0), abs=2.5)
    first, *_, last = straight.between(START_S, END_S)
    step = ned_from_geodetic_difference(place(last), place(first))
    assert hypot(*step[:2]) == pytest.approx(8.0 * (seconds(last.sampled_ns) - seconds(first.sampled_ns)), abs=2.5)
    assert np.arctan2(step[1], step[0]) == pytest.approx(heading_at_the_start(), abs=0.05)
    assert ned_from_geodetic_difference(place(first), place(static[0])) == pytest.approx((0, 0, 0), abs=0.01)


def test_a_replayed_drive_is_another_motion_from_the_same_place() -> None:
    pairs = both(during("replay_drive"))
    assert moved(*pairs[0])[0] == pytest.approx(np.zeros(3), abs=0.01)
    assert max(np.linalg.norm(moved(*pair)[1]) for pair in pairs) > 2.0
    assert max(fix.ground_speed_m_s or 0.0 for fix, _ in pairs) > 3.0, "the other drive is in motion"


def test_meaconing_is_a_longer_signal_a_late_clock_and_the_place_of_the_rebroadcaster() -> None:
    drive = during("delay(distance=50,delay=2)")
    clean = {round(solved.t_s): solved for solved in attacked().solved(START_S, END_S)}
    first = both(drive)[0]
    assert hypot(*moved(*first)[0][:2]) == pytest.approx(50.0, abs=1.0)
    for solved, (fix, true) in zip(drive.solved(START_S, END_S), both(drive), strict=True):
        assert fix.velocity_ned_m_s == pytest.approx((0.0, 0.0, 0.0), abs=0.4)
        way = np.linalg.norm(moved(fix, true)[0])
        late = solved.clock_m - clean[round(solved.t_s)].clock_m
        assert late == pytest.approx(SPEED_OF_LIGHT * 2e-6 + way, abs=2.0), "[m] the noise of two fixes"
    drifts = [solved.drift_m_s for solved in drive.solved(START_S, END_S)]
    assert max(drifts) - min(drifts) > 1.0, "the clock drifts as the vehicle moves away from the rebroadcaster"


def test_a_time_push_changes_every_stated_time_and_no_position() -> None:
    drive, pushed = during("time_push(offset=7)"), 0
    for fix, clean in both(drive):
        assert fix.utc_ns is not None and clean.utc_ns is not None
        assert fix.utc_ns - clean.utc_ns == 7 * NS
        assert moved(fix, clean)[0] == pytest.approx(np.zeros(3), abs=0.02)
    for epoch, before in zip(drive.epochs, attacked().epochs, strict=True):
        if START_S <= seconds(before.sampled_ns) < END_S:
            assert epoch.gps_time_ns - before.gps_time_ns == pytest.approx(7 * NS, abs=1000), "[ns] the clock drifts"
            pushed += 1
    assert pushed > 10


@pytest.mark.parametrize("satellites", [1, 2])
def test_a_satellite_fault_moves_the_fix_by_the_pseudoinverse(satellites: int) -> None:
    """The pseudoranges of the faulty satellites alone differ by the fault; without one faulty satellite the fix of
    least squares is near the clean one, and with it as far away as the fix is."""
    drive = during(f"satellite_step(error=50,satellites={satellites})")
    clean = {
        (e.sampled_ns, m.constellation, m.number): m.pseudorange_m for e in attacked().epochs for m in e.measurements
    }
    faulty: set[SatelliteId] = set()
    for epoch in drive.epochs:
        for m in epoch.measurements:
            before = clean[epoch.sampled_ns, m.constellation, m.number]
            assert m.pseudorange_m is not None and before is not None
            error = m.pseudorange_m - before
            attack = START_S <= seconds(epoch.sampled_ns) < END_S
            assert error == pytest.approx(50.0 if error > 1.0 and attack else 0.0, abs=1e-6)
            if error > 1.0:
                faulty.add(SatelliteId(Constellation(m.constellation.value), m.number))
    assert len(faulty) == satellites
    if satellites == 1:
        (one,) = faulty
        away = [np.linalg.norm(moved(*pair)[0]) for pair in both(drive)]
        assert min(away) > 2.0
        for without, pair in zip(drive.solved(START_S, END_S, one), both(drive), strict=True):
            assert np.linalg.norm(without.position_n + moved(*pair)[0]) < 3.0, "[m] one satellite fewer"


def test_a_satellite_ramp_ends_at_its_error() -> None:
    drive = during("satellite_ramp(rate=5,error=40)")
    away = [float(np.linalg.norm(moved(*pair)[0])) for pair in both(drive)]
    assert away[0] == pytest.approx(0.0, abs=0.01)
    assert all(a < b for a, b in pairwise(away[:8]))
    assert away[-1] == pytest.approx(away[9], rel=0.05), "reached after 8 s"


def test_a_tunnel_ends_the_fix_until_it_is_acquired_again() -> None:
    drive = during("tunnel")
    assert all(fix.fix_type is FixType.NONE for fix in drive.between(START_S, END_S))
    assert all(fix.fix_type is FixType.THREE_D for fix in drive.between(END_S + 2.0, 60.0))


def test_jamming_lowers_every_signal_until_the_fix_is_lost() -> None:
    drive = during("jam(power=40,rise=4)")
    clean = {s.sampled_ns: s for s in attacked().skies}
    for sky in drive.skies:
        t = seconds(sky.sampled_ns) - START_S
        if 1.0 < t < 3.0:
            both_skies = zip(sky.satellites, clean[sky.sampled_ns].satellites, strict=True)
            fell = [b.cn0_db_hz - a.cn0_db_hz for a, b in both_skies if a.cn0_db_hz and b.cn0_db_hz]
            assert fell and fell == pytest.approx([4.0 * t] * len(fell), abs=5.1), "rounded, and from the first epoch"
            assert max(fell) - min(fell) <= 1.0
    assert drive.between(START_S, START_S + 2.0)[0].fix_type is FixType.THREE_D
    assert all(fix.fix_type is FixType.NONE for fix in drive.between(START_S + 10.0, END_S))
    assert not [e for e in drive.epochs if START_S + 10.0 < seconds(e.sampled_ns) < END_S and e.measurements]


def test_a_frozen_receiver_repeats_its_fix_while_its_measurements_go_on() -> None:
    drive = during("freeze")
    fixes = drive.between(START_S + 1.0, END_S)
    assert len({(f.latitude_deg, f.longitude_deg, f.height_ellipsoid_m, f.velocity_ned_m_s) for f in fixes}) == 1
    assert len({f.utc_ns for f in fixes}) == len(fixes)
    away = [float(np.linalg.norm(solved.position_n)) for solved in drive.solved(START_S, END_S)]
    assert max(away) > 20.0


@pytest.mark.parametrize(("text", "factor"), [("odometer_scale(factor=1.4)", 1.4), ("tyre_change", 1.05)])
def test_a_scaled_odometer_scales_wheels_and_obd(text: str, factor: float) -> None:
    drive, clean = during(text), attacked()
    for a, b in zip(drive.wheels, clean.wheels, strict=True):
        assert a.rear_left_m_s is not None and b.rear_left_m_s is not None
        inside = START_S + 0.05 < seconds(a.sampled_ns) < END_S - 0.05
        if inside or seconds(a.sampled_ns) < START_S - 0.05:
            assert a.rear_left_m_s == pytest.approx((factor if inside else 1.0) * b.rear_left_m_s, abs=0.01)
    for c, d in zip(drive.speeds, clean.speeds, strict=True):
        if START_S + 0.2 < seconds(c.sampled_ns) < END_S - 0.2:
            assert c.speed_m_s == pytest.approx(factor * d.speed_m_s, abs=0.35), "[m/s] whole km/h twice"


def test_a_frozen_odometer_keeps_its_last_speeds() -> None:
    drive = during("odometer_freeze")
    held = {
        (w.front_left_m_s, w.rear_left_m_s) for w in drive.wheels if START_S + 0.1 < seconds(w.sampled_ns) < END_S - 0.1
    }
    assert len(held) == 1
    assert len({s.speed_m_s for s in drive.speeds if START_S + 1.0 < seconds(s.sampled_ns) < END_S - 0.2}) == 1


def test_wheels_hold_zero_from_the_next_standstill_on() -> None:
    """The clean drive stands until 17 s and from 47 s on."""
    from_standstill, in_motion = attacked("wheel_zero@10:20"), attacked("wheel_zero@30:15")
    for a, b, clean in zip(from_standstill.wheels, in_motion.wheels, attacked().wheels, strict=True):
        zero = 10.0 < seconds(a.sampled_ns) < 29.9
        if zero or seconds(a.sampled_ns) > 30.1:
            assert a.rear_left_m_s == (0.0 if zero else clean.rear_left_m_s)
        assert b == clean, "it has not stood yet"
    moving = [s.speed_m_s for s in attacked().speeds if 20.0 < seconds(s.sampled_ns) < 29.0]
    assert min(moving) > 0.0
    assert {s.speed_m_s for s in from_standstill.speeds if 20.0 < seconds(s.sampled_ns) < 29.0} == {0.0}


@pytest.mark.parametrize(
    ("text", "force", "rate"),
    [
        ("gyroscope_bias(bias=0.5)", (0.0, 0.0, 0.0), (0.0, 0.0, radians(0.5))),
        ("accelerometer_bias(bias=-0.4)", (-0.4, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ],
)
def test_a_bias_of_the_imu_steps_and_ends(
    text: str, force: tuple[float, float, float], rate: tuple[float, float, float]
) -> None:
    changed = list(inertial(schedule(f"{text}@6:3")))
    for (t, f, w), (_, f0, w0) in zip(changed, inertial(), strict=True):
        active = 6.0 <= t < 9.0 - 0.005
        if active or not 5.98 < t < 9.02:
            assert np.subtract(f, f0) == pytest.approx(np.multiply(active, force), abs=1e-5)
            assert np.subtract(w, w0) == pytest.approx(np.multiply(active, rate), abs=1e-6)
    assert len(changed) > 1000


def inertial(*attacks: ScheduledAttack) -> list[tuple[float, Vector3, Vector3]]:
    """Time [s], specific force and rate of the inertial samples of 12 s, as their parser reads them."""
    parser = ImuProcess(ImuConfig())
    return [
        (seconds(sampled_ns), force, rate)
        for message in messages("parking_lot", 1, 12.0, attacks=attacks) if isinstance(message, ImuRaw)
        for block in parser.handle(message) if isinstance(block, ImuSamples)
        for sampled_ns, force, rate in zip(
            block.sampled_ns, block.specific_force_body_m_s2, block.angular_rate_body_rad_s, strict=True
        )
    ]  # fmt: skip


@pytest.mark.parametrize("text", ["drag_off@35", "satellite_step@35", "odometer_freeze@35", "jam@35:5"])
def test_the_same_seed_and_attack_give_the_same_bytes_and_nothing_changes_before_it(text: str) -> None:
    first, clean = attacked(text).raw, attacked().raw
    attacked.cache_clear()
    assert attacked(text).raw == first
    before = [m for m in first if seconds(m.received_ns) < 34.9]
    assert before == [m for m in clean if seconds(m.received_ns) < 34.9]
    assert first != clean


def test_the_state_of_the_attacks_is_published_when_one_begins_and_ends() -> None:
    states = during("jam(power=20)").states
    assert [seconds(s.sampled_ns) for s in states] == [START_S, END_S]
    (begun,), (ended,) = (s.attacks for s in states)
    assert begun.attack == "jam" and begun.parameters == {"power": 20.0, "rise": 6.0}
    assert (begun.started_ns, begun.ended_ns) == (DEFAULT_START_NS + 33 * NS, None)
    assert ended.ended_ns == DEFAULT_START_NS + 48 * NS


def commanded(*commands: tuple[float, SimulationAttack]) -> list[SimulationState]:
    """Answers of a world to commands at given times [s]."""
    world, waiting, answers = World(BY_NAME["parking_lot"], 1, DEFAULT_START_NS), list(commands), []
    for due_ns, message in world:
        if isinstance(message, SimulationState):
            answers.append(message)
        while waiting and seconds(due_ns) >= waiting[0][0]:
            world.command(waiting.pop(0)[1])
        if seconds(due_ns) > 20.0:
            return answers
    raise AssertionError


def start(name: str, request_id: str = "1", **changes: object) -> SimulationAttack:
    base = SimulationAttack(request_id=request_id, command=AttackCommand.START, attack=AttackName(name))
    return base.model_copy(update=changes)


def stop(name: AttackName | None, request_id: str = "2") -> SimulationAttack:
    return SimulationAttack(request_id=request_id, command=AttackCommand.STOP, attack=name)


def test_commands_start_and_stop_attacks_within_a_second() -> None:
    first, second = commanded((3.0, start("drag_off", parameters={"speed": 1.0})), (9.0, stop(None)))
    (run,) = first.attacks
    assert (first.request_id, first.refused) == ("1", None)
    assert 3.0 <= seconds(run.started_ns) <= 4.1 and run.ended_ns is None
    assert run.parameters == {"acceleration": 0.3, "speed": 1.0, "direction": 0.0}
    (run,) = second.attacks
    assert second.request_id == "2" and run.ended_ns is not None and 9.0 <= seconds(run.ended_ns) <= 10.1


def test_an_attack_with_a_duration_ends_by_itself_and_a_second_start_replaces_the_first() -> None:
    *_, last = commanded((3.0, start("jam", duration_s=2.0)), (4.0, start("jam", "2", duration_s=5.0)))
    a, b = last.attacks
    assert a.ended_ns == b.started_ns
    assert b.ended_ns is not None and b.ended_ns - b.started_ns == 5 * NS


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (start("drag_off", parameters={"colour": 1.0}), "drag_off has no parameter 'colour'"),
        (start("drag_off", parameters={"speed": 1e9}), "drag_off: speed must be 0.01 to 60 m/s"),
        (start("jam", attack=None), "name the attack that shall start"),
        (stop(AttackName.JAM), "jam is not active"),
    ],
)
def test_a_command_that_cannot_be_executed_is_rejected_with_its_reason(command: SimulationAttack, reason: str) -> None:
    (answer,) = commanded((3.0, command))
    assert answer.refused is not None and answer.refused.startswith(reason)
    assert not answer.attacks


def test_the_number_of_attacks_is_bounded() -> None:
    names = [name for name in AttackName if not name.startswith("neighbour")]
    *_, last = commanded(*((1.0 + 0.1 * i, start(names[i % 16], str(i))) for i in range(150)))
    assert len(last.attacks) == 32 and len(last.model_dump_json()) < 10_000


def test_a_drift_is_continuous_where_it_reaches_its_speed() -> None:
    for t in (0.0, 4.0, 9.999999, 10.0, 10.000001, 30.0):
        numeric = (drift(0.3, -3.0, t + 1e-5)[0] - drift(0.3, -3.0, max(t - 1e-5, 0.0))[0]) / (1e-5 + min(t, 1e-5))
        assert numeric == pytest.approx(drift(0.3, -3.0, t)[1], abs=1e-4)
