"""Diagnostics over the web: what `obu support` collects, by a child process, as one file."""

import logging
import os
import subprocess
import sys
import tempfile
import threading
from datetime import UTC, datetime
from pathlib import Path

from fastapi import FastAPI, HTTPException
from fastapi.responses import FileResponse
from starlette.types import Receive, Scope, Send

from shared.errors import UserError
from shared.page.answers import Responses, refusals
from shared.runtime.config import LOGIN_VARIABLE

from .access.rights import Right
from .access.tokens import Tokens

log = logging.getLogger(__name__)

WITHIN_S = 120.0  # a Raspberry Pi with an hour's recording takes some 20 s
RECORDED_MIN = "5"


class _OfFolder(FileResponse):
    """A file whose folder is deleted behind it, however the answer ends: sent, refused, cut off, or its head alone."""

    def __init__(self, folder: tempfile.TemporaryDirectory[str], path: Path, name: str) -> None:
        super().__init__(path, media_type="application/zip", filename=name)
        self._kept = folder

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._kept.cleanup()


class SupportApi:
    """Collects diagnostics, one at a time; nothing is sent but to the browser that asks."""

    def __init__(self, folder: Path, tokens: Tokens) -> None:
        self._folder, self._tokens, self._busy = folder, tokens, threading.Lock()

    def add_to(self, app: FastAPI) -> None:
        """Add the route."""
        binary = {"schema": {"type": "string", "format": "binary"}}
        refused = refusals({409: "Another one is being collected", 500: "It could not be collected"})
        responses: Responses = {200: {"description": "A zip file", "content": {"application/zip": binary}}, **refused}
        app.add_api_route(
            "/api/support", self.collect, tags=["recordings"], responses=responses, response_class=FileResponse,
        )  # fmt: skip

    def collect(self) -> FileResponse:
        """Collect checks, settings without secrets, health, logs and the last minutes, as `obu support` does."""
        if not self._busy.acquire(blocking=False):
            raise HTTPException(409, "diagnostics are being collected; wait until they are there")
        try:
            self._folder.mkdir(exist_ok=True)
            kept = tempfile.TemporaryDirectory(prefix="support-", dir=self._folder)
            try:
                path = self._collected(Path(kept.name))
            except BaseException:
                kept.cleanup()
                raise
        except OSError as error:
            raise HTTPException(500, f"cannot write to {self._folder}: {error.strerror}; make room") from error
        finally:
            self._busy.release()
        name = f"obu-support-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.zip"
        return _OfFolder(kept, path, name)

    def _collected(self, folder: Path) -> Path:
        """Let the command collect into a folder, with a login of its own as long as it runs."""
        path = folder / "support.zip"
        # What the page tells needs a login, also of a program on this machine.
        login = self._tokens.add_temporary("support", Right.VIEW, seconds=WITHIN_S)
        command = ["nice", sys.executable, "-m", "cli", "support", "-o", str(path), "--minutes", RECORDED_MIN]
        try:
            done = subprocess.run(
                command, env={**os.environ, LOGIN_VARIABLE: login, "TMPDIR": str(folder)}, stdin=subprocess.DEVNULL,
                capture_output=True, text=True, timeout=WITHIN_S, check=False,
            )  # fmt: skip
        except (OSError, subprocess.TimeoutExpired) as error:
            raise HTTPException(500, f"{error}; run `obu support` on the unit") from error
        finally:
            self._end_login(login)
        if done.returncode:
            raise HTTPException(500, done.stderr.strip()[-300:] or "it ended without a word; run `obu support` there")
        return path

    def _end_login(self, login: str) -> None:
        try:
            if token := self._tokens.find(login):
                self._tokens.revoke(token.name)
        except UserError as error:
            log.warning("a login for diagnostics ends by itself: %s", error)
