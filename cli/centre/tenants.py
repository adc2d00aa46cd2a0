"""`obu centre tenant` and `obu centre account`: who owns vehicles, and who may look at them."""

import re
import secrets
import sys
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from shared.errors import UserError

from .common import FIRST_TENANT, FolderOption, TenantOption, centre_of, database, hand_over, note, tenant_id

if TYPE_CHECKING:
    from fleet.centre import Centre

NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,47}")
ACCOUNT = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.@-]{0,63}")
DaysOption = Annotated[
    int | None,
    typer.Option("--days", metavar="DAYS", min=1, max=3650, help="Days that positions, events and alarms are kept."),
]
TollDaysOption = Annotated[
    int | None,
    typer.Option("--toll-days", metavar="DAYS", min=1, max=7300, help="Days that charges of toll plazas are kept."),
]
VehicleOption = Annotated[
    int | None,
    typer.Option("--vehicle-mb", metavar="MB", min=1, max=1_000_000, help="MB a day that each vehicle may store."),
]
BudgetOption = Annotated[
    int | None,
    typer.Option("--mb", metavar="MB", min=1, max=100_000_000, help="MB a day that all its vehicles may store."),
]


class Role(StrEnum):
    """Roles of accounts, as in fleet.web.access.rights."""

    VIEWER = "viewer"
    OPERATOR = "operator"
    TOLL = "toll"
    ADMIN = "admin"


def tenant_add(
    name: Annotated[str, typer.Argument(help="Name of the tenant.")],
    days: DaysOption = None,
    toll_days: TollDaysOption = None,
    folder: FolderOption = None,
) -> int:
    """Add a tenant: its accounts see its own vehicles only.

    Example: [bold]obu centre tenant add road-authority --days 30[/]
    """
    if not NAME.fullmatch(name):
        raise UserError(f"{name!r} is no name of a tenant: letters, digits, _ and -, at most 48 and not - first")
    with database(centre_of(folder)) as db:
        row = db.execute(
            "INSERT INTO tenant (name) VALUES (%s) ON CONFLICT DO NOTHING RETURNING tenant_id", (name,)
        ).fetchone()
        if row is None:
            raise UserError(f"there is a tenant {name} already; choose another name")
        note(db, int(row[0]), "added the tenant", None)
    print(f"tenant {name} is added; its first account: obu centre account add NAME --tenant {name} --role admin")
    if days is not None or toll_days is not None:
        tenant_retention(name, days, toll_days, folder)
    return 0


def tenant_list(folder: FolderOption = None) -> int:
    """List tenants with what they keep and how many vehicles they have.

    Example: [bold]obu centre tenant list[/]
    """
    query = """
        SELECT name, retention_days, toll_retention_days, web_hook IS NOT NULL,
            (SELECT count(*) FROM vehicle WHERE vehicle.tenant_id = tenant.tenant_id),
            (SELECT count(*) FROM account WHERE account.tenant_id = tenant.tenant_id AND disabled IS NULL)
        FROM tenant ORDER BY name
    """
    with database(centre_of(folder)) as db:
        rows = db.execute(query).fetchall()
    print(f"{'tenant':24} {'keeps':>7} {'charges':>8} {'vehicles':>9} {'accounts':>9}  web hook")
    for name, days, toll_days, hook, vehicles, accounts in rows:
        print(f"{name:24} {days:>5} d {toll_days:>6} d {vehicles:>9} {accounts:>9}  {'yes' if hook else 'no'}")
    return 0


def tenant_retention(
    name: Annotated[str, typer.Argument(help="Name of the tenant.")],
    days: DaysOption = None,
    toll_days: TollDaysOption = None,
    folder: FolderOption = None,
) -> int:
    """Change how long the reports of a tenant are kept; what is older is removed within six hours.

    Example: [bold]obu centre tenant retention demo --days 30[/]
    """
    if days is None and toll_days is None:
        raise UserError("say how long: --days for reports, --toll-days for charges of toll plazas")
    with database(centre_of(folder)) as db:
        tenant = tenant_id(db, name)
        row = db.execute(
            "UPDATE tenant SET retention_days = coalesce(%s, retention_days), "
            "toll_retention_days = coalesce(%s, toll_retention_days) WHERE tenant_id = %s "
            "RETURNING retention_days, toll_retention_days",
            (days, toll_days, tenant),
        ).fetchone()
        assert row is not None
        note(db, tenant, "changed the retention", None, days=row[0], toll_days=row[1])
    print(f"{name} keeps reports for {row[0]} days and charges for {row[1]}")
    print("what is older is removed within six hours, or at once by `obu centre retain`")
    return 0


def tenant_budget(
    name: Annotated[str, typer.Argument(help="Name of the tenant.")],
    vehicle_mb: VehicleOption = None,
    mb: BudgetOption = None,
    folder: FolderOption = None,
) -> int:
    """Change how much the vehicles of a tenant may store a day; what is beyond gets no receipt, and an alarm `flood`.

    A vehicle that reports once a second stores some 5 MB a day. What is not used is kept for three days, so that
    a week without network is stored within an hour.

    Example: [bold]obu centre tenant budget demo --vehicle-mb 100[/]
    """
    if vehicle_mb is None and mb is None:
        raise UserError("say how much: --vehicle-mb for each vehicle, --mb for all of them")
    with database(centre_of(folder)) as db:
        tenant = tenant_id(db, name)
        row = db.execute(
            "UPDATE tenant SET vehicle_mb_day = coalesce(%s, vehicle_mb_day), mb_day = coalesce(%s, mb_day) "
            "WHERE tenant_id = %s RETURNING vehicle_mb_day, mb_day",
            (vehicle_mb, mb, tenant),
        ).fetchone()
        assert row is not None
        note(db, tenant, "changed the budget", None, vehicle_mb=row[0], mb=row[1])
    print(f"{name} may store {row[0]} MB a day of each vehicle, and {row[1]} MB of all of them; in half a minute")
    return 0


def tenant_web_hook(
    name: Annotated[str, typer.Argument(help="Name of the tenant.")],
    address: Annotated[
        str | None, typer.Argument(help="https address that is told of alarms; without it none.")
    ] = None,
    folder: FolderOption = None,
) -> int:
    """Set the address that is told of the alarms of a tenant, or remove it; prints the secret of its signatures.

    Examples:
    [bold]obu centre tenant web-hook demo https://alarms.example/hook[/]
    [bold]obu centre tenant web-hook demo[/]
    """
    centre = centre_of(folder)
    from fleet.alarms.signing import new_secret
    from fleet.alarms.web_hook import SET, AddressPolicy

    why = None if address is None else AddressPolicy(centre.settings.web_hook_networks).why_not(address)
    if why is not None:
        raise UserError(f"{address!r} is no web hook: {why}")
    with database(centre) as db:
        tenant = tenant_id(db, name)
        secret = new_secret() if address else None
        db.execute(SET, (address, secret, tenant))
        note(db, tenant, "changed the web hook", None, to=address)
    print(f"{name} tells {address} of alarms" if address else f"{name} has no web hook")
    if secret:
        print(f"its server compares signatures (Standard Webhooks) with this secret: {secret}")
    return 0


def account_add(
    name: Annotated[str, typer.Argument(help="Name with which this person logs in.")],
    role: Annotated[
        Role | None, typer.Option("--role", help="What it may do; without it an existing account keeps its own.")
    ] = None,
    tenant: TenantOption = FIRST_TENANT,
    password_stdin: Annotated[
        bool, typer.Option("--password-stdin", help="Read the password from standard input; otherwise one is made.")
    ] = False,
    folder: FolderOption = None,
) -> int:
    """Add an account for the pages, or give an existing one another password and role; prints a made password once.

    Where systemd would write it to its journal, it is written to a file instead.

    Without --role a new account is a viewer, and an existing one keeps its role. Viewer sees map, tracks and alarms;
    operator also acknowledges alarms and watches vehicles; toll sees charges and no tracks; admin does all of this,
    enrols, revokes and manages accounts.

    Examples:
    [bold]obu centre account add anna --role admin[/]
    [bold]obu centre account add otto --role operator --password-stdin < password[/]
    """
    enter_account(centre_of(folder), name, role, tenant, password_stdin=password_stdin)
    return 0


def enter_account(
    centre: "Centre",
    name: str,
    role: Role | None,
    tenant: str = FIRST_TENANT,
    *,
    password_stdin: bool = False,
    logged: bool = False,
) -> None:
    """Add or change an account, and hand its password over; `logged` as there. Raises `UserError`."""
    from fleet.web.access.passwords import hashed, weakness

    if not ACCOUNT.fullmatch(name):
        raise UserError(
            f"{name!r} is no name of an account: letters, digits and . _ @ -, at most 64, no sign but _ first"
        )
    password = sys.stdin.readline(1024).rstrip("\r\n") if password_stdin else secrets.token_urlsafe(15)
    if why := weakness(password, name):
        raise UserError(f"{why}; give another one")
    given = None if role is None else role.value
    with database(centre) as db:
        owner = tenant_id(db, tenant)
        row = db.execute(
            "INSERT INTO account AS old (tenant_id, name, password, role) VALUES (%s, %s, %s, coalesce(%s, %s)) "
            "ON CONFLICT (name) DO UPDATE SET password = excluded.password, role = coalesce(%s, old.role), "
            "disabled = NULL WHERE old.tenant_id = excluded.tenant_id RETURNING account_id, role, xmax = 0",
            (owner, name, hashed(password), given, Role.VIEWER.value, given),
        ).fetchone()
        if row is None:
            raise UserError(
                f"the name {name} belongs to an account of another tenant; name that by --tenant, or give another name"
            )
        db.execute("DELETE FROM session WHERE account_id = %s", row[:1])
        note(db, owner, "added an account" if row[2] else "gave an account a password", None, name=name, role=row[1])
    print(f"account {name} of {tenant} with the role {row[1]} logs in at {centre.web_url}")
    if not password_stdin:
        hand_over(centre, name, password, logged=logged)


def account_list(folder: FolderOption = None) -> int:
    """List accounts; never their passwords.

    Example: [bold]obu centre account list[/]
    """
    query = """
        SELECT account.name, tenant.name, role, to_char(created, 'YYYY-MM-DD'), disabled IS NOT NULL
        FROM account JOIN tenant USING (tenant_id) ORDER BY 2, 1
    """
    with database(centre_of(folder)) as db:
        rows = db.execute(query).fetchall()
    if not rows:
        print("there is no account yet: obu centre account add NAME --role admin")
        return 0
    print(f"{'account':24} {'tenant':24} {'role':10} made")
    for name, tenant, role, made, disabled in rows:
        print(f"{name:24} {tenant:24} {role:10} {made}{'  disabled' if disabled else ''}")
    return 0


def account_disable(
    name: Annotated[str, typer.Argument(help="Name of the account.")], folder: FolderOption = None
) -> int:
    """End the sessions of an account and refuse its log-in, until `obu centre account add` gives it a password again.

    Example: [bold]obu centre account disable otto[/]
    """
    with database(centre_of(folder)) as db:
        row = db.execute(
            "UPDATE account SET disabled = coalesce(disabled, now()) WHERE name = %s RETURNING account_id, tenant_id",
            (name,),
        ).fetchone()
        if row is None:
            raise UserError(f"there is no account {name!r}; `obu centre account list` names them")
        db.execute("DELETE FROM session WHERE account_id = %s", (row[0],))
        note(db, int(row[1]), "disabled an account", None, name=name)
    print(f"account {name} is disabled")
    return 0
