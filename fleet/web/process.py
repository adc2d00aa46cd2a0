"""Serves the centre's pages: one process, which reads the database and listens to the centre's bus."""

import asyncio
import logging
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from nats.aio.client import Client

from fleet.alarms.web_hook import AddressPolicy, Network
from fleet.bus import closed, connected
from fleet.centre import check_certificate
from fleet.servers.nats import NatsAccess
from fleet.serving import until_cancelled
from shared.errors import UserError
from shared.page.access.limits import Connections
from shared.page.access.peer import place_of
from shared.page.map.installed import InstalledMap
from shared.page.server import make_server

from .access.accounts import AccountsApi
from .access.attempts import Attempts
from .access.login import LoginApi
from .access.sessions import Sessions
from .alarms import AlarmsApi
from .app import make_app
from .audit import AuditApi
from .database import Database
from .enrolment import EnrolmentApi
from .live import VerdictNotifier
from .page_errors import PageErrorsApi
from .passages import PassagesApi
from .tiles import Tiles
from .vehicles import VehiclesApi
from .watch.gate import WatchGate

log = logging.getLogger(__name__)

CONNECTIONS, PER_ADDRESS = 600, 64  # of browsers
READ_PERIOD_S = 12 * 3600.0  # of reading the certificate again: it is replaced while this process runs


@dataclass(frozen=True)
class WebSettings:
    """Where the pages listen, and what they show."""

    dsn: str
    nats: NatsAccess
    enrol_url: str = ""  # address that `obu enrol` is given
    fingerprint: str = ""  # of the authority, a part of each token
    host: str = "127.0.0.1"
    port: int = 8090
    names: tuple[str, ...] = ()  # further names by which browsers reach this centre
    certificate: tuple[Path, Path] | None = None  # certificate and key; without them HTTP, for this machine alone
    map_file: Path | None = None
    web_hook_networks: tuple[Network, ...] = ()  # where web hooks may be besides the public network
    session_h: float = 12.0


async def serve(settings: WebSettings) -> None:
    """Serve until cancelled."""
    client = await connected(settings.nats, "web")
    database = Database(settings.dsn)
    server = make(settings, database, client)
    reading = asyncio.create_task(_read_again(server, settings.certificate))
    try:
        await until_cancelled(server)
    finally:
        reading.cancel()
        await database.close()
        await closed(client)


def make(settings: WebSettings, database: Database, client: Client) -> uvicorn.Server:
    """Put the parts together; raises `UserError`."""
    sessions, live = Sessions(database, settings.session_h * 3600.0), VerdictNotifier(client)
    map_file = None if settings.map_file is None else str(settings.map_file)
    gate = WatchGate(database, client, map_file)
    routes = (
        LoginApi(database, sessions, Attempts(database)),
        Tiles(database),
        VehiclesApi(database),
        InstalledMap(map_file),
        AlarmsApi(database, live, AddressPolicy(settings.web_hook_networks)),
        PassagesApi(database),
        EnrolmentApi(database, client, settings.enrol_url, settings.fingerprint),
        AccountsApi(database, sessions),
        AuditApi(database),
        PageErrorsApi(),
        live,
        gate,
    )
    app = make_app(database, sessions, routes, (live, gate), settings.names)
    server = make_server(app, Connections(CONNECTIONS, PER_ADDRESS, place=place_of))
    server.config.host, server.config.port = settings.host, settings.port
    if settings.certificate is not None:
        check_certificate(*settings.certificate)
        server.config.ssl_certfile, server.config.ssl_keyfile = map(str, settings.certificate)
    return server


async def _read_again(server: uvicorn.Server, certificate: tuple[Path, Path] | None) -> None:
    """Read the certificate of the pages again, for connections from then on; one that cannot be used is left."""
    while certificate is not None:
        await asyncio.sleep(READ_PERIOD_S)
        try:
            await asyncio.to_thread(check_certificate, *certificate)
            if server.config.ssl is not None:
                server.config.ssl.load_cert_chain(*certificate, password="")
        except (UserError, OSError) as error:
            log.error("the pages keep the certificate that they have: %s", error)
