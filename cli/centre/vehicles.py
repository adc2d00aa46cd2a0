"""`obu centre token`, `vehicles`, `revoke`, `erase` and `retain`."""

import asyncio
import contextlib
import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from shared.errors import UserError
from shared.fleet.enrolling import command_for
from shared.fleet.topics import REVOKED

from .common import FIRST_TENANT, FolderOption, TenantOption, centre_of, database, note, tenant_id, who

if TYPE_CHECKING:
    from fleet.centre import Centre

VEHICLES = """
SELECT vehicle.vehicle, tenant.name,
    (extract(epoch FROM max(not_after) FILTER (WHERE kind = 'tls' AND revoked IS NULL)))::bigint,
    count(*) FILTER (WHERE revoked IS NULL), max(vehicle_now.utc_ms), erased IS NOT NULL
FROM vehicle JOIN tenant USING (tenant_id) LEFT JOIN certificate USING (vehicle)
    LEFT JOIN vehicle_now USING (vehicle)
WHERE %(tenant)s::text IS NULL OR tenant.name = %(tenant)s
GROUP BY vehicle.vehicle, tenant.name ORDER BY 2, 1
"""
TOKENS = """
SELECT token_id, coalesce(vehicle, 'any new name'), tenant.name, made_by, extract(epoch FROM expires)::bigint
FROM enrolment JOIN tenant USING (tenant_id) WHERE used IS NULL AND expires > now() ORDER BY expires
"""


def token(
    vehicle: Annotated[
        str | None,
        typer.Option("--vehicle", metavar="NAME", help="Name that the vehicle must have; without it any new name."),
    ] = None,
    tenant: TenantOption = FIRST_TENANT,
    hours: Annotated[
        float, typer.Option("--hours", metavar="HOURS", min=0.01, max=720, help="How long it can be used.")
    ] = 24.0,
    folder: FolderOption = None,
) -> int:
    """Make a one-time token with which a vehicle enrols, and print the command for the vehicle.

    Example: [bold]obu centre token --vehicle car-7[/]
    """
    url, made = token_for(folder, tenant, vehicle, hours)
    print(command_for(url, made, vehicle))
    return 0


def token_for(folder: Path | None, tenant: str, vehicle: str | None, hours: float = 24.0) -> tuple[str, str]:
    """Make a token at a centre of this machine; return the address of admission and the token."""
    centre = centre_of(folder)
    from fleet.admission.enrolment import Refusal, make_token

    try:
        with database(centre) as db:
            made = make_token(db, centre.authority_pem, tenant, vehicle, who(), hours)
            note(db, tenant_id(db, tenant), "made a token", vehicle)
    except Refusal as error:
        raise UserError(str(error)) from error
    return centre.enrol_url, made


def vehicles(
    tenant: Annotated[str | None, typer.Option("--tenant", metavar="NAME", help="Of this tenant alone.")] = None,
    folder: FolderOption = None,
) -> int:
    """List vehicles with the end of their certificate and the age of their newest report.

    Example: [bold]obu centre vehicles[/]
    """
    with database(centre_of(folder)) as db:
        if tenant is not None:
            tenant_id(db, tenant)
        rows = db.execute(VEHICLES, {"tenant": tenant}).fetchall()
    if not rows:
        print("no vehicle has enrolled yet: obu centre token --vehicle NAME")
        return 0
    print(f"{'vehicle':24} {'tenant':16} {'certificate':18} {'newest report':>14}")
    for name, owner, until_s, keys, utc_ms, erased in rows:
        print(f"{name:24} {owner:16} {_end(until_s, keys):18} {_age(utc_ms):>14}{'  erased' if erased else ''}")
    return 0


def tokens(folder: FolderOption = None) -> int:
    """List the tokens that can still be used; their texts are known to nobody but who has them.

    Example: [bold]obu centre tokens[/]
    """
    with database(centre_of(folder)) as db:
        rows = db.execute(TOKENS).fetchall()
    if not rows:
        print("no token can be used; make one with `obu centre token --vehicle NAME`")
        return 0
    print(f"{'token':16} {'vehicle':24} {'tenant':16} {'made by':24} until (UTC)")
    for name, vehicle, tenant, by, until_s in rows:
        print(f"{name:16} {vehicle:24} {tenant:16} {by:24} {time.strftime('%Y-%m-%d %H:%M', time.gmtime(until_s))}")
    return 0


def revoke(
    name: Annotated[str, typer.Argument(help="Vehicle, or the id of one of its keys, or of a token.")],
    reason: Annotated[str, typer.Option("--reason", metavar="TEXT", help="Why, for the audit.")] = "",
    folder: FolderOption = None,
) -> int:
    """Revoke the keys of a vehicle, one key, or a token: reports are refused, and the connection is ended.

    The vehicle cannot come back by itself, and tokens that were made for it end; a new one enrols it again, with
    another evidence key (`obu evidence-key rotate`).

    Examples:
    [bold]obu centre revoke car-7 --reason stolen[/]
    [bold]obu centre revoke 3f9a2c417be0d585[/]
    """
    centre = centre_of(folder)
    from fleet.database.revoking import END_TOKEN, END_TOKENS, LOCK_VEHICLE, REVOKE

    with database(centre) as db:
        ended = db.execute(END_TOKEN, {"token": name}).fetchall()
        key = db.execute("SELECT vehicle FROM certificate WHERE key_id = %s", (name,)).fetchone()
        vehicle = name if key is None else key[0]
        given = {"vehicle": vehicle, "key": None if key is None else name, "reason": reason[:200] or "by command"}
        db.execute(LOCK_VEHICLE, given)
        keys = db.execute(REVOKE, given).fetchall()
        ended += db.execute(END_TOKENS, given).fetchall()
        if not keys and not ended:
            known = db.execute("SELECT FROM certificate WHERE vehicle = %s LIMIT 1", (vehicle,)).fetchone()
            raise UserError(
                f"there is no vehicle, key or token {name!r}; `obu centre vehicles` and `obu centre tokens` name them"
                if known is None
                else f"all keys of {name} are revoked already"
            )
        for row in ended[:1]:
            note(db, int(row[0]), "withdrew tokens", row[1], count=len(ended))
        for row in keys[:1]:
            note(db, int(row[1]), "revoked", vehicle, keys=" ".join(row[0] for row in keys), reason=reason)
    told = not keys or asyncio.run(_tell(centre, [row[0] for row in keys]))
    for row in keys:
        print(f"revoked {row[0]} of {vehicle}")
    if ended:
        print(f"{len(ended)} unused token{'s' * (len(ended) > 1)} ended")
    if not told:
        print("NATS does not answer: processes that run see it within half a minute")
    return 0


def erase(
    vehicle: Annotated[str, typer.Argument(help="Vehicle whose reports are erased.")],
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
    folder: FolderOption = None,
) -> int:
    """Erase positions, events and alarms of a vehicle; hashes of its batches, keys, audit and charges stay.

    The vehicle goes on to report unless its keys are revoked. Backups hold what was erased until they are replaced.

    Example: [bold]obu centre erase car-7[/]
    """
    centre = centre_of(folder)
    with database(centre) as db:
        if db.execute("SELECT FROM vehicle WHERE vehicle = %s", (vehicle,)).fetchone() is None:
            raise UserError(f"there is no vehicle {vehicle!r}; `obu centre vehicles` names them")
    if not yes and not typer.confirm(f"Erase all that {vehicle} has reported?"):
        print("nothing is erased")
        return 1
    from fleet.database.erasure import erase as erase_in

    with database(centre) as db:
        done = erase_in(db, vehicle, who())
    assert done is not None  # vehicles are not removed
    kept = f"; {done.charges_kept} charges of toll plazas are kept" if done.charges_kept else ""
    print(f"erased {done.batches} batches and {done.events} events of {vehicle}{kept}")
    return 0


def retain(folder: FolderOption = None) -> int:
    """Remove what no tenant keeps any more, which a running centre does every six hours.

    Example: [bold]obu centre retain[/]
    """
    centre = centre_of(folder)
    from fleet.database.refusals import refusals
    from fleet.database.retention import retain as retain_in

    with refusals():
        removed = retain_in(centre.owner_dsn)
    print(f"removed {removed.days} days, and {removed.rows} rows of tenants who keep less than others")
    return 0


async def _tell(centre: "Centre", keys: list[str]) -> bool:
    """Tell the processes of a centre which keys are revoked."""
    import nats

    from fleet.bus import TELL_S, connect, told

    with contextlib.suppress(OSError, TimeoutError, nats.errors.Error):
        client = await connect(
            centre.nats("admission"), "command", connect_timeout=TELL_S, allow_reconnect=False, error_cb=_quiet
        )
        is_told = await told(client, REVOKED, (json.dumps({"key": key}).encode() for key in keys))
        await client.close()
        return is_told
    return False


async def _quiet(_error: Exception) -> None:
    """Say nothing more: the caller says what an unreachable server means."""


def _end(until_s: int | None, keys: int) -> str:
    if not keys:
        return "revoked"
    if until_s is None:
        return "none"
    day = time.strftime("%Y-%m-%d", time.gmtime(until_s))
    return f"ended {day}" if until_s < time.time() else f"until {day}"


def _age(utc_ms: int | None) -> str:
    if utc_ms is None:
        return "none"
    seconds = max(0, round(time.time() - utc_ms / 1000))
    for size, unit in ((86_400, "d"), (3600, "h"), (60, "min")):
        if seconds >= 2 * size:
            return f"{seconds // size} {unit}"
    return f"{seconds} s"
