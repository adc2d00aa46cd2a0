"""`obu calibrate spoofing`: learns the profile of the 5 s metrics from recorded drives."""

import json
from collections.abc import Iterator
from datetime import UTC, datetime
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Annotated, cast

import typer
from rich.console import Console
from rich.progress import Progress, TaskID
from rich.table import Table

from services.core.spoofing import profile as learning
from services.core.spoofing.process import Process
from services.core.spoofing.profile import (
    FORCE_EDGES_M_S2,
    SPEED_EDGES_M_S,
    SPEED_METRICS,
    LearnedDrive,
    Origin,
    Profile,
)
from services.core.spoofing.windows.metrics import UNITS
from services.core.spoofing.windows.short_window import Window
from shared import VERSION
from shared.errors import UserError
from shared.messages.base import Message
from shared.messages.trust import TrustMonitor
from shared.runtime.offline import OfflineUnit

from ..output_file import insist_on_new, write_text
from ..progress import progress_on
from ..recordings.common import open_recording, print_problems, vehicle_of
from ..solve.inputs import arrival_of, inputs_of

PROCESSES = ("parsers.gnss", "parsers.imu", "parsers.can", "core.fusion", "core.spoofing")


def calibrate_spoofing(
    drives: Annotated[list[Path], typer.Argument(help="Recordings without spoofing, ten minutes or more in all.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="The profile to write.")] = Path(
        "profile.json"
    ),
    vehicle: Annotated[
        Path | None,
        typer.Option("--vehicle", metavar="FILE", help="Vehicle TOML file; default: the one in each recording."),
    ] = None,
    threshold: Annotated[
        float | None,
        typer.Option(
            min=1.0,
            metavar="VALUE",
            help="Standard deviations; default: the least from 5 on with no alarm, and a tolerance.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the profile as one JSON object.")] = False,
) -> int:
    """Learn the standard deviations of GNSS against the inertial sensors, for each class of dynamics.

    Examples:
    [bold]obu calibrate spoofing monday.mcap tuesday.mcap -o profile.json[/]
    [bold]obu calibrate spoofing drive.mcap --vehicle deploy/vehicles/pi.toml --threshold 6.5[/]
    """
    insist_on_new(output, "--output")
    console = Console(stderr=True)
    windows: list[Window] = []
    long: list[float] = []
    origins: list[Origin] = []
    learned: list[LearnedDrive] = []
    with progress_on(console) as progress:
        for path in drives:
            drive, origin, found, statistics = _learned(path, vehicle, console, progress)
            windows += found
            long += statistics
            origins.append(origin)
            learned.append(drive)
            if different := origins[0].differences(origin).values():
                raise UserError(
                    f"{drive.file} is of another unit than {learned[0].file} ({'; '.join(different)}); learn one for "
                    "each"
                )
    profile = _profile(windows, origins[0].model_copy(update={"code": _code(), "drives": tuple(learned)}), threshold,
                       long)  # fmt: skip
    write_text(output, profile.model_dump_json(indent=2) + "\n", "--output")
    if as_json:
        print(json.dumps(profile.model_dump(mode="json")))
    else:
        _print(profile, windows, output)
    return 0


def _learned(
    path: Path, vehicle: Path | None, console: Console, progress: Progress
) -> tuple[LearnedDrive, Origin, list[Window], list[float]]:
    """Run fusion and the monitors over a recording; give its windows and the statistics of the long tests."""
    with open_recording(path) as recording:
        inputs, file = inputs_of(recording), vehicle_of(recording, vehicle)
    print_problems(recording, console)
    unit = OfflineUnit(file, PROCESSES)
    process = cast(Process, unit.process("core.spoofing"))
    windows: list[Window] = []
    long: list[float] = []
    task = progress.add_task(f"learning from {path.name}", total=len(inputs))
    for message in unit.run(_counted(inputs.messages(file), progress, task)):
        window = process.monitor.window
        if isinstance(message, TrustMonitor) and window is not None and window not in windows[-1:]:
            windows.append(window)
            long += process.monitor.long_statistics.values()
    origin = process.origin
    if origin is None or not windows:
        raise UserError(
            f"{path} holds no 5 s in which GNSS velocity and inertial samples could be compared; give a drive of ten "
            "minutes with both, in which fusion found its heading"
        )
    times_ns = arrival_of(inputs.envelopes[0]), arrival_of(inputs.envelopes[-1])
    with path.open("rb") as opened:
        digest = file_digest(opened, "sha256").hexdigest()
    date = datetime.fromtimestamp(times_ns[0] // 10**9, UTC).isoformat()
    drive = LearnedDrive(
        file=path.name, sha256=digest, date=date, duration_s=(times_ns[1] - times_ns[0]) / 1e9, windows=len(windows)
    )
    return drive, origin, windows, long


def _counted(messages: Iterator[Message], progress: Progress, task: TaskID) -> Iterator[Message]:
    for number, message in enumerate(messages):
        if number % 1000 == 0:
            progress.update(task, completed=number)
        yield message


def _profile(windows: list[Window], origin: Origin, threshold: float | None, long: list[float]) -> Profile:
    duration_s = sum(drive.duration_s for drive in origin.drives)
    provenance = (
        f"{len(windows)} windows of {len(origin.drives)} recorded drives, {duration_s:.0f} s, the first of "
        f"{origin.drives[0].date}; IMU {origin.imu}, GNSS {origin.gnss}"
    )
    try:
        profile = learning.learn(windows, threshold=threshold, provenance=provenance, long_statistics=long)
    except ValueError as error:
        raise UserError(f"{error}; give more recordings") from error
    return profile.model_copy(update={"origin": origin})


def _code() -> str:
    """Version of the package, and digest of the code that the metrics come from."""
    digest = sha256()
    for path in sorted(Path(learning.__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return f"{VERSION}+{digest.hexdigest()[:12]}"


def _print(profile: Profile, windows: list[Window], output: Path) -> None:
    table = Table(box=None, pad_edge=False)
    for title in ("metric", "unit", "class 1", "class 2", "class 3", "class 4"):
        table.add_column(title, justify="left" if title in ("metric", "unit") else "right")
    for metric, values in profile.sigma.items():
        table.add_row(metric.value, UNITS[metric], *(f"{value:.4f}" for value in values))
    console = Console()
    console.print(table)
    speeds, forces = (", ".join(f"{edge:g}" for edge in edges) for edges in (SPEED_EDGES_M_S, FORCE_EDGES_M_S2))
    names = ", ".join(metric.value for metric in SPEED_METRICS)
    _, episodes = learning.alarms_of(windows, profile)
    for line in (
        f"Standard deviations; classes of {names} end at {speeds} m/s, those of accelerations at {forces} m/s2.",
        f"Threshold {profile.threshold:.1f} standard deviations: {episodes} alarms in {len(windows)} windows of 5 s.",
        f"Free propagations over 30 to 120 s: standard deviations times {profile.long_factor:.2f}.",
        f'Wrote {output}; next: put `profile = "{output.name}"` under [core.spoofing] of the vehicle file beside it.',
    ):
        console.print(line, soft_wrap=True, markup=False, highlight=False)
