"""What the commands of `obu centre` share: the folder of the centre, and its database."""

import getpass
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from shared.errors import UserError

if TYPE_CHECKING:
    import psycopg

    from fleet.centre import Centre

FolderOption = Annotated[
    Path | None,
    typer.Option("--folder", metavar="FOLDER", help="Folder of the centre; without it OBU_CENTRE, else .obu/centre."),
]
TenantOption = Annotated[str, typer.Option("--tenant", metavar="NAME", help="Tenant to whom it belongs.")]
FIRST_TENANT = "demo"


def centre_of(folder: Path | None, *, make: bool = False) -> "Centre":
    """Open the folder of a centre, with `make` also a new one; raises `UserError`."""
    try:
        from fleet.centre import FILE, Centre
    except ModuleNotFoundError as error:
        raise UserError(
            f"a control centre needs {error.name}: pip install --require-hashes -r requirements-fleet.lock"
        ) from error
    path = folder or Path(os.environ.get("OBU_CENTRE") or ".obu/centre")
    if not make and not is_there(path / FILE):
        raise UserError(
            f"there is no centre in {path}; name another folder with --folder, or start one: `obu centre up`"
        )
    return Centre(path)


def is_there(path: Path) -> bool:
    """Whether there is a file; raises `UserError` if that cannot be seen."""
    try:
        return path.is_file()
    except PermissionError as error:
        raise UserError(
            f"cannot look into {path.parent}: {error.strerror}; give this command as the user of the centre"
        ) from error


@contextmanager
def database(centre: "Centre") -> Iterator["psycopg.Connection"]:
    """Connect to the database of a centre as its owner, in one transaction; raises `UserError`."""
    import psycopg

    from fleet.database.refusals import refusals

    with refusals(), psycopg.connect(centre.owner_dsn, connect_timeout=5) as db:
        yield db


def tenant_id(db: "psycopg.Connection", name: str) -> int:
    """Find a tenant; raises `UserError`."""
    row = db.execute("SELECT tenant_id FROM tenant WHERE name = %s", (name,)).fetchone()
    if row is None:
        raise UserError(f"there is no tenant {name!r}; `obu centre tenant list` names them")
    return int(row[0])


def who() -> str:
    """Name of the caller, for the audit."""
    try:
        return f"{getpass.getuser()} by command"
    except (KeyError, OSError):  # a user of containers has no name
        return f"user {os.getuid()} by command"


def note(db: "psycopg.Connection", tenant: int, action: str, vehicle: str | None, **detail: str | int | None) -> None:
    """Write a row of the audit."""
    from psycopg.types.json import Jsonb

    db.execute(
        "INSERT INTO audit (tenant_id, who, action, vehicle, detail) VALUES (%s, %s, %s, %s, %s)",
        (tenant, who(), action, vehicle, Jsonb(detail)),
    )
