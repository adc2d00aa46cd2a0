"""What one inertial sample costs, CPU and memory: run as a program over a recording, in a process of its own.

All aids of the recording are used, as late as they came, and a solution is asked for in every solution period. A second
argument ends the run after so many seconds of the recording.
"""

import json
import resource
import sys
import time
from itertools import islice
from math import inf
from pathlib import Path

from services.core.fusion.aids.kinds import measurements_of
from services.core.fusion.messages import samples_of
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from shared.messages.base import Message
from shared.messages.imu import ImuSamples
from shared.recording import Recording
from shared.runtime.config import parse_vehicle

TOPICS = ("imu/sample", "gnss/fix", "vehicle/speed", "vehicle/wheel_speed")
CHUNK = 2000  # messages that are decoded before the clock runs, so that only the navigator is timed


def main(path: str, end_s: float = inf) -> int:
    """Print the cost as JSON."""
    spent_s, samples, first_ns = 0.0, 0, None
    with Recording(Path(path)) as recording:
        settings = parse_vehicle(recording.attachments["vehicle.toml"].decode()).section("core.fusion", _Fusion)
        navigator = Navigator(settings)
        inputs = (envelope.decode() for envelope in recording if envelope.topic in TOPICS)
        while chunk := list(islice(inputs, CHUNK)):
            spent_s += timed(navigator, chunk)
            stamps_ns = [stamp for message in chunk if isinstance(message, ImuSamples) for stamp in message.sampled_ns]
            samples += len(stamps_ns)
            first_ns = stamps_ns[0] if first_ns is None and stamps_ns else first_ns
            if first_ns is not None and stamps_ns and (stamps_ns[-1] - first_ns) * 1e-9 > end_s:
                break
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({"us_per_sample": 1e6 * spent_s / samples, "samples": samples, "peak_mb": peak}))
    return 0


class _Fusion(Settings):
    """The section [core.fusion]."""


def timed(navigator: Navigator, chunk: list[Message]) -> float:
    """CPU seconds that the navigator takes for some messages."""
    period_ns = round(navigator.settings.solution_period_s * 1e9)
    began, last_ns = time.process_time(), 0
    for message in chunk:
        if isinstance(message, ImuSamples):
            for stamp, force, rate in samples_of(message):
                navigator.advance(stamp, force, rate, message.received_ns)
                if stamp // period_ns != last_ns // period_ns:
                    navigator.solution()
                last_ns = stamp
                navigator.release(message.received_ns)
        for measurement in measurements_of(message, navigator.settings):
            navigator.measure(measurement)
    return time.process_time() - began


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], *map(float, sys.argv[2:])))
