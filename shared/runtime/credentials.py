"""Secrets with which processes and programs identify themselves to the broker: one file each, its name the user's.

`obu keys make` writes them (broker/keys.py). A process under systemd reads its own from `$CREDENTIALS_DIRECTORY`,
every other one from the folder `$OBU_CREDENTIALS`, or `credentials` in the state folder. Programs that listen share
eight users, each claimed by a lock: of two clients of one user the broker always disconnects the other.
"""

import fcntl
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO
from urllib.parse import quote

from ..errors import UserError
from ..topics import REPLAY
from .private import PRIVATE, private_folder

FOLDER = "credentials"
ADDRESS = "address"  # in the folder: where the broker that knows these secrets is, where a program started it
READERS = "readers"  # in the folder: those of `obu keys add`
INSTALLED = PRIVATE  # of a unit under systemd
MAX_LENGTH = 1_000  # bytes of a file
PLAIN = "/:[]"  # letters of an address that stand as they are
OBSERVER = "observer"
OBSERVERS = tuple(f"{OBSERVER}.{number}" for number in range(1, 9))
WATCH, CHECK = "broker.watch", "broker.check"  # the broker's own probe, and the health check of its container


@dataclass(frozen=True)
class Identity:
    """User of the broker; without a secret it is claimed, not proved, and only a broker without passwords agrees."""

    user: str
    secret: str | None = field(default=None, repr=False)
    claim: IO[str] | None = field(default=None, repr=False)  # holds the lock of an observer

    def release(self) -> None:
        """Let another program be this observer."""
        if self.claim is not None:
            self.claim.close()


def folder_of(state: Path) -> Path:
    """Folder of the secrets of a unit with this state folder."""
    return Path(os.environ.get("OBU_CREDENTIALS") or private_folder(state) / FOLDER)


def identity_of(process: str, state: Path) -> Identity:
    """Read the secret of a process; raises `UserError` where it exists and cannot be read."""
    if given := os.environ.get("CREDENTIALS_DIRECTORY"):
        secret = _read(Path(given) / "secret")
        if secret is not None:
            return Identity(process, secret)
    return Identity(process, _read(folder_of(state) / process))


def observer_of(state: Path, address: str) -> Identity:
    """Claim an observer of the broker at `address` (host:port or a path); raises `UserError` if all are in use."""
    folder = _known(state, address)
    if folder is None:
        return Identity(OBSERVERS[0])
    for name in OBSERVERS:
        try:
            file = (folder / name).open(encoding="ascii")
        except FileNotFoundError:
            continue
        except OSError as error:
            raise _unreadable(folder / name, error) from error
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            file.close()
            continue
        return Identity(name, file.read(MAX_LENGTH).strip(), file)
    raise UserError(
        f"all {len(OBSERVERS)} observers of the bus are in use; end an `obu tail` or `obu record`, or make a user of "
        "your own with `obu keys add NAME --read`"
    )


def replay_of(state: Path, address: str) -> Identity:
    """Read the secret of `obu replay --broker` for the broker at `address` (host:port or a path)."""
    folder = _known(state, address)
    return Identity(REPLAY, _read(folder / REPLAY) if folder else None)


def _known(state: Path, address: str) -> Path | None:
    """Find the secrets of a broker: of the demo in this state folder, of the unit itself, of an installed unit."""
    if given := os.environ.get("OBU_CREDENTIALS"):
        return Path(given)
    folders = [base / FOLDER for base in (state, state / "demo", INSTALLED) if _is_folder(base / FOLDER)]
    started = [folder for folder in folders if quote(address, safe=PLAIN) in (_read(folder / ADDRESS) or "").split()]
    return next(iter((*started, *(folder for folder in folders if _read(folder / ADDRESS) is None))), None)


def note_addresses(folder: Path, *addresses: str) -> None:
    """Write where the broker that knows the secrets of a folder is: host:port, or the path of a socket."""
    (folder / ADDRESS).write_text("".join(f"{quote(address, safe=PLAIN)}\n" for address in addresses), encoding="ascii")


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:
        return False


def _read(path: Path) -> str | None:
    try:
        with path.open(encoding="ascii") as file:
            return file.read(MAX_LENGTH).strip()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, UnicodeDecodeError) as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: OSError | UnicodeDecodeError) -> UserError:
    reason = error.strerror if isinstance(error, OSError) else "it is not ASCII"
    return UserError(
        f"cannot read the secret {path}: {reason}; run the command with `sudo`, or as the user of that process, or let "
        "the unit's owner make one for you with `obu keys add NAME --read`"
    )
