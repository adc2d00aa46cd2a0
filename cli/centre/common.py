"""What the commands of `obu centre` share: the folder of the centre, and its database."""

import getpass
import os
import sys
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


def hand_over(centre: "Centre", account: str, password: str, *, logged: bool) -> None:
    """Print a made password once, or write it to a file for its user alone where a log would keep it.

    `logged` says that what this process prints is kept if it is no terminal, as of a service.
    """
    in_journal = bool(os.environ.get("JOURNAL_STREAM")) and not sys.stdout.isatty()
    if not in_journal and (sys.stdout.isatty() or not logged):
        print(f"password, shown this once: {password}")
        return
    path = centre.folder / "secrets" / f"password-of-{account}"
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
            file.write(f"{password}\n")
    except OSError as error:
        raise UserError(
            f"cannot write the password of {account} to {path}: {error.strerror}; mend that, then give the account "
            f"another password: obu centre account add {account}"
        ) from error
    print(f"its password is in {path}, and not in this log: read it there, log in, change it, and remove the file")


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
