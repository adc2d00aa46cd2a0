"""Settings of a centre: `centre.toml` in its folder, and secrets that are made at the first start."""

import os
import secrets
import ssl
import tomllib
from ipaddress import IPv4Network, IPv6Network
from itertools import combinations
from pathlib import Path
from typing import Annotated

from psycopg.conninfo import conninfo_to_dict, make_conninfo
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from shared.bounded import SizeExceeded, read_text
from shared.errors import UserError

from .admission.authority import AUTHORITY, SERVER, SERVER_KEY
from .database.roles import ROLES, dsn_of_process
from .servers.nats import LOOPBACK, OWN_NAME, USERS, NatsAccess, bracketed
from .servers.ports import must_be_free
from .servers.postgres import USER, Postgres

FILE = "centre.toml"
MAX_BYTES = 65_536
SECRETS, OWNER_PASSFILE = "secrets", "database-owner.pgpass"  # of libpq, where `prepare` has made it
NAME = r"^[A-Za-z0-9._:-]+$"  # or address
EXAMPLE = """# A control centre; see docs/how-to/run-a-control-centre.md. What is not given has the value shown.
# host = "127.0.0.1"          # name or address by which vehicles reach this centre
# listen = "127.0.0.1"        # 0.0.0.0: vehicles of the whole network may connect
# mqtt_port = 8883            # reports, MQTT over mutual TLS
# enrol_port = 8444           # enrolment and renewal, HTTPS
# web_port = 8090             # the pages
# web_listen = "127.0.0.1"    # 0.0.0.0: browsers of the whole network may connect, by HTTPS
# web_names = []              # further names by which browsers reach the pages
# web_certificate = ""        # of the pages, a file; otherwise one that the centre's own authority signs
# web_key = ""                # of that certificate
# web_hook_networks = []      # private networks in which web hooks of tenants may be, such as "10.1.2.0/24"
# map_file = ""               # an installed map; see docs/how-to/install-a-map.md
# Servers on other machines, or in containers; otherwise `obu centre up` runs both here:
# database = ""               # such as "host=db dbname=fleet"; the owner's password: passfile=... (libpq)
# nats_host = "127.0.0.1"
# nats_port = 4222
# postgres_port = 5433        # of the server here: a part of the name of its socket
"""


class Settings(BaseModel):
    """What the file of a centre may state."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    host: str = Field(default="127.0.0.1", min_length=1, max_length=253, pattern=NAME)
    listen: str = Field(default="127.0.0.1", min_length=1, max_length=253, pattern=NAME)
    mqtt_port: int = Field(default=8883, ge=1, le=65535)
    enrol_port: int = Field(default=8444, ge=1, le=65535)
    web_port: int = Field(default=8090, ge=1, le=65535)
    web_listen: str = Field(default="127.0.0.1", min_length=1, max_length=253, pattern=NAME)
    web_names: tuple[Annotated[str, Field(pattern=NAME, max_length=253)], ...] = Field(default=(), max_length=16)
    web_certificate: str = Field(default="", max_length=4096)
    web_key: str = Field(default="", max_length=4096)
    web_hook_networks: tuple[IPv4Network | IPv6Network, ...] = Field(default=(), max_length=64)
    map_file: str = Field(default="", max_length=4096)
    database: str = Field(default="", max_length=1024)
    nats_host: str = Field(default="127.0.0.1", min_length=1, max_length=253, pattern=NAME)
    nats_port: int = Field(default=4222, ge=1, le=65535)
    postgres_port: int = Field(default=5433, ge=1, le=65535)


class Centre:
    """The folder of a centre."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        try:
            self.folder.mkdir(mode=0o711, parents=True, exist_ok=True)
            path = self.folder / FILE
            if not path.exists():
                path.touch(0o600)  # it may hold a password of the database
                path.write_text(EXAMPLE, encoding="utf-8")
            self.settings = Settings.model_validate(tomllib.loads(read_text(path, MAX_BYTES)))
        except OSError as error:
            raise UserError(f"cannot use {self.folder}: {error.strerror}; name another with --folder") from error
        except ValidationError as error:
            first = error.errors()[0]
            name, why = ".".join(map(str, first["loc"])), first["msg"]
            if first["type"] == "extra_forbidden":
                why = f"there is no such setting; there are {', '.join(Settings.model_fields)}"
            raise UserError(f"{path}: {name}: {why}; change it") from error
        except (tomllib.TOMLDecodeError, SizeExceeded, UnicodeDecodeError) as error:
            raise UserError(f"{path} is no file of a centre: {error}; correct it, or move it away") from error

    @property
    def authority(self) -> Path:
        """Folder of the authority: its key, and the certificate of the servers."""
        return self.folder / "authority"

    @property
    def authority_pem(self) -> str:
        """Certificate of the authority; raises `UserError`."""
        path = self.authority / AUTHORITY
        try:
            return read_text(path, MAX_BYTES)
        except (OSError, SizeExceeded, UnicodeDecodeError) as error:
            raise UserError(f"cannot read {path}: {error}; `obu centre up` makes it at its first start") from error

    @property
    def passwords(self) -> dict[str, str]:
        """Passwords of the users of NATS."""
        return {name: self._password("nats", name) for name in USERS}

    @property
    def database_passwords(self) -> dict[str, str]:
        """Passwords of the processes at the database."""
        return {name: self._password("database", name) for name in ROLES}

    def _password(self, server: str, name: str) -> str:
        return self.secret(f"{server}-{name}", 24).hex()

    def nats(self, user: str) -> NatsAccess:
        """Where a process connects to NATS, and how that proves to be the centre's. Raises `UserError`."""
        host = LOOPBACK if is_loopback(self.settings.nats_host) else bracketed(self.settings.nats_host)
        url = f"tls://{user}:{self._password('nats', user)}@{host}:{self.settings.nats_port}"
        return NatsAccess(url, self.authority_pem)

    @property
    def postgres(self) -> Postgres:
        """The database server of a centre on one machine."""
        return Postgres(self.folder / "postgres", self.settings.postgres_port)

    @property
    def has_own_database(self) -> bool:
        """Whether the database is a server of this machine that belongs to this centre."""
        return not (os.environ.get("OBU_CENTRE_DSN") or self.settings.database)

    @property
    def owner_dsn(self) -> str:
        """Where the owner of the database connects: OBU_CENTRE_DSN, the settings, or the server of this machine."""
        given = os.environ.get("OBU_CENTRE_DSN") or self.settings.database
        if not given:
            return self.postgres.dsn
        stated, own = conninfo_to_dict(given), {"user": USER}
        passfile = self.folder / SECRETS / OWNER_PASSFILE
        if not stated.get("password") and os.access(passfile, os.R_OK):
            own["passfile"] = str(passfile)
        return make_conninfo(given, **{name: value for name, value in own.items() if not stated.get(name)})

    def dsn(self, process: str) -> str:
        """Where a process connects to the database, by a name and a password of its own."""
        return dsn_of_process(self.owner_dsn, process, self._password("database", process))

    @property
    def address(self) -> dict[str, object]:
        """What a vehicle is told of the centre."""
        return {
            "host": self.settings.host,
            "mqtt_port": self.settings.mqtt_port,
            "renew_url": f"{self.enrol_url}/renew",
        }

    @property
    def enrol_url(self) -> str:
        """Address that `obu enrol` is given."""
        return f"https://{bracketed(self.settings.host)}:{self.settings.enrol_port}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names that the certificate of the servers is for."""
        return tuple(dict.fromkeys((self.settings.host, *self.settings.web_names, OWN_NAME, LOOPBACK)))

    @property
    def web_certificate(self) -> tuple[Path, Path] | None:
        """Certificate and key of the pages; None: HTTP, for this machine alone."""
        settings = self.settings
        if settings.web_certificate and settings.web_key:
            return Path(settings.web_certificate), Path(settings.web_key)
        if settings.web_certificate or settings.web_key:
            raise UserError(f"{self.folder / FILE}: web_certificate and web_key belong together; state both or neither")
        return None if is_loopback(settings.web_listen) else (self.authority / SERVER, self.authority / SERVER_KEY)

    def check(self) -> None:
        """Look at what a start needs and the settings name; raises `UserError` with the setting to change."""
        settings = self.settings
        given = self.web_certificate
        if given is not None and settings.web_certificate:
            check_certificate(*given)
        ports = [(settings.listen, "mqtt_port"), (settings.listen, "enrol_port"), (settings.web_listen, "web_port")]
        if is_loopback(settings.nats_host):
            ports.append((LOOPBACK, "nats_port"))
        for (_, name), (_, other) in combinations(ports, 2):  # whatever the address: 0.0.0.0 takes the port of each
            if getattr(settings, name) == getattr(settings, other):
                raise UserError(
                    f"{self.folder / FILE}: {name} and {other} are both {getattr(settings, name)}; "
                    "give each a port of its own"
                )
        for host, name in ports:
            must_be_free(host, getattr(settings, name), name)

    @property
    def web_url(self) -> str:
        """Address of the pages."""
        settings = self.settings
        host = "127.0.0.1" if is_loopback(settings.web_listen) else settings.host
        return f"{'http' if self.web_certificate is None else 'https'}://{bracketed(host)}:{settings.web_port}"

    def secret(self, name: str, size: int) -> bytes:
        """Read a secret, and make it if there is none; two that make it at once agree on one."""
        path = self.folder / SECRETS / name
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not path.exists():
                draft = path.with_name(f".{name}.{os.getpid()}.{secrets.token_hex(4)}")
                with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o400), "wb") as file:
                    file.write(secrets.token_bytes(size))
                    file.flush()
                    os.fsync(file.fileno())
                try:
                    os.link(draft, path)
                except FileExistsError:
                    pass  # another process was first: its secret is read below
                finally:
                    draft.unlink()
            return path.read_bytes()
        except OSError as error:
            raise UserError(f"cannot use {path}: {error.strerror}; check its owner") from error


def check_certificate(certificate: Path, key: Path) -> None:
    """Raise `UserError` if the pages cannot be served with a certificate."""
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key, password="")
    except (OSError, ValueError) as error:  # of the files, and of what they hold
        reason = getattr(error, "strerror", None) or error
        raise UserError(
            f"web_certificate and web_key ({certificate}, {key}): {reason}; name certificate and key in centre.toml, "
            "both PEM and without a password"
        ) from error


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches an address."""
    return host in {"localhost", "::1"} or host.startswith("127.")
