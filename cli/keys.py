"""`obu keys`: the secrets with which processes and programs identify themselves to the broker."""

import grp
import os
import pwd
import re
import shutil
from pathlib import Path

from broker import keys
from shared.errors import UserError
from shared.runtime.config import load_vehicle, state_dir
from shared.runtime.credentials import FOLDER, INSTALLED, OBSERVERS, READERS, folder_of

READER_NAME = re.compile(r"[a-z][a-z0-9_-]{0,47}")
MOST_READERS = 32
PAGE_PROCESS = "monitoring.status"
TAKE_EFFECT = (
    "to take effect: `sudo systemctl reload obu-broker`, with containers `docker compose kill -s HUP broker`, "
    "otherwise restart the broker"
)


def folder() -> Path:
    """Folder of the secrets: of OBU_CREDENTIALS or OBU_STATE, else of an installed unit, else of the working folder."""
    if "OBU_STATE" not in os.environ and "OBU_CREDENTIALS" not in os.environ and not (Path(".obu") / FOLDER).exists():
        installed = INSTALLED / FOLDER
        try:
            if installed.is_dir():
                return installed
        except OSError as error:
            raise UserError(f"cannot read {installed}: {error.strerror}; run the command with `sudo`") from error
    return folder_of(state_dir().resolve())


def _group(name: str) -> int:
    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        raise UserError(f"there is no group {name!r} on this machine; run deploy/systemd/install.sh") from None


def _user(name: str) -> int:
    try:
        return pwd.getpwnam(name).pw_uid
    except KeyError:
        raise UserError(f"there is no user {name!r} on this machine; run deploy/systemd/install.sh") from None


def make(
    vehicle: Path | None, files: Path | None, owner: str | None, group: str | None = None, *, containers: bool = False
) -> int:
    """Make the secrets that are missing, and write the broker's files."""
    where = folder()
    unit = load_vehicle(vehicle)
    made = keys.Made(
        str(Path(unit.path).resolve()) if Path(unit.path).is_file() else unit.path,
        str((files or where.parent / keys.RULES).resolve()),
        owner or (str(keys.CONTAINER_BROKER) if containers else None),
        containers,
    )
    passwords, rules = keys.make(where, unit, made)
    if containers or group is not None:
        state = state_dir().resolve()
        keys.share(state, keys.CONTAINER_GROUP if group is None else _group(group))
        page_user = keys.CONTAINER_USERS[PAGE_PROCESS] if group is None else _user(f"{group}-monitoring-status")
        signing = keys.CONTAINER_EVIDENCE_GROUP if group is None else _group(f"{group}-evidence")
        keys.separate(state, page_user, signing)
    print(f"secrets of {unit.name!r} in {where}; the broker's files: {passwords} and {rules}")
    return 0


def show() -> int:
    """Print who has a secret, and what for; never the secret."""
    where = folder()
    keys.made_in(where)
    for path in sorted(where.iterdir()):
        if path.is_file() and not path.name.startswith(".") and path.name not in (keys.MADE, "address"):
            what = "listens" if path.name in OBSERVERS else "process or program of the unit"
            print(f"{path.name:24} {what}")
    for path in sorted((where / READERS).glob("*")):
        print(f"{path.name:24} listens (obu keys add)")
    return 0


def add(name: str) -> int:
    """Make a user that may read everything, and print the address that holds its secret."""
    where = folder()
    made = keys.made_in(where)
    if not READER_NAME.fullmatch(name):
        raise UserError(f"{name!r} is no name: a letter, then up to 47 letters, digits, - or _, all lower case")
    readers = {path.name for path in (where / READERS).glob("*")}
    if len(readers - {name}) >= MOST_READERS:
        raise UserError(f"there are {MOST_READERS} users already; remove one with `obu keys remove NAME`")
    secret = keys.add_reader(where, name)
    _write_rules(where, made)
    print(f"OBU_BROKER=mqtt://{name}:{secret}@HOST:1883")
    print(TAKE_EFFECT)
    return 0


def remove(name: str) -> int:
    """Delete a user of `obu keys add`."""
    where = folder()
    made = keys.made_in(where)
    if not (where / READERS / name).exists():
        raise UserError(f"there is no user {name!r}; `obu keys list` lists them")
    keys.forget(where, [name])
    _write_rules(where, made)
    print(TAKE_EFFECT)
    return 0


def rotate(name: str | None) -> int:
    """Replace one secret, or all; processes read theirs when they start."""
    where = folder()
    made = keys.made_in(where)
    names = {path.name for path in (*where.iterdir(), *(where / READERS).glob("*")) if path.is_file()}
    known = {one for one in names if not one.startswith(".")} - {keys.MADE, "address"}
    if name is not None and name not in known:
        raise UserError(f"there is no secret of {name!r}; `obu keys list` lists them")
    readers = {path.name for path in (where / READERS).glob("*")}
    chosen = known if name is None else {name}
    keys.forget(where, chosen)
    for reader in readers & chosen:
        keys.add_reader(where, reader)
    _write_rules(where, made)
    print(f"{len(chosen)} secrets replaced; restart the unit: broker and processes read theirs when they start")
    return 0


def tls(names: list[str]) -> int:
    """Make the certificate of a listener for other machines."""
    import datetime

    from broker.tls import KEY, make

    where = folder()
    made = keys.made_in(where)
    target = Path(made.files) / "tls"
    authority = make(target, where, names, datetime.datetime.now(datetime.UTC))
    if made.owner is not None:
        shutil.chown(target / KEY, keys.user_number(made.owner))
    print(f"certificate for {', '.join(names)} in {target}; give {authority} to the other machines (OBU_BROKER_CA)")
    print(f"then: python -m broker.local_config --rules {made.files} --listen 0.0.0.0, and restart the broker")
    return 0


def _write_rules(where: Path, made: keys.Made) -> None:
    unit = load_vehicle(made.vehicle) if Path(made.vehicle).is_file() else load_vehicle()
    keys.make(where, unit, made)
