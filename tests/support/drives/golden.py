"""The golden drive: 30 s of device bytes of the simulator, and the messages that the unit publishes for them.

`make golden` writes `tests/golden/` anew: the bytes of each device as any tool reads them (`gnss.ubx`, `imu.xbus`,
`can.log`), how they were cut and when each piece arrived (`arrivals.csv`), and the result (`expected.jsonl`).
"""

import csv
import json
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from services.sensors.simulator.world import messages
from shared.messages.base import Message, RawBytes
from shared.messages.gnss import GnssRaw
from shared.messages.imu import ImuRaw
from shared.messages.vehicle import CanRaw
from shared.recording import RecordingWriter
from shared.runtime.config import load_vehicle
from shared.runtime.offline import OfflineUnit
from tests.support.bus.envelopes import sent
from tests.support.data import REPOSITORY

FOLDER = REPOSITORY / "tests" / "golden"
VEHICLE = REPOSITORY / "deploy" / "vehicles" / "simulated.toml"
SCENARIO, SEED, DURATION_S = "urban", 1, 30.0
FILES: dict[str, type[RawBytes]] = {"gnss.ubx": GnssRaw, "imu.xbus": ImuRaw, "can.log": CanRaw}
# One of this many messages is compared for each frequent type; of all other types every message.
EVERY = {
    "AidingUpdate": 5, "FilterState": 10, "GnssNavigationBits": 20, "GnssRawEpoch": 10, "GnssSatellites": 10,
    "GnssSignals": 30, "ImuSamples": 100, "NavigationSolution": 10, "TrustMonitor": 20, "TrustState": 10,
    "WheelSpeeds": 10,
}  # fmt: skip
Row = dict[str, object]


def device_bytes(folder: Path = FOLDER) -> Iterator[RawBytes]:
    """Yield the stored bytes of all devices in the order in which they arrived."""
    files = {name: (folder / name).read_bytes() for name in FILES}
    taken = dict.fromkeys(FILES, 0)
    with (folder / "arrivals.csv").open(newline="") as file:
        for name, source, received_ns, length in csv.reader(file):
            data = files[name][taken[name] : taken[name] + int(length)]
            taken[name] += len(data)
            yield FILES[name](received_ns=int(received_ns), source=source, data=data)


def record_golden_drive(path: Path) -> Path:
    """Write the stored bytes into a recording."""
    vehicle = load_vehicle(VEHICLE)
    writer = RecordingWriter(path, vehicle=vehicle.name, vehicle_toml=vehicle.text)
    for sequence, message in enumerate(device_bytes()):
        writer.write(sent(message, message.received_ns, "sensors.simulator", 1, sequence))
    writer.close()
    return path


def results(runtime: type[OfflineUnit] = OfflineUnit) -> Iterator[Message]:
    """Replay the stored bytes through layers 2 to 4; yield what they publish."""
    unit = runtime(load_vehicle(VEHICLE))
    yield from (message for message in unit.run(device_bytes()) if type(message) not in FILES.values())


def rows(published: Iterator[Message]) -> Iterator[Row]:
    """Yield what is compared: messages as JSON, thinned out by `EVERY`, then the number of each type."""
    counts: Counter[str] = Counter()
    for message in published:
        name = type(message).__name__
        if counts[name] % EVERY.get(name, 1) == 0:
            yield {"type": name, **json.loads(message.model_dump_json(exclude_none=True))}
        counts[name] += 1
    yield {"type": "counts", **dict(sorted(counts.items()))}


def stored_rows(folder: Path = FOLDER) -> list[Row]:
    """Read the stored result."""
    return [json.loads(line) for line in (folder / "expected.jsonl").read_text().splitlines()]


def write_device_bytes(folder: Path = FOLDER) -> None:
    """Drive the simulator and store the bytes of its devices."""
    of_type = {kind: name for name, kind in FILES.items()}
    parts: dict[str, bytearray] = {name: bytearray() for name in FILES}
    with (folder / "arrivals.csv").open("w", newline="") as file:
        arrivals = csv.writer(file, lineterminator="\n")
        for message in messages(SCENARIO, SEED, DURATION_S):
            if isinstance(message, RawBytes):
                name = of_type[type(message)]
                parts[name] += message.data
                arrivals.writerow((name, message.source, message.received_ns, len(message.data)))
    for name, data in parts.items():
        (folder / name).write_bytes(data)


def main() -> None:
    """Rewrite the stored result, and with `--bytes` the bytes of the devices as well."""
    FOLDER.mkdir(exist_ok=True)
    if "--bytes" in sys.argv[1:]:
        write_device_bytes()
    lines = [json.dumps(row) for row in rows(results())]
    (FOLDER / "expected.jsonl").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
