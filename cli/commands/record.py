"""`obu record`: records a running unit."""

from pathlib import Path
from typing import Annotated

import typer

from .common import VehicleOption, end_on_sigterm


def record(
    context: typer.Context,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="The recording to write; without it a name of the moment."),
    ] = None,
    duration: Annotated[
        float | None, typer.Option(min=0.1, metavar="SECONDS", help="Seconds to record; without it until Ctrl-C.")
    ] = None,
    vehicle: VehicleOption = None,
) -> int | None:
    """Record every message of a running unit, beside its own recorder.

    Examples:
    [bold]obu record -o drive.mcap[/]
    [bold]obu record --duration 60[/]
    [bold]obu record repair cut.mcap -o whole.mcap[/]
    """
    if context.invoked_subcommand is not None:
        return None
    from ..recordings import record as work

    end_on_sigterm()
    return work.record(output, duration, vehicle)
