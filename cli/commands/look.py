"""Commands that look at a unit, at its machine and at its contract; and the one that sends it a command."""

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from shared.messages.operation import OperatorCommand

from .common import VehicleOption, end_on_sigterm


def topics(
    processes: Annotated[bool, typer.Option("--processes", help="List the processes instead.")] = False,
) -> None:
    """Print the contract of the bus: topics, or processes; `obu schemas bus` prints the messages as well.

    Examples:
    [bold]obu topics[/]
    [bold]obu topics --processes[/]
    """
    from shared.bus import contract

    print(contract.processes_table() if processes else contract.topics_table())


class Interface(StrEnum):
    """What other programs build on."""

    BUS = "bus"
    CENTRE = "centre"
    API = "api"


def schemas(
    interface: Annotated[
        Interface, typer.Argument(help="bus, centre (the link to a control centre): AsyncAPI 3.0. api: OpenAPI 3.1.")
    ],
) -> None:
    """Print the description of an interface for programs, with the schema of every message or answer.

    Examples:
    [bold]obu schemas bus > asyncapi.json[/]
    [bold]obu schemas centre > asyncapi-centre.json[/]
    [bold]obu schemas api > openapi.json[/]
    """
    from ..schemas import documents

    print(json.dumps(documents()[interface], indent=1, ensure_ascii=False))


def tail(
    topic: Annotated[str, typer.Argument(help="Short name such as navigation/solution, or '#' for all.")] = "#",
    vehicle: VehicleOption = None,
    count: Annotated[int | None, typer.Option(min=1, metavar="COUNT", help="Stop after this many messages.")] = None,
    raw: Annotated[
        bool, typer.Option("--raw", help="Write the device's own bytes instead, for a pipe or a file.")
    ] = False,
) -> int:
    """Print the messages of a running unit as they are received, one per line.

    The broker is that of OBU_BROKER; a demo prints the line to copy.

    Examples:
    [bold]obu tail navigation/solution --count 3[/]
    [bold]obu tail '#'[/]
    [bold]obu tail --raw gnss/raw > receiver.ubx[/]
    """
    from shared.runtime.config import load_vehicle

    from ..tail import follow

    end_on_sigterm()
    return follow(topic, load_vehicle(vehicle), count, raw=raw)


def command(
    what: Annotated[OperatorCommand, typer.Argument(help="What the unit shall do.")],
    *,
    source: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Device, as mode/state lists it; default: the receiver in use. select_source without a name leaves "
            "the choice to the unit.",
        ),
    ] = None,
    period: Annotated[
        float | None, typer.Option(min=0.04, max=10.0, metavar="SECONDS", help="Period of fixes, of navigation_rate.")
    ] = None,
    vehicle: VehicleOption = None,
    wait: Annotated[bool, typer.Option(help="Wait until it is done; otherwise until it is accepted.")] = True,
) -> int:
    """Send a command to the unit that runs on this computer, and print whether it is accepted, done or failed.

    The exit code is 0 if it is done, and 1 if it has failed.

    Examples:
    [bold]obu command cold_start[/]
    [bold]obu command navigation_rate --period 0.2 --source gnss0[/]
    [bold]obu command select_source --source imu1[/]
    [bold]obu command calibrate_at_rest[/]
    [bold]obu command confirm_position[/]
    [bold]obu command crossing_begin[/]
    """
    from shared.runtime.config import load_vehicle

    from ..command import send

    end_on_sigterm()
    return send(what, load_vehicle(vehicle), source=source, period_s=period, wait=wait)


def doctor(
    vehicle: VehicleOption = None,
    probe: Annotated[
        bool,
        typer.Option(
            "--probe", help="Ask devices that are silent, and look at all serial ports: this writes to the ports."
        ),
    ] = False,
) -> int:
    """Check this machine, its configuration and a running unit, and name the remedy of each fault.

    It listens to each port, at six rates if need be, and says what its device speaks.

    Examples:
    [bold]obu doctor[/]
    [bold]obu doctor --probe[/]   (no device is named yet: what is plugged in?)
    [bold]obu doctor --vehicle deploy/vehicles/pi.toml[/]
    """
    from ..doctor import examine

    return examine(vehicle, probe=probe)


def reference(root: Annotated[Path, typer.Argument(help="Folder of the repository.")] = Path()) -> None:
    """Print from code what the repository holds of it: docs/reference, the architecture's picture, obu.target."""
    from ..reference.pages import write

    for path in write(root):
        print(path)
