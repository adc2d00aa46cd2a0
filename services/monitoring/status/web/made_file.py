"""A file that a command makes for a download: a child process, one at a time, in a folder that is deleted behind it."""

import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from fastapi import HTTPException
from fastapi.responses import FileResponse
from starlette.types import Receive, Scope, Send

SAID = 300  # characters of a command's last words
NO_MORE: Mapping[str, str] = {}  # of the environment


@dataclass(frozen=True)
class Making:
    """How a file is made: by `python -m cli` with these arguments, which write it to its path."""

    arguments: tuple[str, ...]
    media_type: str
    within_s: float
    by_hand: str  # command that makes it without a page
    environment: Mapping[str, str] = field(default_factory=dict)


class _OfFolder(FileResponse):
    """A file whose folder is deleted behind it, however the answer ends: sent, refused, cut off, or its head alone."""

    def __init__(self, folder: tempfile.TemporaryDirectory[str], path: Path, media_type: str, name: str) -> None:
        super().__init__(path, media_type=media_type, filename=name)
        self._kept = folder

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._kept.cleanup()


class MadeFiles:
    """Lets commands make files below a folder, one at a time: the page itself loads no library of theirs."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._busy = folder, threading.Lock()

    def make(self, how: Callable[[Path], Making], name: str, busy: str) -> FileResponse:
        """Make a file and answer with it.

        Parameters
        ----------
        how : callable
            Gives what is made for the path of the file.
        name : str
            Of the download.
        busy : str
            What is said while another one is being made.

        Raises
        ------
        HTTPException
            409 while another one is being made, 500 where it cannot be made, with what to try next.
        """
        if not self._busy.acquire(blocking=False):
            raise HTTPException(409, busy)
        try:
            self._folder.mkdir(exist_ok=True)
            kept = tempfile.TemporaryDirectory(prefix="made-", dir=self._folder)
            try:
                path = (Path(kept.name) / "made").with_suffix(Path(name).suffix)
                making = how(path)
                _run(making, Path(kept.name))
                return _OfFolder(kept, path, making.media_type, name)
            except BaseException:
                kept.cleanup()
                raise
        except OSError as error:
            raise HTTPException(500, f"cannot write to {self._folder}: {error.strerror}; make room") from error
        finally:
            self._busy.release()


def _run(making: Making, folder: Path) -> None:
    done = run_command(making.arguments, making.within_s, f"run `{making.by_hand}` on the unit",
                       {"TMPDIR": str(folder), **making.environment})  # fmt: skip
    if done.returncode:
        said = done.stderr.strip().removeprefix("obu: ")[-SAID:]
        raise HTTPException(500, said or f"it ended without a word; run `{making.by_hand}` there")


def run_command(
    arguments: Sequence[str], within_s: float, instead: str, environment: Mapping[str, str] = NO_MORE
) -> subprocess.CompletedProcess[str]:
    """Run a command of the unit as a child; raises `HTTPException` 500 with what to do `instead` where it hangs."""
    try:
        return subprocess.run(
            ["nice", sys.executable, "-m", "cli", *arguments], env={**os.environ, **environment},
            stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=within_s, check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        raise HTTPException(500, f"{error}; {instead}") from error
