"""Earlier texts of a vehicle's file, the newest ones kept: a folder with a file for each."""

import os
import re
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from ..bounded import TOML_BYTES, read_text
from ..errors import UserError

KEPT = 10
_NAME = re.compile(r"(\d{8}T\d{6}\.\d{6}Z)\.toml")
_STAMP = "%Y%m%dT%H%M%S.%fZ"


@dataclass(frozen=True)
class Version:
    """One earlier text, and when it was replaced."""

    path: Path
    replaced: datetime

    def text(self) -> str:
        """Read it; raises `UserError` where it cannot be read."""
        try:
            return read_text(self.path, TOML_BYTES)
        except (OSError, ValueError) as error:
            raise UserError(f"cannot read {self.path}: {error}; `obu config history` lists the others") from error


class History:
    """The earlier texts in a folder, of private files: settings may hold addresses with passwords."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def versions(self) -> list[Version]:
        """All of them, newest first."""
        if not self._folder.is_dir():
            return []
        found = ((path, _NAME.fullmatch(path.name)) for path in self._folder.iterdir())
        made = [Version(path, datetime.strptime(name[1], _STAMP).replace(tzinfo=UTC)) for path, name in found if name]
        return sorted(made, key=lambda version: version.replaced, reverse=True)

    def keep(self, text: str) -> None:
        """Keep a text that is about to be replaced, and drop the oldest beyond `KEPT`; raises `OSError`.

        One that is the newest already is not kept again, so that tries that fail drop none.
        """
        newest = next(iter(self.versions()), None)
        with suppress(UserError):
            if newest is not None and newest.text() == text:
                return
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        path = self._folder / f"{datetime.now(UTC).strftime(_STAMP)}.toml"
        write(path, text, 0o600)
        for version in self.versions()[KEPT:]:
            version.path.unlink(missing_ok=True)


def write(path: Path, text: str, mode: int) -> None:
    """Replace a file in one step, so that a power cut leaves the one text or the other; raises `OSError`."""
    draft = path.with_name(f".{path.name}.new")
    draft.unlink(missing_ok=True)
    draft.touch(mode=mode)
    if os.geteuid() == 0:  # root writes for whoever owns the file, or the folder of a new one
        owner = (path if path.exists() else path.parent).stat()
        os.chown(draft, owner.st_uid, owner.st_gid)
    with draft.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    draft.replace(path)
