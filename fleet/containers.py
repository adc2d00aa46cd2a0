"""A centre in containers: each has a user of its own, and can read its own secrets alone."""

import logging
import os
from pathlib import Path

from shared.errors import UserError
from shared.fleet.enrolling import fingerprint_of

from .admission.authority import AUTHORITY, AUTHORITY_KEY, SERVER, SERVER_KEY
from .centre import OWNER_PASSFILE, SECRETS, Centre
from .database.roles import ROLES
from .servers.nats import USERS as NATS_USERS
from .servers.postgres import USER
from .up import nats_configuration

log = logging.getLogger(__name__)

GROUP = 10300  # of all; reads the certificate of the servers
OWNER, OWNER_TEXT = "database-owner", "database-owner.txt"
USERS = {
    "root": 0, "nats": 10301, "admission": 10302, "ingest": 10303, "alarms": 10304, "web": 10305, "maintenance": 10306,
    "postgres": 999,  # of the image of PostgreSQL
}  # fmt: skip
OF_NATS = {"callout": "admission", "system": "admission"}  # whose secret it is; others have the name of their process
JETSTREAM = "nats/jetstream"  # in memory there: nothing of it has to outlive the server


def prepare(centre: Centre) -> None:
    """Make the files of a centre, and give each to its user. Raises `UserError`; needs root."""
    if os.geteuid() != 0:
        raise UserError("secrets of containers have users of their own: run this as root, as the Compose file does")
    store = centre.folder / "nats"
    files = {store / "nats.conf": nats_configuration(centre, store), **_of_owner(centre)}
    made = {**centre.passwords, **centre.database_passwords}
    log.info("%d passwords, and the authority %s", len(made), fingerprint_of(centre.authority_pem))
    try:
        (centre.folder / JETSTREAM).mkdir(mode=0o700, parents=True, exist_ok=True)
        for path, text in files.items():
            draft = path.with_name(f".{path.name}")
            draft.unlink(missing_ok=True)
            with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o400), "w", encoding="utf-8") as file:
                file.write(text)
            draft.replace(path)
        for name, user, group, mode in owners():
            os.chown(centre.folder / name, USERS[user], group)
            (centre.folder / name).chmod(mode)
    except OSError as error:
        raise UserError(f"cannot write {error.filename}: {error.strerror}; check the volume of the centre") from error


def _of_owner(centre: Centre) -> dict[Path, str]:
    """Password of the database's owner: for the server, and in the form of libpq for maintenance."""
    password = centre.secret(OWNER, 24).hex()
    folder = centre.folder / SECRETS
    return {folder / OWNER_TEXT: password, folder / OWNER_PASSFILE: f"*:*:*:{USER}:{password}\n"}


def owners() -> list[tuple[str, str, int, int]]:
    """List files and folders with user, group and mode."""
    own = USERS["maintenance"]
    found = [
        ("secrets", "root", GROUP, 0o750),
        ("secrets/issuer", "admission", GROUP, 0o400),
        (f"secrets/{OWNER}", "root", GROUP, 0o400),
        (f"secrets/{OWNER_TEXT}", "postgres", GROUP, 0o400),
        (f"secrets/{OWNER_PASSFILE}", "maintenance", GROUP, 0o400),
        ("authority", "admission", GROUP, 0o750),
        (f"authority/{AUTHORITY_KEY}", "admission", GROUP, 0o400),
        (f"authority/{AUTHORITY}", "admission", GROUP, 0o440),
        (f"authority/{SERVER}", "admission", GROUP, 0o440),
        (f"authority/{SERVER_KEY}", "admission", GROUP, 0o440),
        ("nats", "nats", GROUP, 0o700),
        (JETSTREAM, "nats", GROUP, 0o700),
        ("nats/nats.conf", "nats", GROUP, 0o400),
    ]
    # Maintenance sets the passwords at the database, and tells NATS of revocations.
    found += [(f"secrets/database-{name}", name, own, 0o440) for name in ROLES]
    found += [(f"secrets/nats-{name}", OF_NATS.get(name, name), own, 0o440) for name in NATS_USERS]
    return found
