import math
import struct
from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from services.parsers.imu.process import Config, Process
from services.parsers.imu.xsens import inertial_data
from shared.errors import ConfigError
from shared.messages.gnss import GnssRaw
from shared.messages.imu import ImuRaw, ImuSamples
from shared.protocols import xbus
from shared.runtime.config import parse_vehicle
from tests.support.data import recording

NS = 1_000_000_000
Rows = tuple[tuple[float, float, float], ...]
START_NS = 1_764_000_000 * NS
FLAT = {xbus.ACCELERATION: (0.1, 0.2, 9.8), xbus.RATE_OF_TURN: (0.01, 0.02, 0.03)}


def frame(number: int, fields: Mapping[int, tuple[float, ...]] = FLAT, *, period_ticks: int = 100) -> bytes:
    """A measurement with its packet counter and its sample time."""
    everything = {
        xbus.PACKET_COUNTER: (number % 65536,),
        xbus.SAMPLE_TIME_FINE: (number * period_ticks % 2**32,),
        **fields,
    }
    return xbus.encode_mtdata2({kind: xbus.encode_field(kind, *values) for kind, values in everything.items()})


def feed(process: Process, data: bytes, at_s: float = 0.0, source: str = "imu0") -> list[ImuSamples]:
    return list(process.handle(ImuRaw(received_ns=START_NS + round(at_s * NS), source=source, data=data)))


def drive(process: Process, frames: Mapping[int, bytes]) -> list[ImuSamples]:
    """Feed frames by their number, each 5 ms after its sample time."""
    return [message for k, data in frames.items() for message in feed(process, data, k * 0.01 + 0.005)]


def mounted(rows: Rows) -> Config:
    """Settings of the parser in a vehicle with this mounting."""
    text = f"[vehicle.imu]\nbody_from_sensor = {[list(row) for row in rows]}"
    return parse_vehicle(text, "car.toml").section("parsers.imu", Config)


def test_a_horizontally_mounted_tracker_gives_forward_right_down() -> None:
    (message,) = feed(Process(Config()), frame(1))
    assert message.specific_force_body_m_s2[0] == pytest.approx((0.1, -0.2, -9.8), rel=1e-6)
    assert message.angular_rate_body_rad_s[0] == pytest.approx((0.01, -0.02, -0.03), rel=1e-6)
    assert (message.source, message.saturated) == ("imu0", False)


def test_a_mounting_rotates_vectors_as_scipy_does() -> None:
    mounting = Rotation.from_euler("xyz", [0.1, -0.2, 2.0]).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    rows = tuple((x, y, z) for x, y, z in np.round(mounting, 7).tolist())
    (message,) = feed(Process(mounted(rows)), frame(1))
    assert message.specific_force_body_m_s2[0] == pytest.approx(mounting @ (0.1, 0.2, 9.8), abs=1e-5)


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        (((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)), "mirrors the axes"),
        (((1.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 2.0)), "perpendicular"),
        (((1.0, 0.0, 0.0), (0.5, 0.866025, 0.0), (0.0, 0.0, 1.0)), "perpendicular"),
    ],
)
def test_a_matrix_that_is_not_a_rotation_is_rejected(rows: Rows, reason: str) -> None:
    with pytest.raises(ConfigError, match=rf"car\.toml: \[vehicle(\.imu)?\] .*{reason}"):
        mounted(rows)


def test_samples_of_one_chunk_are_published_in_one_message() -> None:
    (message,) = feed(Process(Config()), frame(1) + frame(2) + frame(3))
    assert np.diff(message.sampled_ns).tolist() == pytest.approx([10e6] * 2, abs=100)
    assert message.sampled_ns[-1] == START_NS - 3_000_000
    assert len(message.specific_force_body_m_s2) == 3


def test_a_frame_received_in_parts_is_stamped_with_its_last_part() -> None:
    process = Process(Config(minimum_delay_s=0.0))
    data = frame(1)
    assert not feed(process, data[:20], 1.0)
    (message,) = feed(process, data[20:], 1.001)
    assert message.sampled_ns == (START_NS + 1_001_000_000,)


def test_stamps_follow_the_clock_of_the_tracker() -> None:
    process, rng = Process(Config(minimum_delay_s=0.003)), np.random.default_rng(1)
    errors_ms = []
    for k in range(3000):
        true_s = k * 0.01 * (1 + 30e-6)
        for message in feed(process, frame(k), true_s + 0.003 + rng.exponential(0.003)):
            errors_ms.append((message.sampled_ns[0] - START_NS) * 1e-6 - true_s * 1e3)
    assert len(errors_ms) == 3000
    assert np.abs(errors_ms[500:]).max() < 0.6


def test_stamps_are_continuous_at_the_wrap_of_the_sample_time() -> None:
    process = Process(Config())
    first = 2**32 // 100 - 5  # the counter wraps between the sixth and the seventh sample
    messages = drive(process, {k: frame(first + k) for k in range(20)})
    stamps = [message.sampled_ns[0] for message in messages]
    assert np.diff(stamps).tolist() == pytest.approx([10e6] * 19, abs=0.1e6)
    assert not process.rejects


def test_lost_packets_are_counted_over_the_wrap_of_their_counter() -> None:
    process = Process(Config())
    drive(process, {k: frame(65530 + k) for k in range(20) if k not in (3, 9, 10)})
    assert process.rejects == {"packet_gap": 3}


def test_samples_continue_after_a_restart_of_the_tracker() -> None:
    process = Process(Config())
    drive(process, {k: frame(30000 + k) for k in range(300)})
    messages = [m for k in range(300) for m in feed(process, frame(k), 10 + k * 0.01 + 0.005)]
    assert len(messages) == 300
    assert process.rejects == {"counter_restart": 1}
    assert messages[-1].sampled_ns[0] == pytest.approx(START_NS + 12.992 * NS, abs=1e6)


@pytest.mark.parametrize("bit", range(8, 14))
def test_a_clipped_axis_sets_saturated(bit: int) -> None:
    (message,) = feed(Process(Config()), frame(1, {**FLAT, xbus.STATUS_WORD: (1 << bit,)}))
    assert message.saturated


def test_a_clipped_magnetometer_does_not_set_saturated() -> None:
    (message,) = feed(Process(Config()), frame(1, {**FLAT, xbus.STATUS_WORD: (0b111 << 14,)}))
    assert not message.saturated


def test_slow_quantities_have_si_units_and_may_be_sent_separately() -> None:
    slow = {xbus.TEMPERATURE: (25.0,), xbus.BARO_PRESSURE: (101_325,), xbus.MAGNETIC_FIELD: (0.3, 0.4, 0.5)}
    process = Process(Config())
    feed(process, frame(0))
    assert not feed(process, frame(1, slow))
    (message,) = feed(process, frame(2))
    assert message.temperature_k == pytest.approx(298.15)
    assert message.pressure_pa == 101_325
    assert message.magnetic_field_body == pytest.approx((0.3, -0.4, -0.5))
    assert not process.rejects
    (later,) = feed(process, frame(3), 0.01)
    assert (later.temperature_k, later.magnetic_field_body) == (None, None)


@pytest.mark.parametrize(
    ("fields", "kind"),
    [
        ({xbus.ACCELERATION: (math.nan, 0, 0), xbus.RATE_OF_TURN: (0, 0, 0)}, "not_finite"),
        ({xbus.ACCELERATION: (0, 0, 0), xbus.RATE_OF_TURN: (math.inf, 0, 0)}, "not_finite"),
        ({xbus.ACCELERATION: (1e6, 0, 0), xbus.RATE_OF_TURN: (0, 0, 0)}, "out_of_range"),
        ({xbus.ACCELERATION: (0, 0, 0), xbus.RATE_OF_TURN: (0, -500, 0)}, "out_of_range"),
        ({xbus.RATE_OF_TURN: (0, 0, 0)}, "no_acceleration"),
        ({xbus.ACCELERATION: (0, 0, 9.8)}, "no_rate_of_turn"),
    ],
)
def test_an_invalid_sample_is_counted_and_its_neighbours_are_kept(
    fields: dict[int, tuple[float, ...]], kind: str
) -> None:
    process = Process(Config())
    (message,) = feed(process, frame(1) + frame(2, fields) + frame(3))
    assert len(message.sampled_ns) == 2
    assert process.rejects == {kind: 1}


@pytest.mark.parametrize(("field", "kind"), [((math.nan, 0, 0), "not_finite"), ((1e308, 1e308, 0), "out_of_range")])
def test_an_invalid_magnetic_field_is_counted_and_the_sample_is_published(field: tuple[float, ...], kind: str) -> None:
    process = Process(Config())
    double = 3  # the number format with double precision
    fields = {key | double * (key == xbus.MAGNETIC_FIELD): v for key, v in {**FLAT, xbus.MAGNETIC_FIELD: field}.items()}
    (message,) = feed(process, frame(1, fields))
    assert message.magnetic_field_body is None
    assert process.rejects == {kind: 1}


def test_a_sample_without_a_time_and_one_that_is_repeated_are_counted() -> None:
    process = Process(Config())
    untimed = xbus.encode_mtdata2({kind: xbus.encode_field(kind, *values) for kind, values in FLAT.items()})
    feed(process, untimed + frame(1) + frame(1, period_ticks=100))
    assert process.rejects["no_sample_time"] == 1
    assert process.rejects["repeated_sample"] == 1


def test_increments_are_used_if_rates_are_missing() -> None:
    turn = Rotation.from_rotvec([0.01, -0.02, 0.03])
    x, y, z, w = turn.as_quat().tolist()
    for sign in (1, -1):  # both quaternions are the same rotation
        values = {xbus.DELTA_V: (0.1, 0.0, 0.098), xbus.DELTA_Q: (sign * w, sign * x, sign * y, sign * z)}
        force, rate = inertial_data(values, 0.01)
        assert force == pytest.approx((10.0, 0.0, 9.8))
        assert rate == pytest.approx((1.0, -2.0, 3.0))
    assert inertial_data({xbus.DELTA_V: (0, 0, 0), xbus.DELTA_Q: (1, 0, 0, 0)}, 0.01)[1] == (0, 0, 0)


def test_the_first_increments_are_rejected_for_lack_of_an_interval() -> None:
    process = Process(Config())
    fields = {xbus.DELTA_V: (0.0, 0.0, 0.098), xbus.DELTA_Q: (1.0, 0.0, 0.0, 0.0)}
    messages = drive(process, {k: frame(k, fields) for k in range(1, 4)})
    assert [message.specific_force_body_m_s2[0][2] for message in messages] == pytest.approx([-9.8] * 2)
    assert process.rejects == {"no_acceleration_and_rate_of_turn": 1}


def test_a_tracker_that_sends_no_inertial_data_is_told_what_is_missing() -> None:
    process = Process(Config())
    assert not feed(process, b"".join(frame(k, {xbus.QUATERNION: (1.0, 0.0, 0.0, 0.0)}) for k in range(5)))
    assert process.rejects == {"no_acceleration_and_rate_of_turn": 5}
    (kind,) = process.kinds.table()
    assert (kind.kind, kind.count, kind.rejected) == ("Xbus MTData2", 5, 5)
    assert kind.reason == "no_acceleration_and_rate_of_turn"


def test_other_messages_are_ignored_and_excess_sources_are_rejected() -> None:
    process = Process(Config())
    assert not list(process.handle(GnssRaw(received_ns=1, source="x", data=frame(1))))
    for k in range(10):
        feed(process, b"x", source=f"imu{k}")
    assert process.rejects["too_many_sources"] == 2


@given(st.lists(st.one_of(st.binary(max_size=50), st.sampled_from([frame(5), frame(6)[:-1], frame(7)])), max_size=10),
       st.integers(1, 90))  # fmt: skip
def test_a_sample_after_invalid_bytes_is_decoded(parts: list[bytes], size: int) -> None:
    process, stream = Process(Config()), b"".join(parts)
    for i in range(0, len(stream), size):
        feed(process, stream[i : i + size], i * 1e-4)
    found = [message for k in range(100, 103) for message in feed(process, frame(k), 100.0 + k * 0.01)]
    assert found[-1].specific_force_body_m_s2[-1] == pytest.approx((0.1, -0.2, -9.8), rel=1e-6)


@given(st.binary(max_size=100))
def test_any_payload_is_parsed_or_counted(payload: bytes) -> None:
    feed(Process(Config()), xbus.encode_message(xbus.MTDATA2, payload))


@pytest.mark.recording
@pytest.mark.parametrize("number", ["1", "3"])
def test_a_recorded_tracker_at_standstill_measures_gravity_and_zero_rate(number: str) -> None:
    process, data = Process(Config()), (recording(f"xsens_xbus/{number}/output.bin")).read_bytes()
    messages = [m for i in range(0, len(data), 150) for m in feed(process, data[i : i + 150], i / 150 * 0.01)]
    forces = np.array([force for m in messages for force in m.specific_force_body_m_s2])
    rates = np.array([rate for m in messages for rate in m.angular_rate_body_rad_s])
    assert len(forces) == 96  # the first four measurements of the recording hold no inertial data
    assert np.linalg.norm(forces[5:], axis=1) == pytest.approx(np.full(91, 9.79), abs=0.05)
    assert np.abs(rates).max() < 0.02
    assert not process.rejects


def test_the_sample_time_is_counted_in_tenths_of_a_millisecond() -> None:
    assert struct.unpack(">I", xbus.encode_field(xbus.SAMPLE_TIME_FINE, 100))[0] == 100
    process = Process(Config())
    messages = drive(process, {k: frame(k, period_ticks=100) for k in range(5)})
    assert messages[-1].sampled_ns[0] - messages[0].sampled_ns[0] == pytest.approx(40e6, abs=1e6)
