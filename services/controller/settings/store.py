"""The files of the settings: the vehicle's file, the text over it, earlier texts, and the change that is watched."""

import contextlib
import os
from pathlib import Path

from pydantic import BaseModel, ValidationError

from shared.bounded import TOML_BYTES, SizeExceeded, read_bytes, read_text
from shared.errors import UserError
from shared.messages.settings import SettingsChange
from shared.runtime.overlay import FILE, basis_of, digest_of, over, without_basis
from shared.settings.history import History, write

WATCHED, WATCHED_BYTES = "watched.json", 1 << 20
MODE = 0o640  # the processes of the unit read it by their group


class Watched(BaseModel):
    """A change that was or is about to be written, the text before it, and what came before it."""

    change: SettingsChange
    text: str
    former: str | None  # None: the vehicle's file itself
    fresh: tuple[str, ...] = ()  # topics
    restarts: dict[str, int] = {}


class Store:
    """Reads and writes them; each write leaves the one text or the other after a power cut.

    Parameters
    ----------
    shipped : Path
        The vehicle's file, which is never written.
    folder : Path
        Folder of this process alone, which others may read.
    """

    def __init__(self, shipped: Path, folder: Path) -> None:
        self.shipped, self.folder = shipped, folder
        self.history = History(folder)
        self._file, self._watched = folder / FILE, folder / WATCHED

    def shipped_text(self) -> str:
        """Text of the vehicle's file; raises `UserError`."""
        try:
            return read_text(self.shipped, TOML_BYTES)
        except (OSError, UnicodeDecodeError, SizeExceeded) as error:
            raise UserError(f"cannot read {self.shipped}: {error}") from error

    def changed_text(self) -> str | None:
        """Text over the vehicle's file, whether or not it holds; None: there is none."""
        try:
            return read_text(self._file, TOML_BYTES)
        except (OSError, UnicodeDecodeError, SizeExceeded):
            return None

    def text(self) -> tuple[str, bool]:
        """Text that holds, and whether it is another one than that of the vehicle's file; raises `UserError`."""
        shipped, changed = self.shipped_text(), self.changed_text()
        if changed is None or basis_of(changed) != digest_of(shipped):
            return shipped, False
        return without_basis(changed), True

    def set_aside(self) -> bool:
        """Keep a text whose file was edited by hand since then among the earlier ones; whether there was one."""
        changed = self.changed_text()
        if changed is None or basis_of(changed) == digest_of(self.shipped_text()):
            return False
        self.history.keep(without_basis(changed))
        self._file.unlink()
        return True

    def change(self, text: str | None, former: str) -> None:
        """Let a text hold, or for None the vehicle's file, and keep the former one; raises `OSError`."""
        self.folder.mkdir(mode=0o750, parents=True, exist_ok=True)
        self.history.keep(former)
        if text is None:
            self._file.unlink(missing_ok=True)
        else:
            write(self._file, over(text, self.shipped_text()), MODE)
        self._settle()

    def watched(self) -> Watched | None:
        """The change that was watched when this process ended; one that cannot be read is none."""
        try:
            return Watched.model_validate_json(read_bytes(self._watched, WATCHED_BYTES))
        except (OSError, SizeExceeded, ValidationError):
            return None

    def watch(self, watched: Watched | None) -> None:
        """Keep the change that is watched; None: it is decided. Raises `OSError`."""
        if watched is None:
            self._watched.unlink(missing_ok=True)
        else:
            self.folder.mkdir(mode=0o750, parents=True, exist_ok=True)
            write(self._watched, watched.model_dump_json(), 0o600)
        self._settle()

    def _settle(self) -> None:
        """Write the names of the folder to the disk."""
        with contextlib.suppress(FileNotFoundError):
            descriptor = os.open(self.folder, os.O_RDONLY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
