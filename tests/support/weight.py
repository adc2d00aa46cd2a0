"""What a second of driving costs in calls of Python functions, messages and bytes: the same on every machine.

Two drives: the golden one through layers 2 to 4 of the whole unit, and one through fusion, monitors and verdict that
lasts until all hypotheses have solutions of their own. Calls are counted after a first part, in which caches fill, and
only those of the project's own functions.

Run as a program it prints the figures as JSON; `--store REASON` makes them the stored ones of this version of Python.
It runs itself with compiled code switched off and one seed of hashes, which change what is called.
"""

import cProfile
import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from shared.messages.base import Message, Tick
from shared.messages.imu import ImuSamples
from shared.runtime.config import load_vehicle
from shared.runtime.offline import OfflineUnit
from shared.topics import BY_MESSAGE
from tests.support.data import REPOSITORY
from tests.support.drives.golden import FILES, VEHICLE, device_bytes

STORED = REPOSITORY / "tests" / "golden" / "weight.json"
VERSION = f"{sys.version_info.major}.{sys.version_info.minor}"
ENVIRONMENT = {"NUMBA_DISABLE_JIT": "1", "PYTHONHASHSEED": "0", "OPENBLAS_NUM_THREADS": "1"}
GOLDEN_FROM_S, GOLDEN_TO_S = 15.0, 30.0  # of the golden drive: the filter begins at 19 s
HYPOTHESES_FROM_S, HYPOTHESES_TO_S = 60.0, 70.0  # the hypotheses begin 30 s after the filter
DEPTH = {"services": 3, "shared": 2}  # of the folders for which calls are counted
Figures = dict[str, dict[str, float]]


def weight() -> Figures:
    """Calls per inertial sample by folder, messages and bytes per second by topic; "sum" is their sum."""
    golden = Counted()
    for message in golden.between(OfflineUnit(load_vehicle(VEHICLE)).run(device_bytes()), GOLDEN_FROM_S, GOLDEN_TO_S):
        if type(message) not in FILES.values():
            golden.publish(message)
    hypotheses = Counted()
    for _ in hypotheses.between(_drive_with_hypotheses(), HYPOTHESES_FROM_S, HYPOTHESES_TO_S):
        pass
    span_s = GOLDEN_TO_S - GOLDEN_FROM_S
    return {
        "calls per sample, unit": golden.calls(),
        "calls per sample, with hypotheses": hypotheses.calls(),
        "messages per second": _rounded(golden.messages, span_s),
        "bytes per second": _rounded(golden.bytes, span_s),
    }


class Counted:
    """Counts what happens within a part of a drive."""

    def __init__(self) -> None:
        self.messages: Counter[str] = Counter()
        self.bytes: Counter[str] = Counter()
        self._samples = 0
        self._profile = cProfile.Profile(builtins=False)

    def between(self, drive: Iterator[Message], begin_s: float, end_s: float) -> Iterator[Message]:
        """Yield the messages of a part of a drive, and count the calls that they cost."""
        first_ns: int | None = None
        counting = False
        while (message := self._next(drive, counting=counting)) is not None:
            now_ns = _time_ns(message)
            first_ns = now_ns if first_ns is None else first_ns
            if now_ns is not None and first_ns is not None:
                at_s = (now_ns - first_ns) * 1e-9
                counting = begin_s <= at_s
                if at_s >= end_s:
                    return
            if counting:
                self._samples += len(message.sampled_ns) if isinstance(message, ImuSamples) else 0
                yield message

    def _next(self, drive: Iterator[Message], *, counting: bool) -> Message | None:
        if counting:
            self._profile.enable()
        try:
            return next(drive, None)
        finally:
            self._profile.disable()

    def publish(self, message: Message) -> None:
        """Count a message on the bus."""
        topic = BY_MESSAGE[type(message)].name
        self.messages[topic] += 1
        self.bytes[topic] += len(message.model_dump_json(exclude_none=True))

    def calls(self) -> dict[str, float]:
        """Calls per sample by the folder of the function."""
        found: Counter[str] = Counter()
        for entry in self._profile.getstats():
            code = entry.code
            if not isinstance(code, str) and (folder := _folder(code.co_filename)) is not None:
                found[folder] += entry.callcount
        return _rounded(found, self._samples)


def _time_ns(message: Message) -> int | None:
    """Time on the device's side of what drives the unit."""
    if isinstance(message, Tick):
        return message.now_ns
    received_ns = getattr(message, "received_ns", None)
    return received_ns if isinstance(received_ns, int) else None


def _folder(file: str) -> str | None:
    path = PurePosixPath(file)
    if not path.is_relative_to(REPOSITORY):
        return None
    parts = path.relative_to(REPOSITORY).parts[:-1]
    return "/".join(parts[: DEPTH[parts[0]]]) if parts and parts[0] in DEPTH else None


def _rounded(counts: Counter[str], over: float) -> dict[str, float]:
    return {"sum": round(counts.total() / over, 2)} | {k: round(n / over, 2) for k, n in sorted(counts.items())}


def _drive_with_hypotheses() -> Iterator[Message]:
    from services.sensors.simulator.drive import simulate  # the golden drive needs no simulator
    from tests.support.drives.chain import Chain

    return Chain(simulate("parking_lot", 1, HYPOTHESES_TO_S + 1.0)).run()


def measured() -> Figures:
    """Figures of another process, whose variables make them the same each time."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.support.weight"], cwd=REPOSITORY, env=os.environ | ENVIRONMENT,
        stdout=subprocess.PIPE, check=True,
    )  # fmt: skip
    figures: Figures = json.loads(done.stdout)
    return figures


def main(arguments: list[str]) -> None:
    """Print the figures, or store them with the reason why they changed."""
    if arguments[:1] != ["--store"]:
        sys.stdout.write(json.dumps(weight()))
        return
    reason = " ".join(arguments[1:]).strip()
    if not reason:
        raise SystemExit("state why the weight changed: python -m tests.support.weight --store REASON")
    stored = json.loads(STORED.read_text()) if STORED.exists() else {}
    stored[VERSION] = {"reason": reason, **measured()}
    Path(STORED).write_text(json.dumps(stored, indent=1) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
