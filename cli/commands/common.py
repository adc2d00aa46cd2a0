"""What commands share: the option of the vehicle's file, and their end by SIGTERM."""

import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer

VehicleOption = Annotated[
    Path | None,
    typer.Option(
        "--vehicle", metavar="FILE", help="The vehicle's TOML file; without it OBU_VEHICLE, else all defaults."
    ),
]


def end_on_sigterm(status: int = 0) -> None:
    """Raise `SystemExit` on SIGTERM, so that everything started here is ended."""

    def end(_number: int, _frame: FrameType | None) -> None:
        sys.exit(status)

    signal.signal(signal.SIGTERM, end)
