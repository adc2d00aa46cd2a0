"""The draft of a mapping for a file of another program, by the beginning of that file."""

import re
import tempfile
import threading
from pathlib import Path
from typing import Annotated

from fastapi import FastAPI, HTTPException, Query, Request
from fastapi.concurrency import run_in_threadpool
from typing_extensions import TypedDict

from shared.bounded import TOML_BYTES, read_text
from shared.page import body
from shared.page.answers import answer, refusals

from .made_file import run_command

MOST_BYTES = 1 << 20  # of the file's beginning: some minutes of most logs
WITHIN_S, TEXT = 60.0, 20_000
BODY = {"content": {"text/csv": {"schema": {"type": "string"}}}, "required": True}


@answer()
class MappingDraft(TypedDict):
    """A mapping for `obu import`, and what is said of it."""

    name: str
    """of the mapping's file"""
    toml: str
    text: str
    """the first minute by this mapping, what was guessed and why, and what no value tells"""


class DraftApi:
    """Makes drafts, one at a time; nothing of the file is kept."""

    def __init__(self) -> None:
        self._busy = threading.Lock()

    def add_to(self, app: FastAPI) -> None:
        """Add the route."""
        refused = refusals(
            {
                403: "A page from elsewhere",
                409: "Another one is being made",
                413: "Too long",
                422: "No table with a position",
            }
        )
        app.add_api_route(
            "/api/draft", self.draft, methods=["POST"], tags=["recordings"], responses=refused,
            openapi_extra={"requestBody": BODY}, response_description="The draft",
        )  # fmt: skip

    async def draft(
        self, request: Request, name: Annotated[str, Query(max_length=200, description="of the file")]
    ) -> MappingDraft:
        """Draft the mapping of a table by its first lines, as `obu import FILE --draft` does."""
        beginning = await body.read(request, MOST_BYTES, WITHIN_S)
        return await run_in_threadpool(self.drafted, name, beginning)

    def drafted(self, name: str, beginning: bytes) -> MappingDraft:
        """Make a draft; raises `HTTPException` with 409 while another one is made: each is a process of its own."""
        if not self._busy.acquire(blocking=False):
            raise HTTPException(409, "another draft is being made; wait until it is there")
        try:
            return _drafted(name, beginning)
        finally:
            self._busy.release()


def _drafted(name: str, beginning: bytes) -> MappingDraft:
    """Let the command do it, in a folder that is removed: its table is a stranger's."""
    plain = re.sub(r"[^A-Za-z0-9._-]+", "-", Path(name.replace("\\", "/")).name).lstrip(".-")[:80]
    plain = plain if plain and not plain.endswith(".toml") else "table.csv"
    with tempfile.TemporaryDirectory(prefix="obu-draft-") as folder:
        table = Path(folder) / plain
        table.write_bytes(beginning)
        done = run_command(("import", str(table), "--draft"), WITHIN_S, f"use `obu import {plain} --draft`")
        if done.returncode:
            raise HTTPException(422, done.stderr.replace(f"{folder}/", "").removeprefix("obu: ").strip()[-600:])
        toml = read_text(table.with_suffix(".toml"), TOML_BYTES).replace(folder, "FOLDER")
        said = "\n".join(line for line in done.stdout.splitlines() if folder not in line)
        return {"name": table.with_suffix(".toml").name, "toml": toml, "text": said[:TEXT]}
