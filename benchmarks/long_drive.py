"""Makes a long recording of a simulated drive: `python -m benchmarks.long_drive FILE [SECONDS]`.

The whole unit computes it offline, on the bytes of the simulated devices: 283 messages a second, as in a vehicle.
Two hours take a quarter of an hour of one core.
"""

import sys
from pathlib import Path

from services.sensors.simulator.world import DEFAULT_START_NS, messages
from shared.recording import RecordingWriter
from shared.runtime.config import load_vehicle
from shared.runtime.live import arrival_ns
from shared.runtime.offline import OfflineUnit
from shared.topics import BY_MESSAGE
from tests.support.bus.envelopes import sent
from tests.support.data import REPOSITORY

VEHICLE = REPOSITORY / "deploy" / "vehicles" / "simulated.toml"
SCENARIO, SEED = "tunnel", 1  # the verdict changes with every tunnel
TWO_HOURS_S = 7200.0


def write(path: Path, seconds: float = TWO_HOURS_S) -> Path:
    """Drive and record; a file that is there stays as it is."""
    if path.exists():
        return path
    vehicle = load_vehicle(VEHICLE)
    part = path.with_suffix(".part")
    part.unlink(missing_ok=True)
    writer = RecordingWriter(part, vehicle=vehicle.name, vehicle_toml=vehicle.text)
    now_ns = DEFAULT_START_NS  # of what comes before the first stamp
    for sequence, message in enumerate(OfflineUnit(vehicle).run(messages(SCENARIO, SEED, seconds))):
        now_ns = max(now_ns, arrival_ns(message) or 0)
        writer.write(sent(message, now_ns, BY_MESSAGE[type(message)].producers[0], 1, sequence))
    writer.close()
    return part.rename(path)


if __name__ == "__main__":
    write(Path(sys.argv[1]), *map(float, sys.argv[2:3]))
