"""`obu verify`: repeats every process of layers 2 to 4 from a recording, and compares its messages byte for byte."""

import json
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Annotated, cast

import typer
from rich.console import Console
from rich.progress import Progress, TaskID
from rich.table import Table

from shared import VERSION
from shared.bus.bus import Envelope
from shared.errors import BadPayload, UserError
from shared.evidence import Outcome
from shared.evidence.outcome import EXIT_DIFFERENT, OTHER_RELEASE, gravest
from shared.messages.base import Message
from shared.messages.operation import ConsumptionOrder
from shared.processes import BY_NAME
from shared.recording import Recording
from shared.runtime.config import VehicleFile
from shared.runtime.live import Reactor, load_process
from shared.runtime.reports import tell
from shared.topics import topic_of

from ..evidence_key import KeyOption
from ..progress import progress_on
from .common import open_recording, print_problems, vehicle_of
from .release import Release, release_of
from .repetition import Finding, Key, Repetition, Verdict
from .signatures import SignatureReport, check_signatures

RETENTION_NS = 60_000_000_000  # from the arrival of a message to the last journal that may name it
STEP = 2000  # messages between two updates of the progress
INCOMPLETE = (
    "incomplete: the recording lacks messages that a process consumed, as one that began while the unit ran; "
    "the unit's own recorder starts first and records all of them"
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
    key: KeyOption = None,
    signatures: Annotated[
        bool, typer.Option("--signatures", help="Check the signatures alone, and repeat no process.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of lines.")] = False,
) -> int:
    """Check the signatures of recordings, then feed each process what it consumed and compare its messages bytewise.

    Ends with 0 if both agree, 1 if a process gives other messages, 3 unsigned, 4 cut, 5 edited, 6 signed by an unknown
    key, 7 rewritten by another tool, 8 made by another release, which alone can repeat it. The graver one counts: 5, 6,
    7, 4, 1, 8, 3.

    Examples:
    [bold]obu verify .obu/recordings/20260921T141320Z_car.mcap[/]
    [bold]obu verify drive.mcap --process core.fusion[/]
    [bold]obu verify drive.mcap --signatures --key car.pub[/]
    """
    wanted = {row.name for row in BY_NAME.values() if 2 <= row.layer <= 4}
    if process is not None and process not in wanted:
        raise UserError(f"{process!r} cannot be repeated; name one of {', '.join(sorted(wanted))}")
    checked = check_signatures(files, key)
    outcome = gravest([outcome for file in checked for outcome in file.outcomes])
    if not as_json:
        _print_signatures(checked)
    repeated = None if signatures else _repeat(files, {process} if process else wanted, vehicle, Console(stderr=True))
    code = int(outcome)
    if repeated is not None and outcome in (Outcome.VERIFIED, Outcome.UNSIGNED):
        code = repeated.code or code
    tell(finding=_finding(checked, repeated, code))
    if as_json:
        print(json.dumps(_document(checked, repeated, code)))
    elif repeated is not None:
        _print(repeated, Console(stderr=True))
    return code


@dataclass(frozen=True)
class RepetitionReport:
    """What the repetition of all processes has given."""

    release: Release  # of the recordings
    findings: tuple[Finding, ...] = ()  # in the order of the data flow
    can: bool = True  # whether this release can repeat them at all

    @property
    def code(self) -> int:
        """Exit code: 0 if all is identical and something was compared."""
        verdicts = {finding.verdict for finding in self.findings}
        if not self.can or (Verdict.OTHER_RELEASE in verdicts and Verdict.DIFFERENT not in verdicts):
            return OTHER_RELEASE
        return (
            0
            if verdicts == {Verdict.IDENTICAL} and any(finding.compared for finding in self.findings)
            else EXIT_DIFFERENT
        )

    @property
    def remedy(self) -> str:
        """What to do with recordings of another release."""
        return f"made by {self.release.name}: repeat it with that release; this one is version {VERSION}"


def _repeat(files: list[Path], wanted: set[str], vehicle: Path | None, console: Console) -> RepetitionReport:
    """Repeat processes of recordings."""
    with open_recording(files[0]) as first:
        file, release = vehicle_of(first, vehicle), release_of(first)
        if file.facts.imu.body_from_sensor != file.samples_mounting:
            if not release.is_this:
                return RepetitionReport(release, can=False)
            raise UserError(
                f"the inertial samples of {files[0]} were made with another mounting of the IMU than the vehicle's "
                "file states, so nothing can be repeated byte for byte; `obu solve` processes it anew"
            )
        audit = Audit(file, wanted)
    with progress_on(console) as progress:
        for path in files:
            with open_recording(path) as recording:
                task = progress.add_task(path.name, total=recording.size)
                audit.read(recording, partial(_show, progress, task))
                print_problems(recording, console)
    repetitions = audit.finish()
    if not repetitions:
        raise UserError("the recording holds no message of a process of layers 2 to 4; record a running unit")
    return RepetitionReport(release, tuple(repetition.finding(release) for repetition in repetitions))


def _document(checked: Sequence[SignatureReport], repeated: RepetitionReport | None, code: int) -> dict[str, object]:
    """The result for programs."""
    files = [{**asdict(item), "outcome": item.outcome.name.lower()} for item in checked]
    found = {} if repeated is None else {
        "release": {"version": repeated.release.version or None, "is_this": repeated.release.is_this},
        "processes": [{**asdict(finding), "verdict": finding.verdict.name.lower()} for finding in repeated.findings],
    }  # fmt: skip
    return {"code": code, "files": files, **found}


def _finding(checked: Sequence[SignatureReport], repeated: RepetitionReport | None, code: int) -> str:
    """The result in a sentence: what the exit code stands for."""
    if repeated is not None and code == OTHER_RELEASE:
        return repeated.remedy
    if repeated is not None and code in (0, EXIT_DIFFERENT):
        others = [finding for finding in repeated.findings if finding.verdict is not Verdict.IDENTICAL]
        return (
            ", ".join(f"{finding.process}: {finding.verdict}" for finding in others)
            or "every process repeats its messages"
        )
    return next(file.text for file in checked if code in file.outcomes)


def _print_signatures(checked: Sequence[SignatureReport]) -> None:
    for item in checked:
        print(f"{item.file}: {item.text}")
        for more in (item.facts, item.gap):
            if more is not None:
                print(f"  {more}")


class Audit:
    """Reads recordings once, in their order, and repeats every incarnation in them."""

    def __init__(self, vehicle: VehicleFile, wanted: set[str]) -> None:
        self._vehicle, self._wanted = vehicle, wanted
        self._repetitions: dict[tuple[str, int], Repetition] = {}
        self._recent: dict[Key, Envelope] = {}
        self._arrivals: deque[tuple[int, Key]] = deque()
        self._retained: dict[tuple[str, str], Envelope] = {}  # the newest of each topic and producer
        self._now_ns = 0

    def read(self, recording: Recording, show: Callable[[int], None]) -> None:
        """Process a recording; `show` is called with the number of bytes processed."""
        for count, envelope in enumerate(recording):
            if count % STEP == 0:
                show(recording.position)
            self._now_ns = max(self._now_ns, envelope.received_ns)
            self._keep(envelope)
            row = BY_NAME.get(envelope.producer)
            if row is not None and row.name in self._wanted:
                self._add(envelope, self._repetition(row.name, envelope.incarnation))

    def finish(self) -> list[Repetition]:
        """Compare the rest, and return the repetitions in the order of the data flow."""
        for repetition in self._repetitions.values():
            repetition.advance(self._now_ns, last=True)
        order = list(BY_NAME)
        # An incarnation with retained messages only ended before the recording.
        running = [repetition for repetition in self._repetitions.values() if repetition.running]
        return sorted(running, key=lambda repetition: (order.index(repetition.name), repetition.incarnation))

    def _repetition(self, name: str, incarnation: int) -> Repetition:
        key = (name, incarnation)
        if key not in self._repetitions:
            process = cast(Reactor, load_process(name, self._vehicle))
            self._repetitions[key] = Repetition(name, incarnation, process, self._find)
        return self._repetitions[key]

    def _add(self, envelope: Envelope, repetition: Repetition) -> None:
        branch = envelope.topic.split("/")[0]
        if branch not in ("health", "consumed"):
            repetition.add_message(envelope, compare=True)
            return
        if repetition.add_message(envelope, compare=False):
            message = _decoded(envelope)
            if isinstance(message, ConsumptionOrder):
                repetition.add_journal(message, envelope.received_ns)
            repetition.advance(self._now_ns)

    def _keep(self, envelope: Envelope) -> None:
        """Keep messages that a journal may still name: for a minute, retained ones for a minute after the next."""
        row = topic_of(envelope.topic)
        old: Envelope | None = envelope
        if row is not None and row.retain:
            place = envelope.topic, envelope.producer
            old, self._retained[place] = self._retained.get(place), envelope
        if old is not None:
            self._recent[_key(old)] = old
            self._arrivals.append((self._now_ns, _key(old)))
        while self._arrivals and self._arrivals[0][0] < self._now_ns - RETENTION_NS:
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


def _print(repeated: RepetitionReport, console: Console) -> None:
    table = Table(box=None, pad_edge=False)
    for title in ("process", "started (UTC)", "consumed", "compared", "unrecorded", "verdict"):
        right = title in ("consumed", "compared", "unrecorded")
        table.add_column(title, justify="right" if right else "left", overflow="fold")
    for finding in repeated.findings:
        started = datetime.fromtimestamp(finding.incarnation // 1_000_000_000, UTC)
        numbers = (str(number) for number in (finding.consumed, finding.compared, finding.unrecorded))
        table.add_row(finding.process, f"{started:%m-%d %H:%M:%S}", *numbers, finding.verdict.value)
    if repeated.findings:
        Console().print(table)
    for finding in repeated.findings:
        if finding.reason:
            console.print(f"{finding.process}: {finding.reason}", markup=False, highlight=False)
    verdicts = {finding.verdict for finding in repeated.findings}
    if Verdict.INCOMPLETE in verdicts:
        console.print(INCOMPLETE)
    if Verdict.OTHER_RELEASE in verdicts or not repeated.can:
        console.print(repeated.remedy, markup=False, highlight=False, soft_wrap=True)
