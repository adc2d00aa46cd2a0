"""Ages of messages over three hops in C, on a broker of their own beside the unit that is measured."""

import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
HOP = HERE / "build" / "hop"
PAYLOAD_BYTES = 300
SETTLING = 100  # first messages that are not counted: buffers and caches are cold
START_S = 20.0

RAW, SAMPLE, SOLUTION = (f"obu/yardstick/{name}" for name in ("imu/raw", "imu/sample", "navigation/solution"))


@dataclass(frozen=True)
class Ages:
    """How old messages were on arrival, at the median and at the 99th percentile."""

    p50_ms: float
    p99_ms: float
    messages: int

    @classmethod
    def of(cls, ages_ns: Sequence[int]) -> "Ages":
        """Summarise ages in nanoseconds."""
        p50, p99 = np.percentile(np.asarray(ages_ns, dtype=float), [50, 99]) * 1e-6
        return cls(round(float(p50), 4), round(float(p99), 4), len(ages_ns))

    @classmethod
    def typical(cls, rounds: Sequence["Ages"]) -> "Ages":
        """Take the median of the rounds, so that one disturbed round does not decide."""
        p50, p99 = (float(np.median([getattr(r, name) for r in rounds])) for name in ("p50_ms", "p99_ms"))
        return cls(round(p50, 4), round(p99, 4), sum(r.messages for r in rounds))


def three_hops_c(port: int, rate_hz: float, seconds: float) -> Ages:
    """Measure C along the way of an inertial sample: driver, parser, fusion, listener."""
    count = round(rate_hz * seconds) + SETTLING
    relays = [
        subprocess.Popen([HOP, "relay", str(port), user, source, target], stdout=subprocess.PIPE)
        for user, source, target in (("parsers.imu", RAW, SAMPLE), ("core.fusion", SAMPLE, SOLUTION))
    ]
    try:
        for relay in relays:
            _await_ready(relay)
        with _subscriber([str(HOP), "sub", str(port), "observer", SOLUTION, str(count)]) as subscriber:
            _publish_c(port, rate_hz, count)
            return _ages(subscriber)
    finally:
        for relay in relays:
            relay.kill()
            relay.communicate()


def _publish_c(port: int, rate_hz: float, count: int) -> None:
    numbers = (str(rate_hz), str(count), str(PAYLOAD_BYTES))
    subprocess.run([HOP, "pub", str(port), "sensors.imu", RAW, *numbers], check=True)


@contextmanager
def _subscriber(command: Sequence[str]) -> Iterator["subprocess.Popen[bytes]"]:
    process = subprocess.Popen(command, stdout=subprocess.PIPE)
    try:
        _await_ready(process)
        yield process
    finally:
        process.kill()
        process.communicate()


def _await_ready(process: "subprocess.Popen[bytes]") -> None:
    assert process.stdout is not None
    line = process.stdout.readline()
    if line != b"ready\n":
        raise RuntimeError(f"{process.args!r} says {line!r} instead of being ready")


def _ages(subscriber: "subprocess.Popen[bytes]") -> Ages:
    output, _ = subscriber.communicate(timeout=START_S)
    return Ages.of([int(line) for line in output.split()][SETTLING:])
