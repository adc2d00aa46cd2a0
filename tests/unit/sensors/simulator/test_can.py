from math import radians
from pathlib import Path

import cantools
import numpy as np
import pytest
from cantools.database.can import Database

from services.sensors.simulator.attacks.signals import Odometer
from services.sensors.simulator.can.can_bus import CanBus
from services.sensors.simulator.can.can_frames import line, speed_request, speed_response, wheel_frame, wheel_speeds
from services.sensors.simulator.motion.trajectory import Motion
from services.sensors.simulator.scenarios import BY_NAME
from services.sensors.simulator.vehicle import Vehicle
from shared.messages.vehicle import CanRaw

ROOT = Path(__file__).parents[4]
START_NS = 1_790_000_000_000_000_000
STEP_NS = 10_000_000


@pytest.fixture(scope="module")
def database() -> Database:
    loaded = cantools.database.load_file(ROOT / "deploy" / "vehicles" / "simulated.dbc")
    assert isinstance(loaded, Database)
    return loaded


@pytest.fixture(scope="module")
def drive() -> tuple[list[CanRaw], Motion]:
    vehicle, can = (
        Vehicle(BY_NAME["parking_lot"], 1, 0.01),
        CanBus(1, START_NS, np.random.default_rng(1), lambda _: Odometer()),
    )
    motions = [vehicle.advance(100).motion for _ in range(60)]
    batches: list[CanRaw] = []
    for second, motion in enumerate(motions):
        begin_ns = START_NS + second * 10**9
        for due_ns, message in can.transmit(motion, begin_ns, begin_ns + 10**9):
            assert isinstance(message, CanRaw)
            assert message.received_ns == due_ns
            batches.append(message)
    return batches, Vehicle(BY_NAME["parking_lot"], 1, 0.01).advance(6000).motion


def frames(batches: list[CanRaw], identifier: int) -> list[tuple[int, bytes]]:
    found = []
    for batch in batches:
        for text in batch.data.decode().splitlines():
            stamp, channel, frame = text.split(" ")
            seconds, microseconds = stamp.strip("()").split(".")
            name, data = frame.split("#")
            assert channel == "can0"
            if int(name, 16) == identifier:
                found.append((int(seconds) * 10**9 + int(microseconds) * 1000, bytes.fromhex(data)))
    return found


def test_wheel_speeds_are_decoded_by_the_dbc_file(database: Database) -> None:
    values = database.decode_message("WheelSpeeds", wheel_frame((10.0, 10.5, 0.0, 33.333)))
    assert values == pytest.approx({
        "WheelSpeedFrontLeft": 36.0,
        "WheelSpeedFrontRight": 37.8,
        "WheelSpeedRearLeft": 0.0,
        "WheelSpeedRearRight": 120.0,
    }, abs=0.0051)  # fmt: skip


@pytest.mark.parametrize(("km_h", "byte"), [(0.0, 0), (0.49, 0), (0.5, 1), (49.5, 50), (49.49, 49), (300.0, 255)])
def test_obd_speed_is_rounded_half_up(km_h: float, byte: int) -> None:
    assert speed_response(km_h / 3.6 + 1e-12)[:4] == bytes((3, 0x41, 0x0D, byte))


def test_a_line_has_the_format_of_candump() -> None:
    assert line(1436509052249713999, 0x7DF, speed_request()) == b"(1436509052.249713) can0 7DF#02010D5555555555\n"
    assert line(1_000_000_000, 0x7, b"\x01") == b"(1.000000) can0 007#01\n"


def test_wheel_speeds_follow_the_geometry_of_the_axles() -> None:
    front_left, front_right, rear_left, rear_right = wheel_speeds(5.0, radians(40.0))
    assert rear_left - rear_right == pytest.approx(1.52 * radians(40.0))
    assert 0.5 * (rear_left + rear_right) == pytest.approx(5.0)
    assert front_left > rear_left
    assert front_right > rear_right
    assert wheel_speeds(5.0, 0.0) == pytest.approx((5.0,) * 4)


def test_wheel_speeds_have_a_rate_of_50_hz_and_delays_of_5_to_20_ms(drive: tuple[list[CanRaw], Motion]) -> None:
    wheels = frames(drive[0], 0x0F1)
    assert len(wheels) / 60.0 == pytest.approx(50.0, abs=0.2)
    stamps = np.array([stamp for stamp, _ in wheels])
    assert (np.diff(stamps) >= 0).all()
    # Sample n is at n times 20 ms, within the clock drift of 20 ppm: 1.2 ms in a minute.
    delay = stamps - START_NS - np.arange(1, len(stamps) + 1) * 20_000_000
    assert 5e6 - 1.3e6 <= delay.min() < 7e6
    assert 18e6 < delay.max() <= 20e6 + 1.3e6


def test_wheel_speeds_are_the_true_speed_with_noise_and_scale_error(
    drive: tuple[list[CanRaw], Motion], database: Database
) -> None:
    batches, motion = drive
    wheels = frames(batches, 0x0F1)
    rear = np.array([
        [decoded["WheelSpeedRearLeft"], decoded["WheelSpeedRearRight"]]
        for _, data in wheels if isinstance(decoded := database.decode_message("WheelSpeeds", data), dict)
    ], dtype=float).mean(axis=1) / 3.6  # fmt: skip
    speed = np.interp(np.arange(1, len(wheels) + 1) * 0.02, np.arange(len(motion.speed)) * 0.01, motion.speed)
    assert not rear[:750].any(), "the first 15 s are a standstill"
    moving = speed > 2.0
    scale = (rear[moving] / speed[moving]).mean()
    assert 1e-4 < abs(scale - 1.0) < 0.02
    assert 0.005 < (rear[moving] - scale * speed[moving]).std() < 0.03


def test_each_obd_request_is_answered_within_40_ms_with_the_speed_0_1_s_earlier(
    drive: tuple[list[CanRaw], Motion],
) -> None:
    batches, motion = drive
    requests, responses = frames(batches, 0x7DF), frames(batches, 0x7E8)
    assert 1.0 <= len(responses) / 60.0 <= 2.0
    for (request_ns, _), (response_ns, data) in zip(requests, responses, strict=False):
        assert 7_000_000 < response_ns - request_ns <= 40_000_000
        at = (response_ns - START_NS) * 1e-9 - 0.105
        true_km_h = 3.6 * np.interp(at, np.arange(len(motion.speed)) * 0.01, motion.speed)
        assert data[3] == pytest.approx(true_km_h, abs=0.7)
    assert max(data[3] for _, data in responses) > 15


def test_a_batch_holds_the_frames_since_the_previous_batch(drive: tuple[list[CanRaw], Motion]) -> None:
    before = START_NS
    for batch in drive[0]:
        for stamp, _ in frames([batch], 0x0F1) + frames([batch], 0x7E8):
            assert before - 1000 < stamp <= batch.received_ns
        assert batch.received_ns - before == 100_000_000
        before = batch.received_ns
