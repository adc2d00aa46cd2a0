"""Valid messages with values that no device sends: core.fusion raises no exception, and its memory is bounded."""

import pickle
from collections import Counter
from copy import deepcopy
from functools import cache

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from services.core.fusion.aids.devices import DEVICES, SILENCE_TIMEOUT_NS, Devices
from services.core.fusion.aids.magnetometer.settings import MagnetometerSettings
from services.core.fusion.navigator import Navigator
from services.core.fusion.process import Config, In, Process
from services.core.fusion.settings import AlignmentSettings, ImuSettings
from services.core.fusion.timeline import timeline
from services.core.fusion.timeline.timeline import HELD_LIMIT
from shared.maths.dates import END_DATE_NS
from shared.maths.earth import Geodetic
from shared.messages.base import MAX_SQUARE, MAX_VALUE, Tick
from shared.messages.gnss import CarrierSolution, FixType, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import LastPosition, NavigationPhase, NavigationSolution
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds

LATEST_NS = END_DATE_NS - 1
NOW_NS = 1_790_000_000_000_000_000
STEP_NS = 10_000_000
SIZES = [
    0.0,
    5e-324,
    2.2e-308,
    1e-160,
    1e-9,
    0.1,
    9.8,
    100.0,
    999.0,
    1e4,
    1e7,
    1e9,
    1e18,
    1.4e154,
    1e155,
    1e300,
    1.7e308,
]
EXTREMES = SIZES + [-size for size in SIZES]


def up_to(largest: float) -> st.SearchStrategy[float]:
    """Whatever the contract lets through of a number with this bound."""
    extremes = [value for value in EXTREMES if abs(value) <= largest]
    return st.one_of(st.sampled_from(extremes), st.floats(-20.0, 20.0), st.floats(-largest, largest))


anything, squares = up_to(MAX_VALUE), up_to(MAX_SQUARE)
vectors = st.tuples(anything, anything, anything)
credible = st.tuples(st.floats(-500.0, 500.0), st.floats(-500.0, 500.0), st.floats(-500.0, 500.0))
stamps = st.one_of(
    st.sampled_from([0, 1, -1, 2**61, -(2**61), LATEST_NS, -LATEST_NS, NOW_NS]),
    st.integers(-6 * 10**9, 6 * 10**9).map(lambda offset: NOW_NS + offset),
    st.integers(-LATEST_NS, LATEST_NS),
)
sources = st.one_of(st.sampled_from(["imu", "gnss", "a"]), st.text(min_size=64, max_size=64), st.text(max_size=3))


def between(least: float, most: float) -> st.SearchStrategy[float]:
    return st.one_of(
        st.sampled_from([least, most, *(x for x in EXTREMES if least <= x <= most)]), st.floats(least, most)
    )


latitudes, longitudes, lengths = between(-90.0, 90.0), between(-180.0, 180.0), between(-1e7, 1e7)
deviations = between(0.0, 1e9)
nothing = st.none()


@st.composite
def batches(draw: st.DrawFn) -> ImuSamples:
    """Samples with regular or irregular stamps and with plausible or implausible values."""
    n = draw(st.integers(1, 12))
    first, step = draw(stamps), draw(st.sampled_from([STEP_NS, 1, 0, -STEP_NS, 300_000_000, 2_000_000_000]))
    even = tuple(max(-LATEST_NS, min(LATEST_NS, first + k * step)) for k in range(n))
    triples = st.one_of(credible, vectors, st.just((0.0, 0.0, -9.8)))
    return ImuSamples(
        received_ns=draw(stamps),
        source=draw(sources),
        sampled_ns=draw(st.one_of(st.just(even), st.tuples(*[stamps] * n))),
        specific_force_body_m_s2=draw(st.tuples(*[triples] * n)),
        angular_rate_body_rad_s=draw(st.tuples(*[triples.map(lambda v: (v[0] * 0.1, v[1] * 0.1, v[2] * 0.1))] * n)),
        saturated=draw(st.booleans()),
        pressure_pa=draw(nothing | anything),
        magnetic_field_body=draw(nothing | vectors | credible),
    )


fixes = st.builds(
    GnssFix,
    sampled_ns=stamps,
    received_ns=stamps,
    source=sources,
    fix_type=st.sampled_from(FixType),
    carrier_solution=st.sampled_from(CarrierSolution),
    latitude_deg=nothing | latitudes,
    longitude_deg=nothing | longitudes,
    height_ellipsoid_m=nothing | lengths,
    velocity_ned_m_s=nothing | st.tuples(lengths, lengths, lengths) | credible,
    ground_speed_m_s=nothing | lengths,
    course_rad=nothing | anything,
    position_sd_ned_m=nothing | st.tuples(deviations, deviations, deviations),
    velocity_sd_ned_m_s=nothing | st.tuples(deviations, deviations, deviations),
    position_cov_ned_m2=nothing | st.tuples(*[squares] * 6),
    velocity_cov_ned_m2_s2=nothing | st.tuples(*[squares] * 6),
    hdop=nothing | anything,
    vdop=nothing | anything,
    baseline_heading_rad=nothing | anything,
    baseline_heading_sd_rad=nothing | deviations,
)
others = st.one_of(
    st.builds(
        LastPosition,
        sampled_ns=stamps,
        latitude_deg=latitudes,
        longitude_deg=longitudes,
        height_ellipsoid_m=lengths,
        position_sd_ned_m=st.tuples(deviations, deviations, deviations),
        yaw_rad=anything,
        yaw_sd_rad=deviations,
    ),
    st.builds(VehicleSpeed, sampled_ns=stamps, received_ns=stamps, source=sources, speed_m_s=lengths,
              resolution_m_s=nothing | anything),
    st.builds(WheelSpeeds, sampled_ns=stamps, received_ns=stamps, source=sources,
              front_left_m_s=nothing | lengths, rear_left_m_s=nothing | lengths, rear_right_m_s=nothing | lengths),
    st.builds(Tick, now_ns=stamps),
)  # fmt: skip


def sample(time_ns: int, *, source: str = "imu", count: int = 1, step_ns: int = STEP_NS) -> ImuSamples:
    """Samples at standstill whose last stamp is given."""
    return ImuSamples(
        received_ns=time_ns,
        source=source,
        sampled_ns=tuple(time_ns - (count - 1 - k) * step_ns for k in range(count)),
        specific_force_body_m_s2=tuple((0.001 * (k % 3), 0.0, -9.805) for k in range(count)),
        angular_rate_body_rad_s=tuple((1e-5 * (k % 5), 0.0, 0.0) for k in range(count)),
    )


def fix(time_ns: int, source: str = "gnss") -> GnssFix:
    return GnssFix(
        sampled_ns=time_ns,
        received_ns=time_ns,
        source=source,
        fix_type=FixType.THREE_D,
        latitude_deg=42.0,
        longitude_deg=-8.0,
        height_ellipsoid_m=100.0,
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        position_sd_ned_m=(1.0, 1.0, 1.0),
    )


def fresh() -> Process:
    return Process(
        Config(
            alignment=AlignmentSettings(levelling_s=1.0),
            magnetometer=MagnetometerSettings(enabled=True),
            imu=ImuSettings(accelerometer_scale_sd=0.01),
        )
    )


@cache
def started() -> Process:
    """Process that navigates at standstill; its newest sample has the stamp `NOW_NS`."""
    process = fresh()
    saved = LastPosition(
        sampled_ns=0, latitude_deg=42.0, longitude_deg=-8.0, height_ellipsoid_m=100.0,
        position_sd_ned_m=(1.0, 1.0, 1.0), yaw_rad=0.3, yaw_sd_rad=0.01,
    )  # fmt: skip
    send(process, saved)
    for k in range(400):
        time_ns = NOW_NS + (k - 399) * STEP_NS
        send(process, sample(time_ns))
        if k % 20 == 0:
            send(process, fix(time_ns))
    assert last_phase(process) is NavigationPhase.NAVIGATING
    return process


def send(process: Process, message: In) -> list[NavigationSolution]:
    """Handle a message; check that each output survives encoding."""
    out = list(process.handle(message))
    for item in out:
        assert type(item).model_validate_json(item.model_dump_json()) == item
    return [navigation_solution for navigation_solution in out if isinstance(navigation_solution, NavigationSolution)]


def last_phase(process: Process) -> NavigationPhase:
    return process._navigator.phase


@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(navigating=st.booleans(), messages=st.lists(st.one_of(batches(), fixes, fixes, others), min_size=1, max_size=12))
def test_any_valid_message_is_answered_with_valid_messages(navigating: bool, messages: list[In]) -> None:
    process = deepcopy(started()) if navigating else fresh()
    for message in messages:
        send(process, message)


@pytest.mark.parametrize(("latitude_deg", "height_m", "speed", "reject"), [
    (90.0, 100.0, 0.0, "position too near a pole"),
    (42.0, 1e7, 0.0, "implausible height"),
    (42.0, 100.0, 1e7, "implausible velocity"),
])  # fmt: skip
def test_implausible_fixes_are_counted_and_change_nothing(
    latitude_deg: float, height_m: float, speed: float, reject: str
) -> None:
    changes = {"latitude_deg": latitude_deg, "height_ellipsoid_m": height_m, "velocity_ned_m_s": (speed, 0.0, 0.0)}
    process = deepcopy(started())
    for k in range(1, 200):
        if k % 20 == 0:
            send(process, fix(NOW_NS + k * STEP_NS).model_copy(update=changes))
        solutions = send(process, sample(NOW_NS + k * STEP_NS))
    assert process.rejects[reject] == 9
    assert all(
        abs(solution.latitude_deg - 42.0) < 1e-5 and solution.phase is NavigationPhase.NAVIGATING
        for solution in solutions
    )
    fresh_one = fresh()
    for k in range(300):
        send(fresh_one, sample(NOW_NS + k * STEP_NS))
        send(fresh_one, fix(NOW_NS + k * STEP_NS).model_copy(update=changes))
    assert fresh_one.rejects[reject] == 300


def test_ten_thousand_samples_in_one_message_are_all_used() -> None:
    process = deepcopy(started())
    solutions = send(process, sample(NOW_NS + 10_000 * STEP_NS, count=10_000))
    assert len(solutions) == 1000, "a hundred seconds, ten solutions each"
    assert process.rejects == started().rejects


def size(process: Process) -> int:
    """Size of the pickled process [bytes]."""
    return len(pickle.dumps(process))


def test_devices_with_changing_names_take_bounded_memory() -> None:
    """Against the same messages of one device; the history of the roll-back grows in both."""
    changing, process = grown([f"{k:064d}" for k in range(1, 601)])
    steady, _ = grown(["x" * 64] * 600)
    assert changing < steady + 5_000, "200 names of 64 letters are 12,800 bytes"
    assert process.rejects["fix of a second receiver"] + process.rejects["speed of a second source"] > 1100
    assert last_phase(process) is NavigationPhase.NAVIGATING, "with the first receiver"


def grown(names: list[str]) -> tuple[int, Process]:
    """Growth of the process [bytes] by the last 200 messages of devices with these names, and the process."""
    process, before = deepcopy(started()), 0
    for k, name in enumerate(names, 1):
        time_ns = NOW_NS + k * STEP_NS
        send(process, fix(time_ns, name))
        send(process, VehicleSpeed(sampled_ns=time_ns, received_ns=time_ns, source=name, speed_m_s=0.0))
        if k % 20 == 0:
            send(process, fix(time_ns))
        send(process, sample(time_ns))
        if k == len(names) - 200:
            before = size(process)
    return size(process) - before, process


def test_a_renamed_receiver_is_accepted_once_its_old_names_were_silent_for_an_hour() -> None:
    """An hour by the stamps of the samples; two hundred names in a drive of weeks take the memory of 32."""
    rejects: Counter[str] = Counter()
    now = [0]
    devices = Devices(rejects, lambda: now[0])
    for k in range(200):
        now[0] = k * SILENCE_TIMEOUT_NS // 30
        assert devices.is_due("imu", "pressure", now[0], 1000)
        assert devices.is_known(f"gnss {k}") and devices.is_due(f"gnss {k}", "speed", now[0], 1000)
        assert len(devices) <= DEVICES
    assert not rejects
    for k in range(DEVICES):
        devices.is_known(f"other {k}")
    assert rejects["too many devices"] > 0 and not devices.is_known("one too many")
    now[0] += SILENCE_TIMEOUT_NS + 1
    assert devices.is_known("one too many")


def test_of_samples_one_nanosecond_apart_a_bounded_number_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timeline, "MAX_PENDING", 2_000)
    monkeypatch.setattr(timeline, "MAX_SAMPLES", 5_000)
    process, sizes = deepcopy(started()), []
    for k in range(1, 30):
        send(process, sample(NOW_NS + k * 1000, count=1000, step_ns=1))
        sizes.append(process._navigator._timeline.log.size)
    assert max(sizes) < 9_000 < sum([1000] * 29)


def test_fixes_far_ahead_of_the_samples_are_rejected() -> None:
    process, ahead_ns = deepcopy(started()), LATEST_NS - 10**9
    for k in range(1, 50):
        send(process, fix(NOW_NS + k * STEP_NS).model_copy(update={"sampled_ns": ahead_ns, "received_ns": ahead_ns}))
    later = sample(NOW_NS + 10 * STEP_NS).model_copy(update={"received_ns": LATEST_NS})
    send(process, later)
    assert process.rejects["fix from the future"] == 49
    send(process, sample(NOW_NS + 11 * STEP_NS))
    assert last_phase(process) is NavigationPhase.NAVIGATING


def test_the_number_of_waiting_measurements_is_bounded() -> None:
    navigator = Navigator()
    for k in range(5000):
        navigator.fix(NOW_NS + k, position=Geodetic(0.8, 0.2, 300.0), received_ns=NOW_NS)
    assert navigator.rejects["held without inertial samples"] == 5000 - HELD_LIMIT
