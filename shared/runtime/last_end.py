"""Notes why this process ended, for its next run to tell: a program that hangs or fails cannot say it itself."""

import contextlib
import faulthandler
import logging
import re
from pathlib import Path
from typing import IO

FOLDER = "ends"  # in the state folder; a file of each process that runs, removed when it ends as it should
MAX_LENGTH = 100_000  # characters that are read
PLACE = re.compile(r'File "[^"]*?([^/"]+)", line (\d+) in (\S+)')

log = logging.getLogger(__name__)


class LastEnd:
    """The file that receives the traceback of a hung program, or the reason of a failure."""

    def __init__(self, state_dir: Path, process: str) -> None:
        self._path = state_dir / FOLDER / f"{process}.txt"
        self._file: IO[str] | None = None
        self.reason: str | None = None  # why the run before ended, if it was a failure

    def begin(self) -> None:
        """Read what the run before has left, and make room for this one; a full disk leaves nothing to tell."""
        with contextlib.suppress(OSError):
            with contextlib.suppress(FileNotFoundError), self._path.open(encoding="utf-8", errors="replace") as left:
                text = left.read(MAX_LENGTH)
                self.reason = _reason(text)
                if self.reason:
                    log.error("%s:\n%s", self.reason, text.strip())
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._path.open("w", encoding="utf-8")

    def watch(self, limit_s: float) -> None:
        """End the program with a traceback unless this is called again within a time [s]."""
        if self._file is None:
            faulthandler.dump_traceback_later(limit_s, exit=True)
        else:
            faulthandler.dump_traceback_later(limit_s, exit=True, file=self._file)

    def failed(self, error: BaseException) -> None:
        """Note the exception that ends the process."""
        faulthandler.cancel_dump_traceback_later()
        if self._file is not None:
            with contextlib.suppress(OSError), self._file as file:
                file.write(f"{type(error).__name__}: {error}\n")
            self._file = None

    def close(self) -> None:
        """Note that the process ends as it should."""
        faulthandler.cancel_dump_traceback_later()
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()
                self._path.unlink()
            self._file = None


def _reason(text: str) -> str | None:
    """One sentence; None of a run that was killed, or whose computer was switched off."""
    first = text.strip().partition("\n")[0]
    if not first:
        return None
    if not first.startswith("Timeout"):
        return f"the run before ended by {first[:300]}"
    place = PLACE.search(text)
    where = f", in {place[3]} ({place[1]}, line {place[2]})" if place else ""
    return f"the run before was ended by its watchdog: it hung{where}"
