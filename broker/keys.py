"""Makes the secrets of a unit, and the files by which its broker checks them: passwords and access list.

A secret that exists is kept. The folder of the secrets must belong to whoever runs this: otherwise somebody else may
have chosen them.
"""

import json
import os
import pwd
import re
import secrets
import shutil
import stat
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from shared.errors import UserError
from shared.evidence import EvidenceError, KeyFile, keys_folder
from shared.processes import PROCESSES, Kind, ProcessRow, running
from shared.programs import READER, ROLES
from shared.runtime.config import VehicleFile
from shared.runtime.credentials import ADDRESS, CHECK, OBSERVER, OBSERVERS, READERS, WATCH
from shared.runtime.overlay import SETTINGS
from shared.runtime.private import PAGE, UPLINK
from shared.topics import REPLAY

from .acl import access_list
from .passwords import password_file

SECRET_BYTES = 32
MADE = "made.json"  # in the folder of the secrets: for whom they were made
PASSWORDS, ACCESS_LIST = "passwords", "acl.conf"
RULES = "rules"  # in the state folder, where no other place is given: the broker's files
READER_NAME = re.compile(r"[a-z][a-z0-9_-]{0,47}")
RESERVED = (REPLAY, OBSERVER, ADDRESS)  # names that mean something else
CONTAINER_GROUP, CONTAINER_EVIDENCE_GROUP = 10_001, 10_002
CONTAINER_USERS = {row.name: row.container_user for row in PROCESSES if row.container_user is not None}
CONTAINER_BROKER = 1883  # user of the image eclipse-mosquitto


@dataclass(frozen=True)
class KeyFileOwners:
    """For whom the files were made: `vehicle` is the vehicle's file, `owner` the user of the broker."""

    vehicle: str
    files: str
    owner: str | None = None
    containers: bool = False
    replay: bool = False


def rows_of(vehicle: VehicleFile, *, replay: bool = False) -> tuple[ProcessRow, ...]:
    """Processes that have rights on the bus of a unit: its own; in a replay all, for one of them publishes for all."""
    if replay:
        return PROCESSES
    wanted = running(vehicle.role, vehicle.tables)
    # Those that a container starts although the file has no section for them.
    optional = (row for row in PROCESSES if row.kind is Kind.OPTIONAL and vehicle.role in row.roles)
    return (*wanted, *(row for row in optional if row not in wanted))


def may_be_replayed(rows: Iterable[ProcessRow]) -> bool:
    """Whether `obu replay --broker` may publish: only where no device and no simulator does."""
    return not any(row.kind in (Kind.DEVICE_DRIVER, Kind.SIMULATOR) for row in rows)


def make(folder: Path, vehicle: VehicleFile, made: KeyFileOwners) -> tuple[Path, Path]:
    """Make what is missing in the folder of the secrets, and write the broker's files; gives these two paths."""
    _own_folder(folder)
    files = Path(made.files)
    try:
        files.mkdir(mode=0o755, parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot make the folder {files}: {error.strerror}; name another one") from error
    rows = rows_of(vehicle, replay=made.replay)
    names = (*(row.name for row in rows), *OBSERVERS, *((REPLAY,) if may_be_replayed(rows) else ()))
    secret_of = {name: _secret(folder / name) for name in names}
    programs = programs_of(folder)
    outside = {name: _secret(_place(folder, role) / name) for name, role in programs.items()}
    if made.containers:
        for name in names:
            os.chown(folder / name, _container_user(name), CONTAINER_GROUP)
        folder.chmod(0o755)
    secret_of |= {name: _secret(files / name) for name in (WATCH, CHECK)}
    if made.owner is not None:
        for name in (WATCH, CHECK):
            shutil.chown(files / name, user_number(made.owner))
    write_file(folder / MADE, json.dumps(asdict(made)).encode())
    passwords, rules = files / PASSWORDS, files / ACCESS_LIST
    before = passwords.read_text(encoding="ascii") if passwords.exists() else ""
    write_file(passwords, password_file(secret_of | outside, before).encode(), made.owner)
    rights = access_list(vehicle.name, rows=rows, programs=programs, replay=made.replay, replayed=may_be_replayed(rows))
    write_file(rules, rights.encode(), made.owner)
    return passwords, rules


# Folder in the private one: process that alone writes into it.
OWN_FOLDERS = {PAGE: "monitoring.status", UPLINK: "monitoring.uplink", SETTINGS: "controller.settings"}


def separate(private: Path, owners: Mapping[str, int], group: int, evidence_group: int) -> None:
    """Make the folders of what not every process may touch, in a folder of root.

    `page` is of the user of monitoring.status, `uplink`, the enrolment at a centre, of that of monitoring.uplink, and
    `settings`, which the group of the processes may read, of that of controller.settings; `owners` names them by
    folder. `keys` holds the key that signs, for the group of those that do.
    """
    signing = keys_folder(private)
    try:
        _own_folder(private, 0o755)
        for name in OWN_FOLDERS:
            folder = private / name
            folder.mkdir(mode=0o700, exist_ok=True)
            if folder.is_symlink():
                raise UserError(f"{folder} is a link: somebody may have put it there; remove it")
            os.chown(folder, owners[name], group if name == SETTINGS else -1, follow_symlinks=False)
            folder.chmod(0o750 if name == SETTINGS else 0o700)
        for path in (private / UPLINK).iterdir():  # of an enrolment before the folder was made
            os.chown(path, owners[UPLINK], -1, follow_symlinks=False)
        _own_folder(signing, 0o750)
        os.chown(signing, -1, evidence_group)
        signing.chmod(0o750)
        KeyFile(signing).signer()
        for path in signing.iterdir():
            os.chown(path, -1, evidence_group, follow_symlinks=False)
            if not path.is_symlink():
                path.chmod(0o640 if path.suffix == ".json" else 0o440)
    except OSError as error:
        raise UserError(f"cannot write into {private}: {error.strerror}; run the command with `sudo`") from error
    except EvidenceError as error:
        raise UserError(str(error)) from error


def share_socket(folder: Path, owner: int, group: int) -> None:
    """Make the folder in which the broker, user `owner`, puts its socket, which takes the folder's group.

    The group may enter it and connect, and nobody else.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
        try:
            os.fchown(opened, os.geteuid(), os.getegid())
            os.fchmod(opened, 0o2750)  # before its group is another's: a container may not set the bit afterwards
            os.fchown(opened, owner, group)
        finally:
            os.close(opened)
    except OSError as error:
        raise UserError(f"cannot make the folder {folder}: {error.strerror}; run the command with `sudo`") from error


def share(state: Path, group: int) -> None:
    """Give the state folder of an earlier version, where one user ran every process, to root and a group.

    Done once: afterwards the processes of the group change what is in it. No link is followed.
    """
    try:
        found = state.stat()
        if (found.st_uid, found.st_gid) == (os.geteuid(), group) and found.st_mode & 0o2070 == 0o2070:
            return
        for _, folders, files, descriptor in os.fwalk(state, follow_symlinks=False):
            for name in (*folders, *files):
                _share(name, descriptor, group)
        os.chown(state, os.geteuid(), group)
        state.chmod(0o2770)
    except OSError as error:
        raise UserError(f"cannot share {state}: {error.strerror}; run the command with `sudo`") from error


def _share(name: str, folder: int, group: int) -> None:
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        opened = os.open(name, flags, dir_fd=folder)
    except OSError:
        return  # a link, a socket, or gone
    try:
        found = os.fstat(opened)
        is_folder = stat.S_ISDIR(found.st_mode)
        if is_folder or (stat.S_ISREG(found.st_mode) and found.st_nlink == 1):
            os.fchown(opened, -1, group)
            os.fchmod(opened, stat.S_IMODE(found.st_mode) | (0o2770 if is_folder else 0o660))
    finally:
        os.close(opened)


def made_in(folder: Path) -> KeyFileOwners:
    """For whom the secrets of a folder were made; raises `UserError` where there are none."""
    try:
        insist_on_own(folder)
        return KeyFileOwners(**json.loads((folder / MADE).read_text(encoding="utf-8")))
    except (FileNotFoundError, NotADirectoryError):
        raise UserError(f"there are no secrets in {folder}: `obu keys make` makes them") from None
    except (OSError, ValueError, TypeError) as error:
        raise UserError(f"cannot read {folder / MADE}: {error}; run `obu keys make` with its options again") from error


def programs_of(folder: Path) -> dict[str, str]:
    """Names of the further users, with the role of each, in the order of their names."""
    found = {
        path.name: role
        for role in ROLES
        for path in _place(folder, role).glob("*")
        if READER_NAME.fullmatch(path.name)
    }  # fmt: skip
    return dict(sorted(found.items()))


def _place(folder: Path, role: str) -> Path:
    """Folder of the secrets of a role."""
    return folder / (READERS if role == READER else f"{role}s")


def processes_of(folder: Path) -> list[str]:
    """Names of the processes and programs of the unit that have a secret."""
    others = (MADE, ADDRESS)
    return sorted(p.name for p in folder.iterdir() if p.is_file() and p.name[0] != "." and p.name not in others)


def add_program(folder: Path, name: str, role: str = READER) -> str:
    """Make the secret of a further user with a role, and give it; raises `UserError` for no such name."""
    if not READER_NAME.fullmatch(name) or name in RESERVED:
        raise UserError(f"{name!r} is no name of a reader: a letter, then up to 47 letters, digits, - or _, lower case")
    if (other := programs_of(folder).get(name, role)) != role:
        raise UserError(f"{name!r} has the role {other!r} already; remove it first, or take another name")
    _place(folder, role).mkdir(mode=0o700, exist_ok=True)
    return _secret(_place(folder, role) / name)


def remove_program(folder: Path, name: str) -> None:
    """Delete the secret of a further user; raises `UserError` if there is none."""
    role = programs_of(folder).get(name)
    if role is None:
        raise UserError(f"there is no user {name!r}; `obu keys list` lists them")
    (_place(folder, role) / name).unlink()


def forget(folder: Path, name: str) -> None:
    """Delete the secret of a process or program of the unit; `make` makes a new one."""
    if name in processes_of(folder):
        (folder / name).unlink()


def _own_folder(folder: Path, mode: int = 0o700) -> None:
    """Make a folder, or make sure that nobody else can have changed what is in it."""
    try:
        folder.mkdir(mode=mode, parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot make the folder {folder}: {error.strerror}; remove what is in its place") from error
    insist_on_own(folder)


def insist_on_own(folder: Path) -> None:
    """Raise `UserError` if a folder is another user's, or can be written by others."""
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.geteuid() or found.st_mode & 0o022:
        raise UserError(
            f"the folder {folder} is another user's (uid {found.st_uid}) or others may write it: somebody may know or "
            "have chosen its secrets; remove it, and run `obu keys make` again"
        )


def _secret(path: Path) -> str:
    """Read a secret, or make it: 32 random bytes as hexadecimal digits, in a file that its owner alone can read."""
    try:
        found = path.read_text(encoding="ascii").strip()
    except FileNotFoundError:
        found = ""
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"cannot read the secret {path}: {error}; remove it, and run `obu keys make` again") from error
    if len(found) != 2 * SECRET_BYTES:  # none, or cut by a power failure
        found = secrets.token_hex(SECRET_BYTES)
        write_file(path, f"{found}\n".encode(), mode=0o400)
    return found


def write_file(path: Path, content: bytes, owner: str | None = None, mode: int = 0o600) -> None:
    """Replace a file in one step; `owner` is a name or a number. Raises `UserError`."""
    part = path.with_name(f".{path.name}.part")
    try:
        part.unlink(missing_ok=True)
        with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        if owner is not None:
            shutil.chown(part, user_number(owner))
        part.replace(path)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}; run the command with `sudo`, or free space") from error


def user_number(owner: str) -> int:
    """Number of a user, given by name or number; raises `UserError`."""
    if owner.isdigit():
        return int(owner)
    try:
        return pwd.getpwnam(owner).pw_uid
    except KeyError:
        raise UserError(f"there is no user {owner!r} on this machine; install Mosquitto, or give another") from None


def _container_user(name: str) -> int:
    return CONTAINER_USERS.get(name, CONTAINER_GROUP)
