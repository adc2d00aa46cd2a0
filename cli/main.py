"""The command line: one line a command, its work in a file of its own."""

import contextlib
import functools
import json
import logging
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer

from shared import VERSION
from shared.errors import UserError
from shared.messages.operation import OperatorCommand
from shared.messages.simulation import AttackName
from shared.processes import BY_NAME, Role
from shared.runtime.config import load_vehicle

IN_MODULES = {  # commands that are imported when they are called: NumPy and the filter take seconds
    "import": ("import_drive.import_drive", "import_drive"),
    "solve": ("solve.solve", "solve"),
    "kpi": ("kpi.kpi", "kpi"),
    "attack-lab": ("attack_lab.attack_lab", "attack_lab"),
    "replay": ("recordings.replay", "replay"),
    "export": ("export.export", "export"),
    "verify": ("recordings.verify", "verify"),
    "verify-toll": ("verify_toll", "verify_toll"),
    "migrate": ("migrate", "migrate"),
    "enrol": ("enrol", "enrol"),
    "centre up": ("centre.centre", "up"),
    "centre run": ("centre.centre", "run"),
    "centre prepare": ("centre.centre", "prepare"),
    "centre token": ("centre.vehicles", "token"),
    "centre tokens": ("centre.vehicles", "tokens"),
    "centre vehicles": ("centre.vehicles", "vehicles"),
    "centre revoke": ("centre.vehicles", "revoke"),
    "centre erase": ("centre.vehicles", "erase"),
    "centre retain": ("centre.vehicles", "retain"),
    "centre tenant add": ("centre.tenants", "tenant_add"),
    "centre tenant list": ("centre.tenants", "tenant_list"),
    "centre tenant retention": ("centre.tenants", "tenant_retention"),
    "centre tenant budget": ("centre.tenants", "tenant_budget"),
    "centre tenant web-hook": ("centre.tenants", "tenant_web_hook"),
    "centre account add": ("centre.tenants", "account_add"),
    "centre account list": ("centre.tenants", "account_list"),
    "centre account disable": ("centre.tenants", "account_disable"),
    "fleet run": ("fleet.run", "run"),
    "fleet simulate": ("fleet.simulate", "simulate"),
    "evidence-key show": ("evidence_key", "show"),
    "evidence-key rotate": ("evidence_key", "rotate"),
    "evidence-key export": ("evidence_key", "export"),
    "calibrate imu": ("calibrate.imu", "calibrate_imu"),
    "calibrate spoofing": ("calibrate.spoofing", "calibrate_spoofing"),
    "token list": ("token", "list_tokens"),
    "token add": ("token", "add_token"),
    "token revoke": ("token", "revoke_token"),
    "token show-link": ("token", "show_link"),
    "record repair": ("recordings.record", "repair"),
}


app = typer.Typer(
    epilog="Begin with [bold]obu demo[/]. The help of each command has examples, such as [bold]obu solve --help[/].",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)

papers = typer.Typer(
    help="Reproduce what the published papers report.\n\nExample: [bold]obu papers navigation --runs 2[/]",
    no_args_is_help=True,
)
app.add_typer(papers, name="papers")
calibrate = typer.Typer(
    help="Learn settings of the unit from recorded drives.\n\n"
    "Example: [bold]obu calibrate spoofing drive.mcap -o profile.json[/]",
    no_args_is_help=True,
)
app.add_typer(calibrate, name="calibrate")
evidence_key = typer.Typer(
    help="The key with which this unit signs recordings and charges.\n\n"
    "Example: [bold]obu evidence-key export -o car.pub[/]",
    no_args_is_help=True,
)
app.add_typer(evidence_key, name="evidence-key")
tokens = typer.Typer(
    help="Decide who may open the page of the unit whose state is in OBU_STATE, and what they may do.\n\n"
    "A token is shown once, when it is made; the unit keeps its hash only. A running unit sees changes at once.\n\n"
    "Examples:\n[bold]obu token show-link[/]\n[bold]obu token add workshop --role view[/]\n"
    "[bold]obu token revoke workshop[/]",
    no_args_is_help=True,
)
app.add_typer(tokens, name="token")
centre = typer.Typer(
    help="Run and manage a control centre, to which vehicles report.\n\nExample: [bold]obu centre up[/]",
    no_args_is_help=True,
)
app.add_typer(centre, name="centre")
tenant = typer.Typer(
    help="Tenants: each sees its own vehicles only.\n\nExample: [bold]obu centre tenant list[/]", no_args_is_help=True
)
centre.add_typer(tenant, name="tenant")
account = typer.Typer(
    help="Accounts for the pages of the centre.\n\nExample: [bold]obu centre account add anna --role admin[/]",
    no_args_is_help=True,
)
centre.add_typer(account, name="account")
fleet = typer.Typer(
    help="Many recordings, and many vehicles, by one command.\n\n"
    "Example: [bold]obu fleet run solve drives/ --out solved[/]",
    no_args_is_help=True,
)
app.add_typer(fleet, name="fleet")
recordings = typer.Typer()
app.add_typer(recordings, name="record")
keys_app = typer.Typer(
    help="Make and manage the secrets with which processes and programs identify themselves to the broker.\n\n"
    "Example: [bold]obu keys add fleet-gateway --read[/]",
    no_args_is_help=True,
)
app.add_typer(keys_app, name="keys")

VehicleOption = Annotated[
    Path | None,
    typer.Option(
        "--vehicle", metavar="FILE", help="The vehicle's TOML file; without it OBU_VEHICLE, else all defaults."
    ),
]


class BrokerKind(StrEnum):
    """Which broker the demo starts."""

    AUTO = "auto"
    MOSQUITTO = "mosquitto"
    SIMULATED = "simulated"


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"obu {VERSION}")
        raise typer.Exit()


@app.callback()
def _program(
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """A vehicle on-board unit: position, velocity and attitude of the vehicle, with their integrity."""


@app.command()
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
) -> None:
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
    from .demo.demo import DemoOptions, run

    _end_on_sigterm()
    options = DemoOptions(
        scenario, seed, duration, json, port, broker.value, role=role, vehicles=vehicles, attacks=tuple(attack or ()),
        centre=centre,
    )  # fmt: skip
    raise typer.Exit(run(options))


@app.command()
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
    from .demo.local import unit, unit_file

    logging.basicConfig(level=logging.INFO, format="%(message)s")
    file = unit_file(vehicle, role)
    _end_on_sigterm()
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

    from .demo.local import reaches_broker, start_of_broker

    told = False
    while True:
        address = broker_address()  # the socket is there once the broker has made it
        try:
            reaches_broker(address)
        except OSError as error:
            if not told:
                reason = error.strerror or error
                print(
                    f"no broker at {address.place} ({reason}); waiting for it: {start_of_broker(address)}",
                    file=sys.stderr,
                )
                told = True
            time.sleep(0.5)
        else:
            return os.environ.get("OBU_BROKER") or address.url  # with its credentials


@app.command()
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
    from shared.runtime.config import SOCKET, BrokerAddress, state_dir

    from .demo.local import local_broker, port_or_free, reaches_broker

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


@keys_app.command("make")
def keys_make(
    vehicle: VehicleOption = None,
    files: Annotated[
        Path | None,
        typer.Option(
            "--broker-files", metavar="FOLDER", help="Where the broker's password file and access list are written."
        ),
    ] = None,
    owner: Annotated[
        str | None, typer.Option("--broker-user", metavar="USER", help="Who may read them: the broker's user.")
    ] = None,
    group: Annotated[
        str | None, typer.Option("--group", metavar="GROUP", help="Share the state folder with this group.")
    ] = None,
    containers: Annotated[
        bool, typer.Option("--containers", help="Give each secret to the user of its container.")
    ] = False,
    socket_folder: Annotated[
        Path | None,
        typer.Option("--socket-folder", metavar="FOLDER", help="Make the folder of the socket, for that group."),
    ] = None,
) -> None:
    """Make the secrets that are missing, and the files by which the broker checks them; what exists is kept.

    `obu demo`, `obu broker`, the containers and install.sh do it themselves.

    Examples:
    [bold]obu keys make --vehicle deploy/vehicles/pi.toml[/]
    [bold]obu keys make --broker-files /etc/obu/broker --broker-user mosquitto --group obu[/]
    """
    from .keys import make

    raise typer.Exit(make(vehicle, files, owner, group, containers=containers, socket_folder=socket_folder))


@keys_app.command("list")
def keys_list() -> None:
    """List who has a secret; never the secret.

    Example: [bold]sudo obu keys list[/]
    """
    from .keys import show

    raise typer.Exit(show())


@keys_app.command("add")
def keys_add(
    name: Annotated[str, typer.Argument(help="Name of the new user, such as fleet-gateway.")],
    read: Annotated[bool, typer.Option("--read", help="It may read every topic, and write none.")] = False,
) -> None:
    """Add a user of the bus that is no part of the unit, and print its secret.

    Example: [bold]obu keys add fleet-gateway --read[/]
    """
    from .keys import add

    if not read:
        raise UserError("a further user may only read: add --read")
    raise typer.Exit(add(name))


@keys_app.command("remove")
def keys_remove(name: Annotated[str, typer.Argument(help="Name of the user.")]) -> None:
    """Remove a user of `obu keys add`.

    Example: [bold]obu keys remove fleet-gateway[/]
    """
    from .keys import remove

    raise typer.Exit(remove(name))


@keys_app.command("tls")
def keys_tls(
    names: Annotated[list[str], typer.Argument(help="Names and addresses under which other machines reach the unit.")],
) -> None:
    """Make a certificate, so that the broker may listen for other machines.

    Example: [bold]obu keys tls car.local 192.168.1.7[/]
    """
    from .keys import tls

    raise typer.Exit(tls(names))


@keys_app.command("rotate")
def keys_rotate(name: Annotated[str | None, typer.Argument(help="Whose secret; without it all.")] = None) -> None:
    """Replace secrets, as after somebody has read them.

    Example: [bold]obu keys rotate observer.1[/]
    """
    from .keys import rotate

    raise typer.Exit(rotate(name))


@app.command()
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

    from shared.runtime.live import run_process

    if process not in BY_NAME:
        near = difflib.get_close_matches(process, BY_NAME, n=1)
        hint = f"did you mean {near[0]}?" if near else "`obu topics --processes` lists them"
        raise UserError(f"there is no process {process!r}; {hint}")
    run_process(process, load_vehicle(vehicle))


@app.command()
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


@app.command()
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
    from .schemas import documents

    print(json.dumps(documents()[interface], indent=1, ensure_ascii=False))


@app.command()
def tail(
    topic: Annotated[str, typer.Argument(help="Short name such as navigation/solution, or '#' for all.")] = "#",
    vehicle: VehicleOption = None,
    count: Annotated[int | None, typer.Option(min=1, metavar="COUNT", help="Stop after this many messages.")] = None,
    raw: Annotated[
        bool, typer.Option("--raw", help="Write the device's own bytes instead, for a pipe or a file.")
    ] = False,
) -> None:
    """Print the messages of a running unit as they are received, one per line.

    The broker is that of OBU_BROKER; a demo prints the line to copy.

    Examples:
    [bold]obu tail navigation/solution --count 3[/]
    [bold]obu tail '#'[/]
    [bold]obu tail --raw gnss/raw > receiver.ubx[/]
    """
    from .tail import follow

    _end_on_sigterm()
    raise typer.Exit(follow(topic, load_vehicle(vehicle), count, raw=raw))


@app.command()
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
) -> None:
    """Send a command to the unit that runs on this computer, and print whether it is accepted, done or failed.

    The exit code is 0 if it is done, and 1 if it has failed.

    Examples:
    [bold]obu command cold_start[/]
    [bold]obu command navigation_rate --period 0.2 --source gnss0[/]
    [bold]obu command select_source --source imu1[/]
    [bold]obu command calibrate_at_rest[/]
    [bold]obu command confirm_position[/]
    """
    from .command import send

    _end_on_sigterm()
    raise typer.Exit(send(what, load_vehicle(vehicle), source=source, period_s=period, wait=wait))


@app.command()
def doctor(
    vehicle: VehicleOption = None,
    probe: Annotated[
        bool,
        typer.Option(
            "--probe", help="Ask devices that are silent, and look at all serial ports: this writes to the ports."
        ),
    ] = False,
) -> None:
    """Check this machine, its configuration and a running unit, and name the remedy of each fault.

    It listens to each port, at six rates if need be, and says what its device speaks.

    Examples:
    [bold]obu doctor[/]
    [bold]obu doctor --probe[/]   (no device is named yet: what is plugged in?)
    [bold]obu doctor --vehicle deploy/vehicles/pi.toml[/]
    """
    from .doctor import examine

    raise typer.Exit(examine(vehicle, probe=probe))


@app.command(hidden=True)
def reference(root: Annotated[Path, typer.Argument(help="Folder of the repository.")] = Path()) -> None:
    """Print from code what the repository holds of it: docs/reference, the architecture's picture, obu.target."""
    from .reference.pages import write

    for path in write(root):
        print(path)


def _ended(function: Callable[..., int]) -> Callable[..., None]:
    """Turn a function that returns its exit code into a command; one that SIGTERM ends has not succeeded."""

    @functools.wraps(function)
    def command(**arguments: object) -> None:
        _end_on_sigterm(128 + signal.SIGTERM)
        raise typer.Exit(function(**arguments))

    return command


def _end_on_sigterm(status: int = 0) -> None:
    """Raise `SystemExit` on SIGTERM, so that everything started here is ended."""

    def end(_number: int, _frame: FrameType | None) -> None:
        sys.exit(status)

    signal.signal(signal.SIGTERM, end)


@papers.command()
def navigation(
    runs: Annotated[int, typer.Option(min=1, metavar="COUNT", help="Number of seeds per row.")] = 10,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of the table.")] = False,
) -> None:
    """Simulate the degraded scenarios of the EMERGE paper, compare with its table 2, and simulate outages.

    Ends with 1 if a number is not reproduced. A goal that only the filter as delivered misses is named, and is no
    failure.

    Example: [bold]obu papers navigation --runs 2[/]
    """
    from .papers.papers import navigation as repeat

    raise typer.Exit(repeat(runs, as_json))


JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of the tables.")]
FiguresOption = Annotated[
    Path | None, typer.Option(metavar="FOLDER", help="Folder of the figures (SVG); without it none are written.")
]


@papers.command("motion-conflict")
def motion_conflict(
    drives: Annotated[
        int, typer.Option(min=1, metavar="COUNT", help="Simulated drives of 15 minutes, of each kind.")
    ] = 20,
    as_json: JsonOption = False,
    out: FiguresOption = None,
) -> None:
    """Sweep gaps, delays and scales of the smart tachograph's speed check, and count false detections.

    The paper's break-points are printed beside ours, with simulated and recorded drives, and speeds of GPS alone
    against Galileo alone. OBU_DATA is the folder of the recordings. Ends with 1 if a number is outside its tolerance.

    Examples:
    [bold]obu papers motion-conflict --out figures[/]
    [bold]obu papers motion-conflict --drives 2 --json[/]
    """
    from .papers.papers import motion_conflict as repeat

    raise typer.Exit(repeat(drives, as_json, out))


@papers.command()
def cooperative(
    runs: Annotated[
        int, typer.Option(min=1, metavar="COUNT", help="Runs of 90 epochs of each of the ten ratios.")
    ] = 500,
    as_json: JsonOption = False,
    out: FiguresOption = None,
) -> None:
    """Repeat the ten ratios of V2X-assisted fault detection, with the leave-one-out bank beside the paper's test.

    Prints position errors with and without exclusion too. Ends with 1 if a number is outside its tolerance.

    Examples:
    [bold]obu papers cooperative --out figures[/]
    [bold]obu papers cooperative --runs 50 --json[/]
    """
    from .papers.papers import cooperative as repeat

    raise typer.Exit(repeat(runs, as_json, out))


@papers.command()
def spoofing(
    drives: Annotated[
        int, typer.Option(min=6, metavar="COUNT", help="Simulated drives of 15 minutes: two thirds to learn of.")
    ] = 36,
    as_json: JsonOption = False,
    out: FiguresOption = None,
) -> None:
    """Repeat spoofing detection by a phone's sensors, with the improved methods beside the paper's.

    False detections, standard deviations by dynamics, a sweep of the cut-off, attacks, a phone without barometer, and
    drives that phones recorded (OBU_DATA). Ends with 1 if a number is outside its tolerance.

    Examples:
    [bold]obu papers spoofing --out figures[/]
    [bold]obu papers spoofing --drives 6 --json[/]
    """
    from .papers.papers import spoofing as repeat

    raise typer.Exit(repeat(drives, as_json, out))


@papers.command()
def toll(
    runs: Annotated[
        int,
        typer.Option(min=2, metavar="COUNT", help="Runs of the filters per noise model; 30 times as many of lanes."),
    ] = 20,
    as_json: JsonOption = False,
    out: FiguresOption = None,
) -> None:
    """Track vehicles by CAM with the filters of the C-ITS toll paper, and decide lanes with and without delta position.

    Table III is printed beside ours, with processor times. Ends with 1 if a number is outside its tolerance.

    Examples:
    [bold]obu papers toll --out figures[/]
    [bold]obu papers toll --runs 4 --json[/]
    """
    from .papers.papers import toll as repeat

    raise typer.Exit(repeat(runs, as_json, out))


@recordings.callback(invoke_without_command=True)
def _record(
    context: typer.Context,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="The recording to write; without it a name of the moment."),
    ] = None,
    duration: Annotated[
        float | None, typer.Option(min=0.1, metavar="SECONDS", help="Seconds to record; without it until Ctrl-C.")
    ] = None,
    vehicle: VehicleOption = None,
) -> None:
    """Record every message of a running unit, beside its own recorder.

    Examples:
    [bold]obu record -o drive.mcap[/]
    [bold]obu record --duration 60[/]
    [bold]obu record repair cut.mcap -o whole.mcap[/]
    """
    if context.invoked_subcommand is None:
        from .recordings.record import record

        _end_on_sigterm()
        raise typer.Exit(record(output, duration, vehicle))


def command_line(arguments: Sequence[str]) -> typer.Typer:
    """Give the command line with the command of `IN_MODULES` that is called; with all for help and unknown names."""
    groups = {
        "": app, "calibrate": calibrate, "record": recordings, "evidence-key": evidence_key, "token": tokens,
        "centre": centre, "centre tenant": tenant, "centre account": account, "fleet": fleet,
    }  # fmt: skip
    here = {info.name or getattr(info.callback, "__name__", "") for info in app.registered_commands}
    first = arguments[0] if arguments else ""
    known = first in {*here, *(info.name for info in app.registered_groups), *IN_MODULES}
    for path, (module, function) in IN_MODULES.items():
        *group, name = path.split()
        if not known or first == path.split()[0]:
            groups[" ".join(group)].command(name)(_ended(getattr(import_module(f".{module}", __package__), function)))
    return app
