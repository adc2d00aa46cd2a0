"""What the database says, in one sentence with what to try next, in place of errors of psycopg."""

from collections.abc import Iterator
from contextlib import contextmanager

import psycopg

from shared.errors import UserError


@contextmanager
def refusals() -> Iterator[None]:
    """Say what the database refuses, and what to do: raises `UserError` in place of errors of psycopg."""
    try:
        yield
    except (psycopg.errors.UndefinedTable, psycopg.errors.UndefinedColumn) as error:
        raise UserError(
            "the centre's database has not the schema of this version: the centre is still starting, or is of another "
            "version; try again in some seconds, else start it again"
        ) from error
    except psycopg.errors.InsufficientPrivilege as error:
        raise UserError(f"the centre's database refuses: {reason_of(error)}; state its owner in `database`") from error
    except psycopg.OperationalError as error:
        raise UserError(unusable(error)) from error


def unusable(error: psycopg.OperationalError) -> str:
    """What the server says, or why it is not reached; and what to do."""
    if error.sqlstate is not None:
        return f"the centre's database refuses: {reason_of(error)}; mend that, and give the command again"
    if "Peer authentication failed" in str(error):
        return "the centre's database belongs to another user: give this command as the user who has started the centre"
    return (
        f"the centre's database does not answer ({reason_of(error)}); start it with `obu centre up`, as the user who "
        "has started it first, and mend what its log says (postgres/postgres.log in the folder of the centre)"
    )


def reason_of(error: Exception) -> str:
    """The one line of an error that says why: libpq adds where it looked, and hints; SQLAlchemy its query."""
    error = getattr(error, "orig", None) or error
    if isinstance(error, psycopg.Error) and error.diag.message_primary:
        return error.diag.message_primary
    return (str(error).strip() or type(error).__name__).splitlines()[0].rpartition("failed: ")[2]
