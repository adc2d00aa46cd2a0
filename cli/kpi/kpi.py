"""`obu kpi`: key performance indicators of a recording."""

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Annotated, cast

import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from services.core.fusion.process import Config, Process
from shared.bus.envelope import Envelope
from shared.errors import BadPayload, UserError
from shared.messages.base import Message
from shared.messages.gnss import GnssFix, GnssSatellites
from shared.messages.navigation import NavigationSolution, NavigationState
from shared.messages.power import PowerState
from shared.messages.trust import TrustState
from shared.recording import Recording
from shared.runtime.config import VehicleFile
from shared.runtime.offline import OfflineUnit

from ..output_file import insist_on_place
from ..progress import progress_on
from ..recordings.common import open_recording, print_problems, vehicle_of
from ..solve.inputs import Inputs, arrival_of, inputs_of
from ..solve.metrics.errors import errors_against
from ..solve.metrics.gnss_alone import gnss_alone
from ..solve.reference_track import Reference
from ..solve.track import Track, TrackBuilder
from ..solve.truth import any_fixed, given_truth, insist_on_fixes, truth_of_fixes
from ..solve.verdicts import VerdictLog
from ..utc import UtcLine
from .indicators import INDICATORS, DriveObservations, Value, indicators_of
from .page import as_shown, page

DAY_NS, MOST_DAYS = 86_400 * 10**9, 7  # beyond it a stamp is wrong
OUTPUT_TOPICS = ("navigation/solution", "navigation/state", "trust/state", "gnss/fix", "gnss/satellites", "power/state")


def kpi(
    recording: Annotated[Path, typer.Argument(help="Recording of the unit, of `obu record` or `obu import`.")],
    *,
    truth: Annotated[
        str | None,
        typer.Option(
            metavar="TRUTH", help="Truth: fixes, recorded, none, or a CSV file; default: as stated in the recording."
        ),
    ] = None,
    anew: Annotated[
        bool, typer.Option("--anew", help="Solve the recording anew, in place of what the unit said while it drove.")
    ] = False,
    vehicle: Annotated[
        Path | None, typer.Option("--vehicle", metavar="FILE", help="Vehicle TOML file; default: the recorded one.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FILE", help="Write a page with the table as well, such as kpi.html."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the indicators as one JSON object.")] = False,
) -> int:
    """Compute accuracy, availability, continuity, integrity, geometry and times of a drive.

    What the unit said while it drove is evaluated; a recording without a solution, as of `obu import`, is solved first.
    Times to the first fix after restarts of a receiver: `obu kpi ttff --help`.

    Examples:
    [bold]obu kpi drive.mcap[/]
    [bold]obu kpi drive.mcap --json[/]
    [bold]obu kpi drive.mcap --anew --truth reference.csv --out kpi.html[/]
    """
    if out is not None:
        insist_on_place(out)
    console = Console(stderr=True)
    with open_recording(recording) as opened:
        inputs, file = inputs_of(opened), vehicle_of(opened, vehicle)
        provenance = opened.metadata.get("provenance", {})
        if not inputs.envelopes:
            raise UserError(f"{recording} holds no data of devices; was the unit running during the recording?")
        if (days := (arrival_of(inputs.envelopes[-1]) - arrival_of(inputs.envelopes[0])) / DAY_NS) > MOST_DAYS:
            raise UserError(f"{recording} spans {days:.0f} days by its stamps; a clock is wrong; import it again")
        anew = anew or "navigation/solution" not in inputs.topics
        reference, by_fixes = given_truth(provenance, inputs.truth, truth)
        if by_fixes == "fixes" and anew:
            insist_on_fixes(inputs, file)
        with progress_on(console) as progress:
            seen = _solved(inputs, file, progress) if anew else _recorded(opened, inputs, progress)
    print_problems(opened, console)
    if reference is not None:
        reference = reference.on_time_line(UtcLine(seen.fixes).offset_ns)
    if by_fixes == "fixes" or (by_fixes == "perhaps" and any_fixed(seen.fixes)):
        reference = truth_of_fixes(seen.fixes, file.section("core.fusion", Config))
        values = indicators_of(_observed(inputs, file, seen, reference, independent=False))
    else:
        values = indicators_of(_observed(inputs, file, seen, reference, independent=True))
    source = "solved anew from the recorded devices" if anew else "as the unit gave it while it drove"
    described = reference.description if reference else "none"
    if out is not None:
        _write(out, page(provenance.get("name", recording.stem), described, source, values))
    if as_json:
        print(json.dumps({"recording": recording.name, "solution": source, "truth": described, **values}))
        return 0
    Console().print(_table(values))
    print(f"Solution: {source}. Truth: {described}.")
    print(f"Wrote {out}." if out is not None else "A page with the table: --out kpi.html.")
    return 0


@dataclass
class DriveCollector:
    """What is collected of a drive."""

    solutions: TrackBuilder = field(default_factory=TrackBuilder)
    verdicts: VerdictLog = field(default_factory=VerdictLog)
    fixes: list[GnssFix] = field(default_factory=list)
    satellites: list[GnssSatellites] = field(default_factory=list)
    power: list[PowerState] = field(default_factory=list)

    def add(self, message: Message) -> None:
        """Take a message of the unit."""
        match message:
            case NavigationSolution():
                self.solutions.add(message)
            case TrustState() | NavigationState():
                self.verdicts.add(message)
            case GnssFix() if message.latitude_deg is not None and message.longitude_deg is not None:
                self.fixes.append(message)
            case GnssSatellites():
                self.satellites.append(message)
            case PowerState():
                self.power.append(message)

    @property
    def track(self) -> Track:
        """The valid solutions."""
        return self.solutions.track().valid()


def _recorded(recording: Recording, inputs: Inputs, progress: Progress) -> DriveCollector:
    seen = DriveCollector()
    shown = progress.track(recording, total=inputs.topics.total(), description="reading")
    for message in _decoded(shown):
        seen.add(message)
    return seen


def _decoded(envelopes: Iterable[Envelope]) -> Iterator[Message]:
    for envelope in envelopes:
        if envelope.topic in OUTPUT_TOPICS:
            try:
                yield envelope.decode()
            except BadPayload:  # counted by `inputs_of` where it matters, and no indicator needs every message
                continue


def _solved(inputs: Inputs, vehicle: VehicleFile, progress: Progress) -> DriveCollector:
    seen, unit = DriveCollector(), OfflineUnit(vehicle)
    fusion = cast(Process, unit.process("core.fusion"))
    shown = progress.track(inputs.messages(vehicle), total=len(inputs), description="solving")
    for message in chain(unit.run(shown), fusion.finish()):
        seen.add(message)
    return seen


def _observed(
    inputs: Inputs, vehicle: VehicleFile, seen: DriveCollector, reference: Reference | None, *, independent: bool
) -> DriveObservations:
    """Put a drive together; the receiver is compared with a truth that is not made of its fixes only."""
    first_ns, last_ns = arrival_of(inputs.envelopes[0]), arrival_of(inputs.envelopes[-1])
    facts, track = vehicle.facts, seen.track
    arm = facts.gnss.lever_arm_body_m
    delay_s = vehicle.section("core.fusion", Config).gnss.delay_s
    compared = reference is not None and len(track) > 1
    return DriveObservations(
        first_ns=first_ns,
        last_ns=last_ns,
        track=track,
        verdicts=seen.verdicts.verdicts(first_ns, last_ns) if len(seen.verdicts) else None,
        fixes=seen.fixes,
        satellites=seen.satellites,
        power=seen.power,
        errors=errors_against(reference, track, lever_arm_b=arm) if compared and reference is not None else None,
        gnss_alone=(
            gnss_alone(seen.fixes, reference, track, lever_arm_b=arm, delay_s=delay_s)
            if compared and independent and reference is not None
            else None
        ),
        alert_limits_m=facts.alert_limits_m,
    )


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}; choose another path with --out") from error


def _table(values: dict[str, Value]) -> Table:
    table = Table(box=None, pad_edge=False)
    for title in ("indicator", "value", "meaning"):
        table.add_column(title, justify="right" if title == "value" else "left")
    for row in INDICATORS:
        if values[row.name] is not None:
            table.add_row(row.name, as_shown(row.name, values[row.name], row.unit), row.meaning)
    return table
