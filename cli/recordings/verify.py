"""`obu verify`: every process of layers 2 to 4 done again from a recording, and compared byte for byte."""

from collections import deque
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Annotated, cast

import typer
from rich.console import Console
from rich.progress import Progress, TaskID
from rich.table import Table

from shared.bus.bus import Envelope
from shared.errors import BadPayload, UserError
from shared.messages.base import Message
from shared.messages.operation import Consumed
from shared.processes import BY_NAME
from shared.recording import Recording
from shared.runtime.config import VehicleFile
from shared.runtime.live import Reactor, load_process
from shared.topics import topic_of

from ..progress import progress_on
from .common import open_recording, tell_problems, vehicle_of
from .verifying import Key, Repetition, Verdict

KEPT_NS = 60_000_000_000  # how long after its arrival a message can still be named in a journal
STEP = 2000  # messages between two looks at the progress
INCOMPLETE = (
    "incomplete: the recording lacks messages that a process consumed, because it was started while the unit ran; "
    "the unit's own recorder starts first and has all of them"
)


def verify(
    files: Annotated[list[Path], typer.Argument(help="A recording of the unit, or several in the order of time.")],
    process: Annotated[
        str | None,
        typer.Option("--process", metavar="NAME", help="Only this process; without it all of layers 2 to 4."),
    ] = None,
    vehicle: Annotated[
        Path | None,
        typer.Option("--vehicle", metavar="FILE", help="The vehicle's TOML file instead of the recorded one."),
    ] = None,
) -> int:
    """Repeat what each process consumed, in the order in which it did, and compare what it publishes byte for byte.

    Examples:
    [bold]obu verify .obu/recordings/20260921T141320Z_car.mcap[/]
    [bold]obu verify drive.mcap --process core.fusion[/]
    """
    wanted = {row.name for row in BY_NAME.values() if 2 <= row.layer <= 4}
    if process is not None and process not in wanted:
        raise UserError(f"{process!r} cannot be repeated; name one of {', '.join(sorted(wanted))}")
    console = Console(stderr=True)
    with open_recording(files[0]) as first:
        audit = Audit(vehicle_of(first, vehicle), {process} if process else wanted)
    with progress_on(console) as progress:
        for path in files:
            with open_recording(path) as recording:
                task = progress.add_task(path.name, total=recording.size)
                audit.read(recording, partial(_show, progress, task))
                tell_problems(recording, console)
    lives = audit.finish()
    if not lives:
        raise UserError(
            "the recording holds no message of a process of layers 2 to 4; record a running unit to verify it"
        )
    _print(lives, console)
    sound = all(life.verdict is Verdict.IDENTICAL for life in lives)
    return 0 if sound and any(life.compared for life in lives) else 1


class Audit:
    """Reads recordings once, from front to back, and repeats every life in them on the way."""

    def __init__(self, vehicle: VehicleFile, wanted: set[str]) -> None:
        self._vehicle, self._wanted = vehicle, wanted
        self._lives: dict[tuple[str, int], Repetition] = {}
        self._recent: dict[Key, Envelope] = {}
        self._arrivals: deque[tuple[int, Key]] = deque()
        self._retained: dict[tuple[str, str], Envelope] = {}  # the newest of each topic and producer
        self._now_ns = 0

    def read(self, recording: Recording, tell: Callable[[int], None]) -> None:
        """Read a recording, and report now and then how many bytes are done."""
        for count, envelope in enumerate(recording):
            if count % STEP == 0:
                tell(recording.position)
            self._now_ns = max(self._now_ns, envelope.received_ns)
            self._remember(envelope)
            row = BY_NAME.get(envelope.producer)
            if row is not None and row.name in self._wanted:
                self._take(envelope, self._life(row.name, envelope.incarnation))

    def finish(self) -> list[Repetition]:
        """Compare what is left, and return the lives in the order of the data flow."""
        for life in self._lives.values():
            life.advance(self._now_ns, last=True)
        order = list(BY_NAME)
        # What the broker had kept of a life before the recording is no life to be repeated.
        lives = [life for life in self._lives.values() if life.lively]
        return sorted(lives, key=lambda life: (order.index(life.name), life.life))

    def _life(self, name: str, incarnation: int) -> Repetition:
        key = (name, incarnation)
        if key not in self._lives:
            process = cast(Reactor, load_process(name, self._vehicle))
            self._lives[key] = Repetition(name, incarnation, process, self._find)
        return self._lives[key]

    def _take(self, envelope: Envelope, life: Repetition) -> None:
        branch = envelope.topic.split("/")[0]
        if branch not in ("health", "consumed"):
            life.add_published(envelope, compare=True)
            return
        if life.add_published(envelope, compare=False):
            message = _decoded(envelope)
            if isinstance(message, Consumed):
                life.add_journal(message, envelope.received_ns)
            life.advance(self._now_ns)

    def _remember(self, envelope: Envelope) -> None:
        """Keep what may still be named in a journal: the last minute, and what the broker keeps, a minute longer."""
        row = topic_of(envelope.topic)
        old: Envelope | None = envelope
        if row is not None and row.retain:
            place = envelope.topic, envelope.producer
            old, self._retained[place] = self._retained.get(place), envelope
        if old is not None:
            self._recent[_key(old)] = old
            self._arrivals.append((self._now_ns, _key(old)))
        while self._arrivals and self._arrivals[0][0] < self._now_ns - KEPT_NS:
            self._recent.pop(self._arrivals.popleft()[1], None)

    def _find(self, key: Key) -> Envelope | None:
        kept = self._retained.get(key[:2])
        return kept if kept is not None and _key(kept) == key else self._recent.get(key)


def _key(envelope: Envelope) -> Key:
    return envelope.topic, envelope.producer, envelope.incarnation, envelope.sequence


def _show(progress: Progress, task: TaskID, done: int) -> None:
    progress.update(task, completed=done)


def _decoded(envelope: Envelope) -> Message | None:
    try:
        return envelope.decode()
    except BadPayload:
        return None


def _print(lives: Sequence[Repetition], console: Console) -> None:
    table = Table(box=None, pad_edge=False)
    for title in ("process", "started (UTC)", "consumed", "compared", "unrecorded", "verdict"):
        right = title in ("consumed", "compared", "unrecorded")
        table.add_column(title, justify="right" if right else "left", no_wrap=True)
    for life in lives:
        started = datetime.fromtimestamp(life.life // 1_000_000_000, UTC)
        numbers = (str(number) for number in (life.consumed, life.compared, life.unrecorded))
        table.add_row(life.name, f"{started:%m-%d %H:%M:%S}", *numbers, life.verdict.value)
    Console().print(table)
    for life in lives:
        if life.reason:
            console.print(f"{life.name}: {life.reason}", markup=False, highlight=False)
    if any(life.verdict is Verdict.INCOMPLETE for life in lives):
        console.print(INCOMPLETE)
