"""What one inertial sample costs, CPU and memory: run as a program over a recording, in a process of its own."""

import json
import resource
import sys
import time
from itertools import islice
from pathlib import Path

from services.core.fusion import messages
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from shared.messages.base import Message
from shared.messages.gnss import GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds
from shared.recording import Recording
from shared.runtime.config import parse_vehicle

TOPICS = ("imu/sample", "gnss/fix", "vehicle/speed", "vehicle/wheel_speed")
CHUNK = 2000  # messages that are decoded before the clock runs, so that only the navigator is timed


def main(path: str) -> int:
    """Print the cost as JSON."""
    spent_s, samples = 0.0, 0
    with Recording(Path(path)) as recording:
        settings = parse_vehicle(recording.attachments["vehicle.toml"].decode()).section("core.fusion", _Fusion)
        navigator = Navigator(settings)
        messages = (envelope.decode() for envelope in recording if envelope.topic in TOPICS)
        while chunk := list(islice(messages, CHUNK)):
            spent_s += timed(navigator, chunk)
            samples += sum(len(message.sampled_ns) for message in chunk if isinstance(message, ImuSamples))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({"us_per_sample": 1e6 * spent_s / samples, "samples": samples, "peak_mb": peak}))
    return 0


class _Fusion(Settings):
    """The section [core.fusion]."""


def timed(navigator: Navigator, chunk: list[Message]) -> float:
    """CPU seconds that the navigator takes for some messages."""
    began = time.process_time()
    for message in chunk:
        if isinstance(message, ImuSamples):
            for stamp, force, rate in messages.samples_of(message):
                navigator.imu(stamp, force, rate, message.received_ns)
        elif isinstance(message, GnssFix | VehicleSpeed | WheelSpeeds):
            messages.use(navigator, message)
    return time.process_time() - began


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
