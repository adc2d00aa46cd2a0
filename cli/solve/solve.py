"""`obu solve`: processes a whole recording with layers 2 to 4, and evaluates the solution."""

import gc
import json
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Annotated, cast

import typer
from rich.console import Console
from rich.progress import Progress

from services.core.fusion.process import Config, Process
from services.core.fusion.smoothing.history import HistoryRecorder
from services.core.fusion.smoothing.rts import smoothed_filters
from shared.errors import ConfigError, UserError
from shared.messages.base import Message
from shared.messages.gnss import GnssFix, GnssRaw
from shared.messages.imu import ImuSamples
from shared.messages.navigation import AidingUpdate, NavigationPhase, NavigationSolution, NavigationState, SetUpState
from shared.messages.trust import TrustState
from shared.runtime.config import VehicleFile
from shared.runtime.offline import OfflineUnit

from ..import_drive.estimates.agreement import MotionLog, told
from ..progress import progress_on
from ..recordings.common import open_recording, print_problems, vehicle_of
from ..utc import UtcLine
from .files import write
from .history_file import HistoryFile
from .inputs import Inputs, all_fixes, arrival_of, inputs_of
from .metrics.counters import Counters
from .metrics.errors import errors_against
from .metrics.gnss_alone import GnssAlone, gnss_alone
from .metrics.metrics import Run, Value, metrics_of
from .metrics.trust import Harm, Trust, harm_of
from .outages import Outages
from .overrides import SWITCHES, Aiding, with_settings
from .reference_track import Reference
from .report.report import Heading, document, is_hardly_used, summary
from .set_up import findings
from .smoothing import smoothed_metrics, smoothed_run, smoothed_track
from .track import Track, TrackBuilder
from .truth import any_fixed, given_truth, insist_on_fixes, truth_of_fixes
from .verdicts import VerdictLog

PARSERS = ("parsers.gnss", "parsers.imu")


def solve(  # noqa: PLR0913  # one argument an option
    recording: Annotated[Path, typer.Argument(help="Recording of `obu record` or `obu import`.")],
    *,
    truth: Annotated[
        str | None,
        typer.Option(
            metavar="TRUTH", help="Truth: fixes, recorded, none, or a CSV file; default: as stated in the recording."
        ),
    ] = None,
    vehicle: Annotated[
        Path | None, typer.Option("--vehicle", metavar="FILE", help="Vehicle TOML file; default: the recorded one.")
    ] = None,
    outage: Annotated[
        str | None,
        typer.Option(
            metavar="GAP/PERIOD[@START]",
            help="Simulate GNSS outages: 10/30 is 10 s of every 30 s after the alignment, 60/180@650 is 60 s of every "
            "180 s from 650 s after the first input on.",
        ),
    ] = None,
    score_from: Annotated[
        float,
        typer.Option(
            min=0.0, metavar="SECONDS", help="Seconds after the first input that are excluded from the errors."
        ),
    ] = 0.0,
    aiding: Annotated[
        Aiding | None,
        typer.Option(
            help="Aiding besides GNSS and standstill: free (none), nhc (non-holonomic constraint), odometer (NHC and "
            "speed); default: as in the vehicle file."
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Override a setting of the vehicle, as in the examples; may be repeated.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Output folder; default: name of the recording with -solution."),
    ] = None,
    without: Annotated[
        str | None,
        typer.Option(
            "--without", metavar="trust", help="Leave out core.trust, for comparison: no verdict, nothing is excluded."
        ),
    ] = None,
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Run the Rauch-Tung-Striebel smoother as well: solution_smoothed.csv.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the metrics as one JSON object.")] = False,
) -> int:
    """Process a recording with the whole unit; write solution.csv, solution.kml, metrics.json and report.html.

    Examples:
    [bold]obu solve drive.mcap[/]
    [bold]obu solve drive.mcap --outage 10/30 --out gaps --json[/]
    [bold]obu solve drive.mcap --smooth[/]
    [bold]obu solve drive.mcap --outage 60/180@650 --score-from 350 --aiding nhc[/]
    [bold]obu solve drive.mcap --set core.fusion.gnss.delay_s=0.1[/]
    [bold]obu solve drive.mcap --set core.spoofing.grade=consumer[/]
    [bold]obu solve drive.mcap --without trust --out without-trust[/]
    """
    with_trust = _with_trust(without)
    if outage is not None:
        Outages.parse(outage)  # what is wrong with it is said before the recording is read
    console = Console(stderr=True)
    changes = (*(SWITCHES[aiding] if aiding else ()), *(settings or ()))
    drive = _changed(_read(recording, vehicle, console), changes)
    _check_start(drive, "--score-from", score_from)
    if (outages := _outages(outage, drive)) is not None:
        _check_start(drive, "--outage", (outages.start_ns or 0) * 1e-9)
    given, by_fixes = given_truth(drive.provenance, drive.inputs.truth, truth)
    if by_fixes == "fixes":
        insist_on_fixes(drive.inputs, drive.vehicle)
    folder = _folder(out or Path(f"{recording.stem}-solution"))
    with ExitStack() as stack:
        progress = stack.enter_context(progress_on(console))
        history = stack.enter_context(HistoryFile(folder)) if smooth else None
        solved = _run(drive, outages, progress, history, with_trust=with_trust)
        # All fixes of the recording, those removed by an outage included.
        fixes = solved.fixes if outages is None else all_fixes(drive.inputs, drive.vehicle)
        utc = UtcLine(fixes)
        given = None if given is None else given.on_time_line(utc.offset_ns)
        reference = (
            truth_of_fixes(fixes, _fusion(drive.vehicle))
            if by_fixes == "fixes" or (by_fixes == "perhaps" and any_fixed(fixes))
            else given
        )
        # Nothing of core.trust but an exclusion has an effect on the filter: without one, both runs are the same.
        plain = solved
        if solved.verdicts.excluded and (smooth or (reference is not None and reference.geodetic is not None)):
            # A history for the smoother cannot be rolled back: it is that of the run in which nothing is excluded.
            history = stack.enter_context(HistoryFile(folder)) if smooth else None
            plain = _run(drive, _outages(outage, drive), progress, history, with_trust=False)
        smoothed = _smooth(drive, plain, history, progress) if history is not None else None
    if count := len(drive.inputs.undecodable):
        console.print(
            f"{recording.name}: {count} messages could not be decoded and were skipped{drive.inputs.newer}",
            markup=False,
        )
    scored_from_ns = drive.first_ns + round(score_from * 1e9)
    run = replace(
        _compared(drive, solved, reference, fixes),
        scored_from_ns=scored_from_ns,
        utc_offset_ns=utc.offset_ns,
        trust=_trust(drive, solved, plain, reference, scored_from_ns),
        gnss_alone=_gnss_alone(drive, solved, reference) if reference is given else None,
    )
    metrics = metrics_of(run)
    clocks = _clocks(drive) if is_hardly_used(metrics) else []
    again = None
    if smoothed is not None:
        again = smoothed_run(run, smoothed, reference, drive.vehicle.facts.gnss.lever_arm_body_m)
        metrics |= smoothed_metrics(run, again)
    truth_is = reference.description if reference else "none"
    risk, made = _fusion(drive.vehicle).integrity.risk, drive.provenance.get("made", "")
    facts = _facts(drive, changes, with_trust=with_trust)
    heading = Heading(drive.name, truth_is, outage, facts, risk, made, findings(solved.counters.set_up), clocks)
    write(folder, (run, again), reference, heading, metrics)
    timings: dict[str, Value] = {
        "solve_seconds": round(solved.seconds, 3),
        "realtime_factor": round((drive.last_ns - drive.first_ns) * 1e-9 / solved.seconds, 1),
    }
    if as_json:
        print(json.dumps(document(heading, metrics | timings)))
    else:
        for sentence in summary(heading, metrics):
            print(sentence)
        print(f"Processed in {solved.seconds:.1f} s, {timings['realtime_factor']} times real time.")
        smoothed_too = ", solution_smoothed.csv, solution_smoothed.kml" if smooth else ""
        print(f"Wrote {folder / 'report.html'}, metrics.json, solution.csv, solution.kml{smoothed_too}.")
    return 0


@dataclass(frozen=True)
class Drive:
    """The inputs and the vehicle of a recording."""

    name: str
    file: str
    inputs: Inputs
    vehicle: VehicleFile
    provenance: dict[str, str]

    @property
    def first_ns(self) -> int:
        """Arrival time of the first input."""
        return arrival_of(self.inputs.envelopes[0])

    @property
    def last_ns(self) -> int:
        """Arrival time of the last input."""
        return arrival_of(self.inputs.envelopes[-1])


@dataclass(frozen=True)
class UnitOutputs:
    """The outputs of the unit over the whole recording."""

    builder: TrackBuilder
    counters: Counters
    outages: Outages | None
    verdicts: VerdictLog
    fixes: list[GnssFix]  # inputs of the filter
    seconds: float


def _read(path: Path, vehicle: Path | None, console: Console) -> Drive:
    with open_recording(path) as recording:
        inputs = inputs_of(recording)
        inputs.newer = recording.newer
    gc.freeze()  # the inputs stay, and are not searched for garbage again and again
    print_problems(recording, console)
    _check(path, inputs)
    provenance = recording.metadata.get("provenance", {})
    return Drive(provenance.get("name", path.stem), path.name, inputs, vehicle_of(recording, vehicle), provenance)


def _changed(drive: Drive, changes: tuple[str, ...]) -> Drive:
    """Apply the settings of the command line; raises UserError for invalid ones."""
    try:
        OfflineUnit(drive.vehicle)
    except ConfigError as error:  # of the vehicle file itself
        raise ConfigError(f"{error}{drive.inputs.newer}") from error
    changed = replace(drive, vehicle=with_settings(drive.vehicle, changes))
    try:
        OfflineUnit(changed.vehicle)
    except ConfigError as error:
        given = " --set ".join(changes)
        raise UserError(f"--set {given}: {error.cause}; docs/reference/configuration.md lists all keys") from error
    return changed


def _check(path: Path, inputs: Inputs) -> None:
    if not inputs.topics:
        raise UserError(f"{path} holds no messages of a unit; was the unit running during the recording?")
    if not any(inputs.topics[topic] for topic in ("gnss/raw", "gnss/fix")):
        held = ", ".join(sorted(inputs.topics))
        raise UserError(f"{path} holds neither gnss/raw nor gnss/fix, but {held}; record the GNSS as well")


def _check_start(drive: Drive, option: str, begins_s: float) -> None:
    """Raise UserError if an option begins after the end of the recording and would have no effect."""
    duration_s = (drive.last_ns - drive.first_ns) * 1e-9
    if begins_s > duration_s:
        raise UserError(
            f"{option} begins at {begins_s:g} s, but the duration of {drive.file} is {duration_s:.0f} s; "
            "use an earlier time"
        )


def _with_trust(without: str | None) -> bool:
    """Whether core.trust runs; raises UserError for a word that names nothing that can be left out."""
    if without not in (None, "trust"):
        raise UserError(f"--without {without} is not possible; only core.trust can be left out: --without trust")
    return without is None


def _outages(outage: str | None, drive: Drive) -> Outages | None:
    """Make the outages of one run, for they follow its alignment."""
    if outage is None:
        return None
    outages = Outages.parse(outage)
    outages.recording_ns = drive.first_ns
    return outages


def _run(
    drive: Drive, outages: Outages | None, progress: Progress, history: HistoryFile | None, *, with_trust: bool
) -> UnitOutputs:
    """Run layers 2 to 4 over all inputs, in the order of arrival, as the vehicle does or without core.trust."""
    processes = [name for name in drive.vehicle.processes if with_trust or name != "core.trust"]
    unit, builder, counters = OfflineUnit(drive.vehicle, processes), TrackBuilder(), Counters()
    verdicts = VerdictLog()
    fusion = cast(Process, unit.process("core.fusion"))
    if history is not None:
        period_ns = round(_fusion(drive.vehicle).solution_period_s * 1e9)
        fusion.record_history(HistoryRecorder(history, period_ns))
    fixes: list[GnssFix] = []
    started = time.perf_counter()
    for message in chain(unit.run(_fed(drive, outages, counters, progress)), fusion.finish()):
        match message:
            case NavigationSolution():
                builder.add(message)
            case AidingUpdate():
                counters.add_update(message)
            case NavigationState():
                counters.add_state(message)
                verdicts.add(message)
            case TrustState():
                verdicts.add(message)
            case SetUpState():
                counters.set_up = message
            case GnssFix() if message.latitude_deg is not None:
                fixes.append(message)
    return UnitOutputs(builder, counters, outages, verdicts, fixes, time.perf_counter() - started)


def _clocks(drive: Drive) -> list[str]:
    """What the comparison of the sensors' clocks says, by the motion that each of them measured."""
    logs: dict[type[Message], MotionLog] = {GnssFix: MotionLog(), ImuSamples: MotionLog()}
    for message in OfflineUnit(drive.vehicle, PARSERS).run(drive.inputs.messages(drive.vehicle)):
        if (log := logs.get(type(message))) is not None:
            log.add(message)
    found = {"the IMU": logs[ImuSamples].motion(), "GNSS": logs[GnssFix].motion()}
    return told({name: motion for name, motion in found.items() if motion is not None})


def _smooth(drive: Drive, solved: UnitOutputs, history: HistoryFile, progress: Progress) -> Track:
    """Smooth the filter's history backwards in time."""
    records = progress.track(history.newest_first(), total=len(history), description="smoothing")
    return smoothed_track(smoothed_filters(records), solved.builder.track().valid())


def _fed(drive: Drive, outages: Outages | None, counters: Counters, progress: Progress) -> Iterator[Message]:
    """Yield the inputs one by one, without the GNSS messages within outages."""
    task = progress.add_task("solving", total=len(drive.inputs))
    for number, message in enumerate(drive.inputs.messages(drive.vehicle)):
        if number % 1000 == 0:
            progress.update(task, completed=number)
        if outages is not None and isinstance(message, GnssFix | GnssRaw):
            outages.aligned_ns = counters.aligned_ns
            if outages.hides(message.sampled_ns if isinstance(message, GnssFix) else message.received_ns):
                continue
        yield message


def _compared(drive: Drive, solved: UnitOutputs, reference: Reference | None, fixes: list[GnssFix]) -> Run:
    """Compare the solution with the truth."""
    track = solved.builder.track().valid()
    if not len(track):
        state = solved.counters.state
        reason = f"last state: {state.phase.value}, {state.reason}" if state else "no inertial samples received"
        raise UserError(
            f"the filter was never aligned ({reason}); "
            + (" ".join(_clocks(drive)) or "check lever arm, axes and stamps, or use a longer drive")
        )
    lever_arm = drive.vehicle.facts.gnss.lever_arm_body_m
    outages, aligned_ns = solved.outages, solved.counters.aligned_ns
    delay_ns = round(_fusion(drive.vehicle).gnss.delay_s * 1e9)
    alone = {at_ns + delay_ns for at_ns in track.stamps_of(NavigationPhase.GNSS_ONLY)}  # not offered to the filter
    offered = {fix.sampled_ns for fix in solved.fixes if aligned_ns is not None and fix.sampled_ns >= aligned_ns}
    return Run(
        track,
        solved.counters,
        errors_against(reference, track, lever_arm_b=lever_arm) if reference else None,
        outages.gaps(drive.last_ns) if outages else [],
        drive.first_ns,
        drive.last_ns,
        len(fixes),
        len(fixes) - len(solved.fixes),
        fixes_offered=len(offered - alone),
        alert_limits_m=drive.vehicle.facts.alert_limits_m,
    )


def _gnss_alone(drive: Drive, solved: UnitOutputs, reference: Reference | None) -> GnssAlone | None:
    """Errors of the fixes given to the filter; the truth is not made of them."""
    if reference is None:
        return None
    arm, delay_s = drive.vehicle.facts.gnss.lever_arm_body_m, _fusion(drive.vehicle).gnss.delay_s
    track = solved.builder.track().valid()
    return gnss_alone(solved.fixes, reference, track, lever_arm_b=arm, delay_s=delay_s)


def _trust(
    drive: Drive, solved: UnitOutputs, plain: UnitOutputs, reference: Reference | None, scored_from_ns: int
) -> Trust | None:
    """Verdicts of a run, and its errors over those of the run without core.trust; None if that did not run."""
    if not len(solved.verdicts):
        return None
    lever_arm = drive.vehicle.facts.gnss.lever_arm_body_m
    harm: Harm | None = None
    if reference is not None:
        runs = (made.builder.track().valid() for made in (solved, plain))
        harm = harm_of(reference, *runs, lever_arm_b=lever_arm, since_ns=scored_from_ns)
    return Trust(solved.verdicts.verdicts(drive.first_ns, drive.last_ns), None if harm is None else harm.ratio)


def _folder(path: Path) -> Path:
    """Create the output folder before the processing."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot create the folder {path}: {error.strerror}; choose another one with --out") from error
    return path


def _fusion(vehicle: VehicleFile) -> Config:
    return vehicle.section("core.fusion", Config)


def _facts(drive: Drive, changes: tuple[str, ...], *, with_trust: bool) -> list[tuple[str, str]]:
    files = json.loads(drive.provenance.get("files", "{}"))
    return [
        ("recording", drive.file),
        ("vehicle", drive.vehicle.name),
        *(("set", change) for change in changes),
        *([] if with_trust else [("without", "core.trust")]),
        *((name, f"SHA-256 {digest}") for name, digest in files.items()),
        *((topic, f"{count} messages") for topic, count in sorted(drive.inputs.topics.items())),
    ]
