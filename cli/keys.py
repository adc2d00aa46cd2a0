"""`obu keys`: the secrets with which processes and programs identify themselves to the broker."""

import grp
import os
import pwd
import re
import shutil
from pathlib import Path

from broker import keys
from shared.errors import UserError
from shared.programs import READER, ROLES
from shared.runtime.config import VehicleFile, load_vehicle, state_dir
from shared.runtime.credentials import FOLDER, INSTALLED, OBSERVERS, folder_of
from shared.runtime.private import private_folder

MAX_READERS = 32
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
    vehicle: Path | None,
    files: Path | None,
    owner: str | None,
    group: str | None = None,
    *,
    containers: bool = False,
    socket_folder: Path | None = None,
) -> int:
    """Make the secrets that are missing, and write the broker's files."""
    where = folder()
    before = _made_before(where)  # what is not given stays
    unit = _vehicle_of(before, vehicle)
    path = Path(unit.path)
    made = keys.KeyFileOwners(
        str(path.resolve()) if path.is_file() else unit.path,
        str(files.resolve()) if files else before.files if before else str(where.parent / keys.RULES),
        owner or (before.owner if before else None) or (str(keys.CONTAINER_BROKER) if containers else None),
        containers or bool(before and before.containers),
    )
    passwords, rules = keys.make(where, unit, made)
    if containers or group is not None:
        state = state_dir().resolve()
        owners = {
            name: keys.CONTAINER_USERS[process] if group is None else _user(f"{group}-{re.sub('[._]', '-', process)}")
            for name, process in keys.OWN_FOLDERS.items()
        }
        shared_by = keys.CONTAINER_GROUP if group is None else _group(group)
        keys.share(state, shared_by)
        signing = keys.CONTAINER_EVIDENCE_GROUP if group is None else _group(f"{group}-evidence")
        keys.separate(private_folder(state), owners, shared_by, signing)
        if socket_folder is not None:
            if made.owner is None:
                raise UserError("whose socket is it? Name the broker's user with --broker-user")
            keys.share_socket(socket_folder, keys.user_number(made.owner), shared_by)
    elif socket_folder is not None:
        raise UserError("--socket-folder needs --group or --containers: who may connect")
    print(f"secrets of {unit.name!r} in {where}; the broker's files: {passwords} and {rules}")
    return 0


def _made_before(where: Path) -> keys.KeyFileOwners | None:
    return keys.made_in(where) if (where / keys.MADE).exists() else None


def _vehicle_of(before: keys.KeyFileOwners | None, vehicle: Path | None) -> VehicleFile:
    if vehicle is None and "OBU_VEHICLE" not in os.environ and before and Path(before.vehicle).is_file():
        return load_vehicle(before.vehicle)
    return load_vehicle(vehicle)


def show() -> int:
    """Print who has a secret, and what for; never the secret."""
    where = folder()
    keys.made_in(where)
    for name in keys.processes_of(where):
        print(f"{name:24} {'listens' if name in OBSERVERS else 'process or program of the unit'}")
    for name, role in keys.programs_of(where).items():
        print(f"{name:24} {'listens' if role == READER else role} (obu keys add)")
    return 0


def add(name: str, role: str = READER) -> int:
    """Make a user with the rights of a role, and print the address that holds its secret."""
    where = folder()
    made = keys.made_in(where)
    if role not in ROLES:
        raise UserError(f"there is no role {role!r}; the roles are {', '.join(ROLES)}")
    if len(set(keys.programs_of(where)) - {name}) >= MAX_READERS:
        raise UserError(f"there are {MAX_READERS} users already; remove one with `obu keys remove NAME`")
    _tell(name, keys.add_program(where, name, role))
    _write_rules(where, made)
    return 0


def remove(name: str) -> int:
    """Delete a user of `obu keys add`."""
    where = folder()
    made = keys.made_in(where)
    keys.remove_program(where, name)
    _write_rules(where, made)
    print(TAKE_EFFECT)
    return 0


def rotate(name: str | None) -> int:
    """Replace one secret, or all; processes read theirs when they start."""
    where = folder()
    made = keys.made_in(where)
    programs, processes = keys.programs_of(where), keys.processes_of(where)
    if name is not None and name not in (*programs, *processes):
        raise UserError(f"there is no secret of {name!r}; `obu keys list` lists them")
    for program, role in programs.items():
        if name in (None, program):
            keys.remove_program(where, program)
            _tell(program, keys.add_program(where, program, role))
    replaced = [process for process in processes if name in (None, process)]
    for process in replaced:
        keys.forget(where, process)
    _write_rules(where, made)
    if replaced:
        print(f"replaced: {', '.join(replaced)}; restart the unit: broker and processes read theirs when they start")
    return 0


def _tell(name: str, secret: str) -> None:
    print(f"OBU_BROKER=mqtt://{name}:{secret}@HOST:1883")
    print(TAKE_EFFECT)


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


def _write_rules(where: Path, made: keys.KeyFileOwners) -> None:
    unit = load_vehicle(made.vehicle) if Path(made.vehicle).is_file() else load_vehicle()
    keys.make(where, unit, made)
