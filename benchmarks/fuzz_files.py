"""Feeds damaged files to the readers of files: each ends in a refusal of its kind, in time and in little memory.

`python -m benchmarks.fuzz_files [READER ...] --seconds 60 --seed 1`; the address space of the program is limited, so
that a reader that grows fails. An input that fails is stored in .obu/fuzz.
"""

import argparse
import random
import resource
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

from services.parsers.can.database import load
from shared.errors import ObuError
from shared.library.summary import read_summary
from shared.page.map.tiles import BadMap, describe
from shared.recording import Recording
from shared.runtime.config import load_vehicle
from shared.toll.plaza import load_plaza
from tests.support.dashboard.tile_files import write_mbtiles, write_pmtiles
from tests.support.data import REPOSITORY
from tests.support.drives.golden import record_golden_drive

from .fuzz import SLOWEST_S, mutated

MORE_BYTES = 500_000_000  # of address space, above that of the start
PLACE_DEG = 48.0, 11.0
REFUSALS = (ObuError, ValueError, BadMap)
MAX_LENGTH = 200  # characters of what an error says
VEHICLES = REPOSITORY / "deploy" / "vehicles"


class Feed(Protocol):
    """Feeds one reader with damaged inputs."""

    def __call__(
        self, name: str, seed: int, seconds: float, folder: Path, least: int = 0, *, slowest_s: float = inf
    ) -> tuple[int, list[str]]:
        """Feed it for some seconds and `least` inputs; return their number, and what failed.

        What fails is stored in the folder. An input fails as well that takes more than `slowest_s` of processor time.
        """


def _recording(path: Path) -> None:
    with Recording(path) as recording:
        for _ in recording:
            pass


READERS: dict[str, tuple[str, Callable[[Path], object]]] = {  # suffix, and how it is read
    "vehicle": (".toml", load_vehicle),
    "dbc": (".dbc", lambda path: load(path.read_text(encoding="latin-1"))),
    "plaza": (".geojson", load_plaza),
    "pmtiles": (".pmtiles", describe),
    "mbtiles": (".mbtiles", describe),
    "recording": (".mcap", _recording),
    "summary": (".json", lambda path: read_summary(path, 1)),
}


def seed_of(name: str, folder: Path) -> bytes:
    """A sound file of a kind."""
    path = folder / f"seed{READERS[name][0]}"
    match name:
        case "pmtiles":
            write_pmtiles(path, *PLACE_DEG)
        case "mbtiles":
            write_mbtiles(path, *PLACE_DEG)
        case "recording":
            record_golden_drive(path)
        case "summary":
            path.write_text('{"version": 1, "size_bytes": 1, "begin_ns": 1, "end_ns": 2, "track": [[48.0, 11.0]]}')
        case _:
            found = {"vehicle": VEHICLES / "pi.toml", "dbc": VEHICLES / "simulated.dbc"}
            return found.get(name, REPOSITORY / "deploy" / "plazas" / "example.geojson").read_bytes()
    return path.read_bytes()


def damaged(seed: bytes, chance: random.Random) -> bytes:
    """The file with a damaged piece: its length stays about the same, so that what lies behind it is still found."""
    start = chance.randrange(max(len(seed) - 512, 1))
    piece = mutated([seed[start : start + 512]], chance)
    return seed[:start] + piece + seed[start + 512 :]


def failure_while(read: Callable[[], object], refusals: tuple[type[Exception], ...], slowest_s: float) -> str | None:
    """Say what went wrong while something was read, but for refusals, or that it took too much processor time."""
    begin_s = time.thread_time()
    try:
        with suppress(*refusals):
            read()
    except BaseException as error:  # noqa: BLE001  # also MemoryError: whatever it raises is what is looked for
        return f"{type(error).__name__}: {str(error)[:MAX_LENGTH]}"
    taken_s = time.thread_time() - begin_s
    return f"{taken_s:.1f} s" if taken_s > slowest_s else None


def fuzz(
    name: str, seed: int, seconds: float, folder: Path, least: int = 0, *, slowest_s: float = inf
) -> tuple[int, list[str]]:
    """Feed one reader for some seconds and `least` files; return the number of files, and what failed."""
    chance, inputs, failures = random.Random(f"{name} {seed}"), 0, list[str]()
    with TemporaryDirectory() as made:
        sound = seed_of(name, Path(made))
        path = Path(made) / f"file{READERS[name][0]}"
        until = time.monotonic() + seconds
        while inputs < least or time.monotonic() < until:
            path.write_bytes(damaged(sound, chance))
            if (failure := failure_while(partial(READERS[name][1], path), REFUSALS, slowest_s)) is not None:
                folder.mkdir(parents=True, exist_ok=True)
                stored = folder / f"{name}-{seed}-{inputs}{path.suffix}"
                stored.write_bytes(path.read_bytes())
                failures.append(f"{name}: {failure}; input: {stored}")
            inputs += 1
    return inputs, failures


def limit_memory() -> None:
    """Limit the address space of this process, so that what grows fails."""
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + MORE_BYTES, now + MORE_BYTES))


def run(description: str | None, names: Sequence[str], feed: Feed, what: str) -> None:
    """Read the command line, feed the readers that it names, and exit with 1 where one has failed."""
    options = argparse.ArgumentParser(description=description)
    options.add_argument("reader", nargs="*", choices=[*names, []], help="all where none is named")
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--seconds", type=float, default=60.0, help="time for each reader")
    given = options.parse_args()
    limit_memory()
    failed = False
    for name in given.reader or names:
        inputs, failures = feed(name, given.seed, given.seconds, REPOSITORY / ".obu" / "fuzz", slowest_s=SLOWEST_S)
        print(
            f"{name}: seed {given.seed}, {inputs} {what} in {given.seconds:g} s, {len(failures)} failures", flush=True
        )
        print("".join(f"  {failure}\n" for failure in failures[:5]), end="")
        failed = failed or bool(failures)
    sys.exit(failed)


if __name__ == "__main__":
    run(__doc__, list(READERS), fuzz, "files")
