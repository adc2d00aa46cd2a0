"""`obu centre up` and `obu centre run`: run a control centre, or one process of it."""

import asyncio
import logging
import signal
from collections.abc import Coroutine
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from .common import FolderOption, centre_of, database

if TYPE_CHECKING:
    from fleet.centre import Centre


class Part(StrEnum):
    """Processes of a centre, as in fleet.processes."""

    ADMISSION = "admission"
    INGEST = "ingest"
    ALARMS = "alarms"
    WEB = "web"
    MAINTENANCE = "maintenance"


def up(folder: FolderOption = None) -> int:
    """Run a control centre on this machine: PostgreSQL, nats-server and the centre's processes, until Ctrl-C.

    Its folder holds the database, the authority's key and the settings (centre.toml), which are made at the first
    start. The password of the first account, admin, is printed once on a terminal; elsewhere, as under systemd, it is
    written to a file, so that no log holds it.

    Examples:
    [bold]obu centre up[/]
    [bold]obu centre up --folder /var/lib/obu-centre[/]
    """
    centre = centre_of(folder, make=True)
    from fleet.up import run as run_all
    from fleet.up import until_stopped

    logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s")
    run_all(centre, until_stopped(), lambda: _say(centre))
    return 0


def run(part: Annotated[Part, typer.Argument(help="Process of the centre.")], folder: FolderOption = None) -> int:
    """Run one process of a centre whose servers run already; `obu centre up` runs them all.

    Maintenance brings the schema up to date, makes partitions and removes what is too old.

    Examples:
    [bold]obu centre run ingest[/]
    [bold]obu centre run maintenance[/]
    """
    centre = centre_of(folder)
    from fleet.processes import work_of

    logging.basicConfig(level=logging.INFO, format=f"{part}: %(message)s")
    asyncio.run(_until_stopped(work_of(part.value, centre)))
    return 0


def prepare(folder: FolderOption = None) -> int:
    """Make secrets, authority and configuration of a centre in containers, each for its own user; run once, as root.

    What exists is kept. deploy/compose.centre.yml runs it before everything else.

    Example: [bold]obu centre prepare --folder /var/lib/obu-centre[/]
    """
    centre = centre_of(folder, make=True)
    from fleet.containers import prepare as prepare_files

    logging.basicConfig(level=logging.INFO, format="prepare: %(message)s")
    prepare_files(centre)
    return 0


def _say(centre: "Centre") -> None:
    """Print where everything is, and make the first account."""
    settings = centre.settings
    print(
        f"centre in {centre.folder}\nreports    {settings.host}:{settings.mqtt_port}\nenrolment  {centre.enrol_url}\n"
        f"pages      {centre.web_url}"
    )
    with database(centre) as db:
        accounts = db.execute("SELECT FROM account LIMIT 1").fetchone()
    if accounts is None:
        from .tenants import Role, enter_account

        enter_account(centre, "admin", Role.ADMIN, logged=True)
    print("enrol a vehicle with a token: obu centre token --vehicle NAME   (end with Ctrl-C)", flush=True)


async def _until_stopped(work: Coroutine[object, object, None]) -> None:
    """Work until SIGINT or SIGTERM."""
    task = asyncio.ensure_future(work)
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    try:
        await task
    except asyncio.CancelledError:
        return
