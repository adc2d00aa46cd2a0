"""Commands that run a unit, its broker or one of its processes."""

import contextlib
import logging
import os
import sys
import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from shared.errors import UserError
from shared.messages.simulation import AttackName
from shared.processes import BY_NAME, Role

from .common import VehicleOption, end_on_sigterm


class BrokerKind(StrEnum):
    """Which broker the demo starts."""

    AUTO = "auto"
    MOSQUITTO = "mosquitto"
    SIMULATED = "simulated"


def demo(  # noqa: PLR0913, PLR0917  # one argument an option
    scenario: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="parking_lot, urban, highway, tunnel, degraded-1 to degraded-5, or degraded."
        ),
    ] = "urban",
    seed: Annotated[int, typer.Option(min=0, metavar="NUMBER", help="Seed of everything random.")] = 1,
    duration: Annotated[
        float | None,
        typer.Option(
            min=1.0,
            metavar="SECONDS",
            help="Seconds to drive, counted from the first message; without it until Ctrl-C.",
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the summary as one JSON object.")] = False,
    port: Annotated[
        int, typer.Option(min=0, max=65535, metavar="PORT", help="Port of the dashboard; if taken, a free one.")
    ] = 8080,
    broker: Annotated[BrokerKind, typer.Option(help="auto: Mosquitto if it is there, else our own.")] = BrokerKind.AUTO,
    attack: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ATTACK",
            help="Repeatable; name@start, name@start:duration or name(parameter=value,...)@start, in seconds. "
            f"Names: {', '.join(AttackName)}.",
        ),
    ] = None,
    role: Annotated[Role, typer.Option(help="obu: a vehicle; rsu: a toll plaza.")] = Role.OBU,
    vehicles: Annotated[
        int, typer.Option(min=1, max=200, metavar="COUNT", help="Vehicles at the toll plaza at a time.")
    ] = 50,
    centre: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Report to the control centre that `obu centre up` runs from this folder."),
    ] = None,
) -> int:
    """Run the whole unit here with simulated sensors: no Docker, no hardware, no account.

    Examples:
    [bold]obu demo[/]
    [bold]obu demo --scenario tunnel --port 8090[/]
    [bold]obu demo --scenario parking_lot --duration 60 --json[/]
    [bold]obu demo --role rsu --vehicles 50 --duration 60 --json[/]
    [bold]obu demo --attack drag_off@60[/]
    [bold]obu demo --centre .obu/centre[/]
    [bold]obu demo --attack "drag_off(accel=0.1,speed=1)@60:120" --attack odometer_freeze@240 --duration 300[/]
    """
    from ..demo.demo import DemoOptions, run

    end_on_sigterm()
    options = DemoOptions(
        scenario, seed, duration, json, port, broker.value, role=role, vehicles=vehicles, attacks=tuple(attack or ()),
        centre=centre,
    )  # fmt: skip
    return run(options)


def up(
    vehicle: VehicleOption = None,
    role: Annotated[
        Role | None, typer.Option(help="What the file must be of; rsu without a file: the example.")
    ] = None,
) -> None:
    """Run every process of a unit under a small supervisor, on the broker of OBU_BROKER.

    Examples:
    [bold]OBU_BROKER=mqtt://127.0.0.1:1883 obu up --vehicle deploy/vehicles/pi.toml[/]
    [bold]obu up --role rsu[/]
    """
    from ..demo.local import unit, unit_file

    logging.basicConfig(level=logging.INFO, format="%(message)s")
    file = unit_file(vehicle, role)
    end_on_sigterm()
    environment = {"OBU_BROKER": _await_broker()}
    if Path(file.path).is_file():
        environment["OBU_VEHICLE"] = str(Path(file.path).resolve())
    supervisor = unit(file, environment)
    try:
        while True:
            supervisor.watch()
            time.sleep(0.2)
    except (KeyboardInterrupt, SystemExit):
        pass
    finally:
        supervisor.stop()


def _await_broker() -> str:
    """Wait for the broker before any process starts, so that its absence is one line and not one a process.

    Returns its address for the processes.
    """
    from shared.runtime.config import broker_address

    from ..demo.local import reaches_broker, start_of_broker

    announced = False
    while True:
        address = broker_address()  # the socket is there once the broker has made it
        try:
            reaches_broker(address)
        except OSError as error:
            if not announced:
                reason = error.strerror or error
                print(
                    f"no broker at {address.place} ({reason}); waiting for it: {start_of_broker(address)}",
                    file=sys.stderr,
                )
                announced = True
            time.sleep(0.5)
        else:
            return os.environ.get("OBU_BROKER") or address.url  # with its credentials


def broker(
    port: Annotated[int, typer.Option(min=1, max=65535, metavar="PORT", help="Port on this machine.")] = 1883,
    kind: Annotated[
        BrokerKind, typer.Option("--broker", help="auto: Mosquitto if it is there, else our own.")
    ] = BrokerKind.AUTO,
    vehicle: VehicleOption = None,
) -> None:
    """Run the broker of a unit on this machine, reachable from here only, until Ctrl-C.

    Its configuration and its kept messages are in the folder `broker` of OBU_STATE. It serves one vehicle: that of the
    file, whose processes find their secrets in the folder `credentials` of OBU_STATE.

    Examples:
    [bold]obu broker --vehicle deploy/vehicles/pi.toml[/]
    [bold]obu broker --port 1884 --broker simulated[/]
    """
    from shared.runtime.config import SOCKET, BrokerAddress, load_vehicle, state_dir

    from ..demo.local import local_broker, port_or_free, reaches_broker

    _, taken = port_or_free(port)
    if taken:
        raise UserError(f"port {port} {taken}: a broker may run already (`obu doctor`); choose another with --port")
    state = state_dir().resolve()
    with contextlib.suppress(OSError):
        reaches_broker(BrokerAddress.at(state / SOCKET))
        raise UserError(f"a broker of {state} runs already (`obu doctor`); end it, or set OBU_STATE to another folder")
    started = local_broker(state, port, kind.value, load_vehicle(vehicle))
    if started.remark:
        print(started.remark, file=sys.stderr)
    print(f"broker at mqtt://127.0.0.1:{port}   (end with Ctrl-C)", flush=True)
    if started.address.socket is not None:
        print(f"for the unit's own processes: {started.address.url}", flush=True)
    os.execvp(started.command[0], started.command)


def run(
    process: Annotated[
        str, typer.Argument(help="Name of the process, such as core.fusion; `obu topics --processes` lists them.")
    ],
    vehicle: VehicleOption = None,
) -> None:
    """Run one process.

    Example: [bold]obu run core.fusion --vehicle deploy/vehicles/pi.toml[/]
    """
    import difflib

    from shared.runtime.config import load_vehicle
    from shared.runtime.live import run_process

    if process not in BY_NAME:
        near = difflib.get_close_matches(process, BY_NAME, n=1)
        hint = f"did you mean {near[0]}?" if near else "`obu topics --processes` lists them"
        raise UserError(f"there is no process {process!r}; {hint}")
    run_process(process, load_vehicle(vehicle), lambda: load_vehicle(vehicle))
