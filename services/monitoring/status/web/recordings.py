"""Recordings over the web: the list, a download, and what the configuration allows besides."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated

from fastapi import FastAPI, HTTPException, Request, Response
from fastapi import Path as PathParameter
from fastapi.responses import FileResponse
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from shared.library.library import Library
from shared.page import body
from shared.page.answers import AcceptedRequest, Responses, reference_to, refusals
from shared.runtime.reports import VARIABLE, read_report

from ..views import recordings as views
from ..views.models.recordings import JobShown, Recordings
from .access.guard import insist_on, may
from .access.rights import Right
from .access.tokens import FOLDER_VARIABLE

REPORT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox"
LOG, REPORT = "job.log", "job.report.json"  # output for people, and what the job tells


class Action(StrEnum):
    """What can be done with a recording over the web."""

    DOWNLOAD = "download"
    KEEP = "keep"
    RELEASE = "release"  # the recorder may delete it again
    DELETE = "delete"
    REPLAY = "replay"
    SOLVE = "solve"
    STOP = "stop"  # the job that runs


class Command(BaseModel):
    """An action on a recording."""

    model_config = ConfigDict(extra="forbid")
    action: Action
    name: Annotated[str, Field(max_length=200)] = ""


class Job:
    """One child process at a time: a replay or a solution."""

    def __init__(self, folder: Path, tokens: Path | None = None) -> None:
        self._folder, self._tokens = folder, tokens or folder.parent  # a replay takes the tokens of this unit
        self._child: subprocess.Popen[bytes] | None = None
        self.action: Action | None = None
        self.name = ""

    @property
    def running(self) -> bool:
        """Whether the job has not ended."""
        return self._child is not None and self._child.poll() is None

    def start(self, action: Action, name: str, recording: Path) -> None:
        """Start a job; the caller has made sure that none runs."""
        self._folder.mkdir(exist_ok=True)
        more = ["--port", "0"] if action is Action.REPLAY else ["--out", str(self.report(name).parent)]
        command = [sys.executable, "-m", "cli", action.value, str(recording), *more]
        environment = {k: v for k, v in os.environ.items() if k not in ("OBU_VEHICLE", "OBU_BROKER")}
        self.action, self.name = action, name
        (self._folder / REPORT).unlink(missing_ok=True)
        with (self._folder / LOG).open("wb") as output:
            self._child = subprocess.Popen(
                ["nice", *command], stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
                env={**environment, "OBU_STATE": str(self._folder), FOLDER_VARIABLE: str(self._tokens),
                     VARIABLE: str(self._folder / REPORT)},
            )  # fmt: skip

    def cancel(self) -> None:
        """Ask the job to end, as Ctrl-C would."""
        if self._child is not None and self.running:
            self._child.terminate()

    def stop(self) -> None:
        """End the job, and wait for its end."""
        self.cancel()
        if self._child is not None and self.running:
            try:
                self._child.wait(6.0)
            except subprocess.TimeoutExpired:
                self._child.kill()
                self._child.wait()

    def report(self, name: str) -> Path:
        """Give the path of a recording's report."""
        return self._folder / f"{Path(name).stem}-solution" / "report.html"

    def view(self) -> JobShown | None:
        """Show the job: what it has found or why it failed, and the port of a replay."""
        if self._child is None:
            return None
        report = read_report(self._folder / REPORT)
        failed = not self.running and self._child.returncode not in (0, -signal.SIGTERM, 128 + signal.SIGTERM)
        unsaid = f"it ended with code {self._child.returncode}; its output is {self._folder / LOG}" if failed else ""
        return {
            "action": self.action,
            "name": self.name,
            "running": self.running,
            "failed": failed,
            "port": report.port if self.running else None,
            "text": (report.error or report.finding or unsaid)[:300],
        }


class RecordingsApi:
    """Answers questions about recordings, and carries out what the configuration allows."""

    def __init__(
        self, library: Library, job: Job, allowed: frozenset[Action], open_name: Callable[[], str | None]
    ) -> None:
        self._library, self._job, self._allowed, self._open_name = library, job, allowed, open_name

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        missing = refusals({403: "Not allowed, or a page from elsewhere", 404: "No such recording"})
        more = refusals({409: "It is being written, is kept, or a job runs", 413: "Too long", 422: "Not a command",
                         503: "No room"})  # fmt: skip
        text = {"schema": {"type": "string"}}
        binary = {"schema": {"type": "string", "format": "binary"}}
        file: Responses = {200: {"description": "The file", "content": {"application/octet-stream": binary}}, **missing}
        html: Responses = {200: {"description": "The report", "content": {"text/html": text}}, **missing}
        schema = {"requestBody": {"content": {"application/json": {"schema": reference_to(Command)}}, "required": True}}
        listed = "Recordings, newest first"
        app.add_api_route("/api/recordings", self.list, tags=["recordings"], response_description=listed)
        for path, send, responses in (
            ("/api/recordings/{name}", self.download, file),
            ("/api/recordings/{name}/report", self.report, html),
        ):
            app.add_api_route(path, send, response_class=Response, tags=["recordings"], responses=responses)
        app.add_api_route(
            "/api/recordings", self.command, methods=["POST"], status_code=202, response_description="Carried out",
            tags=["recordings"], responses={**missing, **more}, openapi_extra=schema,
        )  # fmt: skip

    def list(self, request: Request) -> Recordings:
        """Every recording, newest first, with its summary as soon as it is computed, and the job that runs."""
        return {
            "recordings": views.recordings(
                self._library.entries.values(), self._open_name(), lambda name: self._job.report(name).is_file()
            ),
            "free_bytes": self._library.free_bytes,
            "allowed": sorted(action for action in self._allowed if may(request, _right(action))),
            "job": self._job.view(),
        }

    def download(self, name: Annotated[str, PathParameter(max_length=200)]) -> Response:
        """The MCAP file."""
        self._insist(Action.DOWNLOAD, name)
        path = self._library.folder / name
        return FileResponse(path, media_type="application/octet-stream", filename=name)

    def report(self, name: Annotated[str, PathParameter(max_length=200)]) -> Response:
        """The report of the last solution of a recording."""
        path = self._job.report(name)
        if name not in self._library.entries or not path.is_file():
            raise HTTPException(404, "there is no report; solve the recording first")
        return FileResponse(path, media_type="text/html", headers={"Content-Security-Policy": REPORT_POLICY})

    async def command(self, request: Request) -> AcceptedRequest:
        """Keep, release, delete, replay or solve a recording, or stop the job."""
        try:
            command = Command.model_validate_json(await body.read(request))
        except ValidationError as error:
            raise body.invalid(error) from error
        insist_on(request, _right(command.action))
        self._carry_out(command)
        return {}

    def _carry_out(self, command: Command) -> None:
        action, name = command.action, command.name
        if action is Action.STOP:
            self._job.cancel()
            return
        self._insist(Action.KEEP if action is Action.RELEASE else action, name)
        entry = self._library.entries[name]
        match action:
            case Action.KEEP | Action.RELEASE:
                self._library.keep(name, keep=action is Action.KEEP)
            case Action.DELETE if name == self._open_name():
                raise HTTPException(409, "this recording is being written")
            case Action.DELETE if entry.kept:
                raise HTTPException(409, "this recording is kept; release it first")
            case Action.DELETE:
                self._library.delete(name)
            case Action.REPLAY | Action.SOLVE:
                if self._job.running:
                    raise HTTPException(409, "another job runs; stop it first")
                self._start(action, name)
            case _:
                raise HTTPException(422, f"{action} is no command")

    def _start(self, action: Action, name: str) -> None:
        try:
            self._job.start(action, name, (self._library.folder / name).resolve())
        except OSError as error:
            raise HTTPException(
                503, f"it cannot start: {error.strerror}; make room, for example by deleting a recording"
            ) from error

    def _insist(self, action: Action, name: str) -> None:
        """Refuse what the configuration does not allow, and names that are not in the list."""
        if action not in self._allowed:
            raise HTTPException(403, f"{action} is not allowed; add it to `recordings` in [monitoring.status]")
        if name not in self._library.entries:
            raise HTTPException(404, "there is no such recording")


def _right(action: Action) -> Right:
    return Right.ADMIN if action is Action.DELETE else Right.OPERATE
