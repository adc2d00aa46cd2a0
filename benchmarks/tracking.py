"""What core.toll costs: 200 vehicles at 10 Hz in batches of 20 ms, from the bytes on the bus to the statements.

`python -m benchmarks.tracking` measures processor time of this process alone, without a broker.
"""

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from benchmarks import tables
from services.core.toll.process import Config, Out, Process
from shared.messages.base import Tick
from shared.messages.toll import TollPassage
from shared.messages.v2x import CamList
from tests.support.v2x.toll import SECOND_NS, START_NS, Vehicle, example_plaza, fix, nothing_open, registration

RESULTS = Path(__file__).parent / "results"
VEHICLES, RATE_HZ, BATCH_S = 200, 10, 0.02
COMMON = (2.5, -1.5)  # [m, north and east] error that all receivers have in common
TITLE = """# Tracking at a toll plaza: cost of core.toll

By `python -m benchmarks.tracking`: {vehicles} vehicles at {rate} Hz, in batches of 20 ms; reading the JSON, tracking,
and writing the statements. Processor time of one process, without a broker.
Receiving and decoding the frames: [v2x.md](v2x.md).

| quantity | value |
| --- | --- |
"""


@dataclass(frozen=True)
class Result:
    """One run."""

    seconds: float
    cams: int
    core_percent: float
    batch_p50_ms: float
    batch_p99_ms: float
    read_us: float  # of one CAM
    written_us: float  # of one CAM
    statements: dict[str, int]
    rejected: dict[str, int]


def vehicles() -> list[Vehicle]:
    """200 vehicles that drive through the plaza in six columns, 14 m apart."""
    lanes = [lane.name for lane in example_plaza().lanes]
    return [
        Vehicle(1000 + k, lanes[k % len(lanes)], error=COMMON, start=-80.0 - 14.0 * (k // len(lanes)))
        for k in range(VEHICLES)
    ]


def batches(seconds: float) -> list[tuple[float, str]]:
    """Messages of v2x/cam as they are on the bus: each vehicle sends at 10 Hz, evenly over time."""
    plaza, fleet = example_plaza(), vehicles()
    period_s = 1.0 / (VEHICLES * RATE_HZ)
    sent = [(k * period_s, fleet[k % VEHICLES]) for k in range(round(seconds / period_s))]
    found = []
    for number, group in groupby(sent, key=lambda pair: int(pair[0] / BATCH_S + 1e-9)):
        cams = tuple(vehicle.cam(plaza, t) for t, vehicle in group)
        end_s = (number + 1) * BATCH_S
        received_ns = START_NS + round(end_s * SECOND_NS)
        found.append((end_s, CamList(received_ns=received_ns, source="v2x0", cams=cams).model_dump_json()))
    return found


def measure(seconds: float) -> Result:
    """Feed the process, with ticks and fixes every second."""
    plaza, process = example_plaza(), Process(Config())
    list(process.handle(nothing_open()))
    for vehicle in vehicles():
        list(process.handle(registration(vehicle.station_id)))
    inputs = batches(seconds)
    costs, said, read_s, written_s = [], [], 0.0, 0.0
    second = -30
    for end_s, text in inputs:
        begin = time.process_time()
        out: list[Out] = []
        while second <= end_s:
            list(process.handle(fix(plaza, float(second), *COMMON)))
            out += process.handle(Tick(now_ns=START_NS + second * SECOND_NS))
            second += 1
        read = time.process_time()
        message = CamList.model_validate_json(text)
        read_s += time.process_time() - read
        out += process.handle(message)
        write = time.process_time()
        for item in out:
            item.model_dump_json()
        end = time.process_time()
        written_s += end - write
        costs.append(end - begin)
        said += [
            toll_passage.state.value
            for toll_passage in out
            if isinstance(toll_passage, TollPassage) and not toll_passage.checkpoint
        ]
    cams = len(inputs) * round(VEHICLES * RATE_HZ * BATCH_S)
    p50, p99 = np.percentile(np.array(costs) * 1e3, [50.0, 99.0]).tolist()
    return Result(
        seconds=seconds,
        cams=cams,
        core_percent=round(100.0 * sum(costs) / seconds, 1),
        batch_p50_ms=round(p50, 2),
        batch_p99_ms=round(p99, 2),
        read_us=round(1e6 * read_s / cams, 1),
        written_us=round(1e6 * written_s / cams, 1),
        statements=dict(Counter(said)),
        rejected=dict(process.rejects),
    )


def markdown(result: Result) -> str:
    """Write the result as a page."""
    rows = {
        "duration": f"{result.seconds:g} s",
        "CAM": f"{result.cams} ({result.cams / result.seconds:.0f} per second)",
        "processor": f"{result.core_percent} % of a core",
        "of one batch": f"median {result.batch_p50_ms} ms, 99th percentile {result.batch_p99_ms} ms",
        "reading a CAM": f"{result.read_us} us",
        "writing, per CAM": f"{result.written_us} us",
        "changes of passages": ", ".join(f"{name} {count}" for name, count in result.statements.items()),
        "rejected": ", ".join(f"{name} {count}" for name, count in result.rejected.items()) or "none",
    }
    title = TITLE.format(vehicles=VEHICLES, rate=RATE_HZ)
    return title + "".join(f"| {name} | {value} |\n" for name, value in rows.items())


def main(arguments: Sequence[str]) -> int:
    """Measure, print and store the result; return 1 if it takes more than a third of a core."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tracking", description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0, help="duration of the traffic")
    parser.add_argument("--no-store", action="store_true", help="print only")
    given = parser.parse_args(arguments)
    result = measure(given.seconds)
    text = markdown(result)
    print(text)
    if not given.no_store:
        tables.publish(RESULTS / "tracking.md", text)
        (RESULTS / "tracking.json").write_text(json.dumps(asdict(result), indent=2) + "\n", encoding="utf-8")
    return 0 if result.core_percent <= 33.0 else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
