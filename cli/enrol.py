"""`obu enrol`: make this unit known to a control centre."""

import time
from pathlib import Path
from typing import Annotated

import typer

from shared.errors import UserError
from shared.evidence import EvidenceError, KeyFile, keys_folder
from shared.fleet.enrolling import enrol as enrol_at
from shared.fleet.enrolling import renew as renew_at
from shared.fleet.identity import UplinkIdentity, date_of, identity_folder
from shared.fleet.topics import RULE, VEHICLE
from shared.runtime.config import load_vehicle, state_dir


def enrol(
    url: Annotated[
        str | None, typer.Argument(help="Address of the centre's admission, such as https://centre.example:8444.")
    ] = None,
    token: Annotated[str | None, typer.Argument(help="One-time token that the centre made for this unit.")] = None,
    vehicle: Annotated[
        Path | None,
        typer.Option("--vehicle", metavar="FILE", help="The vehicle's TOML file; without it OBU_VEHICLE."),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option("--name", metavar="NAME", help="Name of this unit at the centre; without it that of its file."),
    ] = None,
    renew: Annotated[
        bool, typer.Option("--renew", help="Renew the certificate now, and register the present evidence key.")
    ] = False,
) -> int:
    """Make this unit known to a control centre, or show its enrolment when called without arguments.

    The unit makes a key of its own for the connection and has it certified; the centre also registers the evidence key
    with which the unit signs what it reports. Reports begin when the vehicle's file has a section monitoring.uplink;
    the certificate of 30 days is renewed by the unit itself.

    Examples:
    [bold]obu enrol https://centre.example:8444 Xq3v….9a1c…[/]
    [bold]obu enrol[/]
    [bold]obu enrol --renew[/]
    """
    state = state_dir()
    folder = identity_folder(state)
    if url is None and not renew:
        return _show(UplinkIdentity.read(folder))
    try:
        signer = KeyFile(keys_folder(state)).signer()
    except EvidenceError as error:
        raise UserError(str(error)) from error
    if renew:
        return _show(renew_at(UplinkIdentity.read(folder), signer))
    if token is None or url is None:
        raise UserError("give the address and the token that the centre shows: obu enrol URL TOKEN")
    file = load_vehicle(vehicle)
    unit = name or file.name
    if not VEHICLE.fullmatch(unit):
        raise UserError(f"{unit!r} is no name of a vehicle: {RULE}; give one with --name")
    shown = _show(enrol_at(url, token, unit, folder, signer))
    if "monitoring.uplink" not in file.tables:
        print("Reports begin when the vehicle's file has a section [monitoring.uplink], after the next start.")
    return shown


def _show(identity: UplinkIdentity) -> int:
    centre = identity.centre
    ended = time.time_ns() >= centre.not_after_ns
    print(f"vehicle      {centre.vehicle} of {centre.tenant}")
    print(f"centre       {centre.host}:{centre.mqtt_port}, renewal at {centre.renew_url}")
    print(f"certificate  {'ended' if ended else 'until'} {date_of(centre.not_after_ns)}")
    print(f"evidence key {centre.evidence_key}")
    print(f"files        {identity.folder}")
    return 0
