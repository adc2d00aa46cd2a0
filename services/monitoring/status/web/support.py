"""Diagnostics over the web: what `obu support` collects, by a child process, as one file."""

import logging
from datetime import UTC, datetime
from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse

from shared.errors import UserError
from shared.page.answers import Responses, refusals
from shared.runtime.config import LOGIN_VARIABLE

from .access.rights import Right
from .access.tokens import Tokens
from .made_file import MadeFiles, Making

log = logging.getLogger(__name__)

WITHIN_S = 120.0  # a Raspberry Pi with an hour's recording takes some 20 s
RECORDED_MIN = "5"


class SupportApi:
    """Collects diagnostics, one at a time; nothing is sent but to the browser that asks."""

    def __init__(self, files: MadeFiles, tokens: Tokens) -> None:
        self._files, self._tokens = files, tokens

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
        logins: list[str] = []

        def how(path: Path) -> Making:
            # What the page tells needs a login, also of a program on this machine.
            logins.append(self._tokens.add_temporary("support", Right.VIEW, seconds=WITHIN_S))
            arguments = ("support", "-o", str(path), "--minutes", RECORDED_MIN)
            return Making(arguments, "application/zip", WITHIN_S, "obu support", {LOGIN_VARIABLE: logins[0]})

        name = f"obu-support-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.zip"
        try:
            return self._files.make(how, name, "diagnostics are being collected; wait until they are there")
        finally:
            for login in logins:
                self._end_login(login)

    def _end_login(self, login: str) -> None:
        try:
            if token := self._tokens.find(login):
                self._tokens.revoke(token.name)
        except UserError as error:
            log.warning("a login for diagnostics ends by itself: %s", error)
