"""Files of a unit as root reads, replaces and deletes them: its processes may write their folders, and plant links.

No link at the end of a path is followed, and what is not a plain file is not read.
"""

import os
import shutil
import stat
from io import BytesIO
from pathlib import Path
from typing import IO

from shared.bounded import SizeExceeded

PRIVATE_MODE = 0o600


def open_plain(path: Path) -> IO[bytes]:
    """Open a file for reading; raises `OSError` also where it is a link, or no plain file."""
    handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(0, "it is no plain file", str(path))
    return os.fdopen(handle, "rb")


def read_plain(path: Path, most: int) -> tuple[bytes, int]:
    """Content of at most `most` bytes and rights of a plain file; raises `SizeExceeded`, and `OSError`."""
    with open_plain(path) as file:
        content, mode = file.read(most + 1), os.fstat(file.fileno()).st_mode & 0o7777
    if len(content) > most:
        raise SizeExceeded(f"it has more than {most} bytes")
    return content, mode


def replace(path: Path, content: bytes, mode: int, *, keep_old: bool = True) -> None:
    """Write a file in place of another, which stays as `.old` with `keep_old`; one with this content is left alone.

    Owner and rights are those of the file that is replaced; without one, its folder's owner and `mode`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    like = path.parent.stat()
    if is_plain(path):
        like = path.lstat()
        mode = like.st_mode & 0o777
        with open_plain(path) as file:
            if file.read(len(content) + 1) == content:
                return
            if keep_old:
                file.seek(0)
                old = path.with_name(f"{path.name}.old")
                _write(old, file, PRIVATE_MODE, like)
    with BytesIO(content) as file:
        _write(path, file, mode, like)


def is_plain(path: Path) -> bool:
    """Whether there is a plain file, and no link to one."""
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except FileNotFoundError:
        return False


def delete(path: Path) -> None:
    """Delete a file or a link, or what a folder holds; a folder stays, with its owner and rights."""
    if path.is_symlink() or not path.is_dir():
        path.unlink(missing_ok=True)
        return
    handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        with os.scandir(handle) as entries:
            found = [(entry.name, entry.is_dir(follow_symlinks=False)) for entry in entries]
        for name, is_folder in found:
            shutil.rmtree(name, dir_fd=handle) if is_folder else os.unlink(name, dir_fd=handle)
    finally:
        os.close(handle)


def _write(path: Path, source: IO[bytes], mode: int, like: os.stat_result) -> None:
    """Write a file by a new one that takes its name; a link of that name is replaced, not followed."""
    part = path.with_name(f"{path.name}.part")
    part.unlink(missing_ok=True)
    handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, PRIVATE_MODE)
    with os.fdopen(handle, "wb") as file:
        shutil.copyfileobj(source, file)
        file.flush()
        os.fsync(file.fileno())
        if os.geteuid() == 0:
            os.fchown(file.fileno(), like.st_uid, like.st_gid)
        os.fchmod(file.fileno(), mode)
    part.replace(path)
