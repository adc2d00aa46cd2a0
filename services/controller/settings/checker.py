"""The program that checks a change, beside this process: it needs the models of all processes, and some seconds."""

import subprocess
import sys
import tempfile
import time
from typing import IO

from pydantic import ValidationError

from shared.runtime.warm.client import end_with_this
from shared.settings.question import Answer, Question

TIMEOUT_S = 90.0
COMMAND = (sys.executable, "-m", "shared.settings.check")
ERROR_BYTES, ANSWER_BYTES = 2000, 4 << 20


class CheckFailedError(Exception):
    """The program gave no answer; the text says why."""


class Checker:
    """One question at a time."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._files: tuple[IO[bytes], ...] = ()
        self._begun_s = 0.0

    @property
    def is_busy(self) -> bool:
        """Whether a question is open."""
        return self._process is not None

    def ask(self, question: Question) -> None:
        """Ask; raises `OSError` if the program cannot be started."""
        asked, answered, errors = (tempfile.TemporaryFile() for _ in range(3))  # noqa: SIM115  # open until the answer
        asked.write(question.model_dump_json().encode())
        asked.seek(0)
        self._files, self._begun_s = (asked, answered, errors), time.monotonic()
        self._process = subprocess.Popen([*end_with_this(), *COMMAND], stdin=asked, stdout=answered, stderr=errors)

    def answer(self) -> Answer | None:
        """The answer, once; None as long as there is none. Raises `CheckFailedError`."""
        if self._process is None:
            return None
        code = self._process.poll()
        if code is None:
            if time.monotonic() - self._begun_s < TIMEOUT_S:
                return None
            self.close()
            raise CheckFailedError(f"none within {TIMEOUT_S:.0f} s")
        _, answered, errors = self._files
        try:
            if code != 0:
                errors.seek(0)
                last = errors.read(ERROR_BYTES).decode("utf-8", "replace").strip().rpartition("\n")[2]
                raise CheckFailedError(last or f"it ended with {code}")
            answered.seek(0)
            return Answer.model_validate_json(answered.read(ANSWER_BYTES))
        except ValidationError as error:
            raise CheckFailedError(str(error)) from error
        finally:
            self.close()

    def close(self) -> None:
        """End the program if it runs."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        for file in self._files:
            file.close()
        self._process, self._files = None, ()
