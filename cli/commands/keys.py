"""`obu keys`: the secrets with which processes and programs identify themselves to the broker."""

from pathlib import Path
from typing import Annotated

import typer

from shared.errors import UserError

from .common import VehicleOption


def make(
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
) -> int:
    """Make the secrets that are missing, and the files by which the broker checks them; what exists is kept.

    `obu demo`, `obu broker`, the containers and install.sh do it themselves.

    Examples:
    [bold]obu keys make --vehicle deploy/vehicles/pi.toml[/]
    [bold]obu keys make --broker-files /etc/obu/broker --broker-user mosquitto --group obu[/]
    """
    from .. import keys

    return keys.make(vehicle, files, owner, group, containers=containers, socket_folder=socket_folder)


def list_users() -> int:
    """List who has a secret; never the secret.

    Example: [bold]sudo obu keys list[/]
    """
    from .. import keys

    return keys.show()


def add(
    name: Annotated[str, typer.Argument(help="Name of the new user, such as fleet-gateway.")],
    read: Annotated[bool, typer.Option("--read", help="It may read every topic, and write none.")] = False,
    role: Annotated[
        str | None,
        typer.Option(
            "--role",
            metavar="operator|detector",
            help="At a toll plaza: `operator` registers vehicles and answers, `detector` counts them.",
        ),
    ] = None,
) -> int:
    """Add a user of the bus that is no part of the unit, and print its secret.

    Examples:
    [bold]obu keys add fleet-gateway --read[/]
    [bold]obu keys add back-office --role operator[/]
    """
    from .. import keys

    if read == (role is not None):
        raise UserError("what may the user do? Add --read, --role operator or --role detector")
    return keys.add(name, role or "reader")


def remove(name: Annotated[str, typer.Argument(help="Name of the user.")]) -> int:
    """Remove a user of `obu keys add`.

    Example: [bold]obu keys remove fleet-gateway[/]
    """
    from .. import keys

    return keys.remove(name)


def tls(
    names: Annotated[list[str], typer.Argument(help="Names and addresses under which other machines reach the unit.")],
) -> int:
    """Make a certificate, so that the broker may listen for other machines.

    Example: [bold]obu keys tls car.local 192.168.1.7[/]
    """
    from .. import keys

    return keys.tls(names)


def rotate(name: Annotated[str | None, typer.Argument(help="Whose secret; without it all.")] = None) -> int:
    """Replace secrets, as after somebody has read them.

    Example: [bold]obu keys rotate observer.1[/]
    """
    from .. import keys

    return keys.rotate(name)
