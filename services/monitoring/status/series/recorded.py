"""The past of fields from the recordings of the last hour; run as a process of its own by `past`."""

import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import cast

from pydantic_core import from_json, to_json

from shared.bus.envelope import Envelope
from shared.errors import BadPayload, BadRecording
from shared.library.order import in_order, read_order
from shared.library.summary import RECORDING_SUFFIX as SUFFIX
from shared.recording.reader import Recording

from . import computed, fields
from .rings import SECOND_NS
from .store import HOUR_NS, Series

FILES = 3  # newest, which hold more than an hour
LIMIT_S = 40.0  # for reading; what has been read by then is used
THINNED_NS = round(0.95 * SECOND_NS)  # between two messages of a topic that are decoded
TRUTH, SOLUTION = "truth/state", "navigation/solution"


def recorded(folder: Path, topics: Iterable[str], from_ns: int, *, limit_s: float) -> Iterator[Envelope]:
    """Yield the messages of some topics that were recorded since a time, the newest file first.

    Stops after `limit_s`. A file that cannot be read is skipped; one that is being written is read as far as it goes.
    """
    wanted, ends = frozenset(topics), time.monotonic() + limit_s
    names = (path.name for path in folder.glob(f"*{SUFFIX}") if path.is_file())
    for name in in_order(names, read_order(folder))[: -FILES - 1 : -1]:
        path = folder / name
        try:
            with Recording(path) as recording:
                for envelope in recording:
                    if envelope.topic in wanted and envelope.received_ns >= from_ns:
                        yield envelope
                    if time.monotonic() > ends:
                        return
        except (BadRecording, OSError):
            continue


def read_past(folder: Path, names: Sequence[str], now_ns: int, *, limit_s: float = LIMIT_S) -> Series:
    """Build the series of fields from recordings: one message a second of each topic, all of those with a selector."""
    series = Series(names)
    chosen = [fields.parse(name) for name in names]
    topics = {field.topic for field in chosen} - {fields.COMPUTED}
    if any(field.topic == fields.COMPUTED for field in chosen):
        topics |= set(computed.SOURCES)
    every = {field.topic for field in chosen if field.selector}
    newest_ns: dict[str, int] = {}
    truth: Envelope | None = None
    for envelope in recorded(folder, topics, now_ns - HOUR_NS, limit_s=limit_s):
        name, received_ns = envelope.topic, envelope.received_ns
        if name == TRUTH and SOLUTION in topics:
            truth = envelope  # taken with the solution that it is compared with
            continue
        if name not in every and 0 <= received_ns - newest_ns.get(name, 0) < THINNED_NS:
            continue
        newest_ns[name] = received_ns
        due = (truth, envelope) if name == SOLUTION and truth else (envelope,)
        for taken in due:
            _take(series, taken)
    return series


def _take(series: Series, envelope: Envelope) -> None:
    try:
        series.take(envelope.topic, envelope.decode(), envelope.received_ns, fill=True)
    except BadPayload:
        return  # of a version with another contract; its seconds stay empty


def main() -> None:
    """Answer one question on stdin with a line for each field on stdout."""
    question = from_json(sys.stdin.buffer.read())
    names, now_ns = cast(list[str], question["names"]), int(question["now_ns"])
    series = read_past(Path(question["folder"]), names, now_ns)
    for name in names:
        columns = series.columns([name], now_ns - HOUR_NS, now_ns, fine=False)
        values = columns["values"][name]
        sys.stdout.buffer.write(to_json({"name": name, "values": values}) + b"\n")


if __name__ == "__main__":
    main()
