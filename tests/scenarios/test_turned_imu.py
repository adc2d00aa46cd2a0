"""A whole unit whose IMU is mounted at a right angle, with the one setting that says so."""

from itertools import takewhile
from math import degrees, hypot, pi

import numpy as np
import pytest

from services.sensors.simulator.scenarios import scenario_of
from services.sensors.simulator.world import DEFAULT_START_NS, NS, Equipment, World
from shared.maths.rotation import ned_from_body
from shared.messages.base import Message
from shared.messages.navigation import NavigationSolution, TruthState
from shared.messages.trust import TrustLevel, TrustMonitor, TrustState
from shared.runtime.config import parse_vehicle
from shared.runtime.offline import OfflineUnit

pytestmark = pytest.mark.slow

SECONDS = 80.0
FLAT = np.diag([1.0, -1.0, -1.0])
FILE = """
[vehicle.imu]
body_from_sensor = {mounting}

[vehicle.gnss]
lever_arm_body_m = [0.3, 0.0, -1.2]

[core.spoofing]
grade = "industrial"
"""


def driven(rpy_deg: tuple[float, float, float]) -> list[Message]:
    """Every message of layers 2 to 4, and the truth, over 80 s in a town."""
    mounting = (ned_from_body(*np.radians(rpy_deg)) @ FLAT).round(7).tolist()
    unit = OfflineUnit(parse_vehicle(FILE.format(mounting=mounting)))
    world = World(scenario_of("urban", 1), 1, DEFAULT_START_NS, Equipment(mounting_rpy_deg=rpy_deg))
    end_ns = DEFAULT_START_NS + round(SECONDS * NS)
    return list(unit.run(message for due_ns, message in takewhile(lambda arrival: arrival[0] <= end_ns, world)))


@pytest.mark.parametrize(
    "rpy_deg",
    [
        pytest.param((0.0, 0.0, 90.0), id="x to the right"),
        pytest.param((0.0, 90.0, 0.0), id="x upwards"),
    ],
)
def test_a_unit_with_a_turned_imu_is_safe_and_no_monitor_suspects_a_sensor(rpy_deg: tuple[float, float, float]) -> None:
    made = driven(rpy_deg)
    verdicts = [message.state for message in made if isinstance(message, TrustState)]
    assert TrustLevel.UNSAFE not in verdicts and verdicts[-30:] == [TrustLevel.SAFE] * 30
    inertial = [
        message for message in made if isinstance(message, TrustMonitor) and message.monitor.startswith("inertial")
    ]
    assert any(trust_monitor.statistic is not None for trust_monitor in inertial), "they were evaluated"
    last = [message for message in made if isinstance(message, NavigationSolution)][-1]
    truth = min(
        (message for message in made if isinstance(message, TruthState)),
        key=lambda truth_state: abs(truth_state.sampled_ns - last.sampled_ns),
    )
    assert abs((last.yaw_rad - truth.yaw_rad + pi) % (2.0 * pi) - pi) < 0.05 if truth.yaw_rad is not None else False
    north_m = (last.latitude_deg - truth.latitude_deg) * 111_000.0
    assert hypot(north_m, (last.longitude_deg - truth.longitude_deg) * 82_000.0) < 3.0
    assert degrees(abs(last.roll_rad)) < 15.0
