"""The set-up over the web: its steps, what somebody has confirmed, and the job that surveys the newest drive."""

import io
import json
import logging
import os
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from enum import StrEnum
from pathlib import Path
from threading import Lock
from typing import Annotated, cast
from urllib.parse import urlsplit

from fastapi import FastAPI, HTTPException, Query, Request, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from shared.bounded import load_json, read_bytes
from shared.bus.bus import Envelope
from shared.errors import BadPayload
from shared.evidence import keys_folder
from shared.library.library import Library
from shared.messages.imu import ImuSamples
from shared.page import body
from shared.page.answers import AcceptedRequest, Object, Responses, reference_to, refusals

from ..state import State
from ..views import set_up as views
from ..views.models.set_up import SetUpReport, SurveyShown
from ..views.sets import sets
from .looking import look_at
from .made_file import MadeFiles, Making

log = logging.getLogger(__name__)

KEPT_FILE, RESULT_FILE, LOG_FILE = "set_up.json", "survey.json", "survey.log"
FILE_BYTES, MOST_ADDRESS = 100_000, 200
JOB_S = 900.0  # after which a survey is ended
BATCHES = 2000  # of samples of which the noise is told: 20 s of a sensor that sends each by itself
FORGOTTEN_NS = 10_000_000_000
IMU = "imu/sample"
OF_SETS = frozenset(
    ".".join(name.split(".")[:length])
    for one in sets() for part in ("settings", "runs") for name in cast("dict[str, object]", one[part])
    for length in range(2, name.count(".") + 2)
)  # fmt: skip


class Action(StrEnum):
    """What can be asked of the set-up."""

    CONFIRM = "confirm"  # a step that cannot be measured
    MEASURE = "measure"  # survey the newest drive
    COMPARE = "compare"  # and solve it with the settings as they are and as proposed


class Form(StrEnum):
    """Of a certificate."""

    JSON = "json"
    PDF = "pdf"


MEDIA_TYPES = {Form.JSON: "application/json", Form.PDF: "application/pdf"}


class SetUpCommand(BaseModel):
    """An action on the set-up."""

    model_config = ConfigDict(extra="forbid")
    action: Action
    step: Annotated[str, Field(max_length=20)] = ""


BODY = {"content": {"application/json": {"schema": reference_to(SetUpCommand)}}, "required": True}


class Survey:
    """One survey at a time, in a program of its own; the result of the newest one stays."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._child: subprocess.Popen[bytes] | None = None
        self._begun_s = 0.0
        self.comparing = self.failed = False

    @property
    def running(self) -> bool:
        """Whether one runs; takes up the result of one that has ended."""
        if self._child is None:
            return False
        code = self._child.poll()
        if code is None:
            if time.monotonic() - self._begun_s > JOB_S:
                self._child.kill()
            return True
        self._child = None
        self.failed = code != 0
        if code == 0:
            self._fresh.replace(self.folder / RESULT_FILE)
        return False

    def start(self, recording: Path, *, compare: bool) -> None:
        """Begin one; the caller has made sure that none runs."""
        self.folder.mkdir(exist_ok=True)
        command = ["nice", sys.executable, "-m", "cli", "set-up", str(recording), "--json"]
        environment = {k: v for k, v in os.environ.items() if k not in ("OBU_VEHICLE", "OBU_BROKER")}
        self.comparing, self._begun_s = compare, time.monotonic()
        with self._fresh.open("wb") as output, (self.folder / LOG_FILE).open("wb") as errors:
            self._child = subprocess.Popen(
                [*command, *(["--compare"] if compare else [])], stdin=subprocess.DEVNULL, stdout=output,
                stderr=errors, env={**environment, "OBU_STATE": str(self.folder)},
            )  # fmt: skip

    def stop(self) -> None:
        """End one that runs."""
        if self._child is not None and self._child.poll() is None:
            self._child.kill()
            self._child.wait()

    def result(self) -> Object | None:
        """The newest result; None without one."""
        return _read(self.folder / RESULT_FILE)

    @property
    def _fresh(self) -> Path:
        return self.folder / f"{RESULT_FILE}.new"


class SetUpApi:
    """Shows the steps of the set-up, keeps what was confirmed, and lets drives be surveyed."""

    def __init__(
        self, state: State, lock: AbstractContextManager[object], now_ns: Callable[[], int], folder: Path,
        library: Library, open_name: Callable[[], str | None], files: MadeFiles,
    ) -> None:  # fmt: skip
        self._state, self._lock, self._now_ns = state, lock, now_ns
        self._library, self._open_name = library, open_name
        self._state_dir, self._files = folder, files
        self._kept, self.survey = folder / KEPT_FILE, Survey(folder / "jobs")
        self._batches: deque[ImuSamples] = deque(maxlen=BATCHES)
        self._of_samples = Lock()

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        refused = refusals({403: "Not the role, or a page from elsewhere", 404: "There is no drive yet",
                            409: "A survey runs", 413: "Too long", 422: "Not a command", 503: "No room"})  # fmt: skip
        app.add_api_route("/api/set-up", self.report, tags=["settings"], response_description="Steps of the set-up")
        app.add_api_route(
            "/api/set-up", self.command, methods=["POST"], status_code=202, response_description="Carried out",
            tags=["settings"], responses=refused, openapi_extra={"requestBody": BODY},
        )  # fmt: skip

        self._add_certificate(app)

    def _add_certificate(self, app: FastAPI) -> None:
        refused = refusals({404: "There is no drive, or it is gone", 409: "Another file is being made",
                            500: "It could not be made"})  # fmt: skip
        binary = {"schema": {"type": "string", "format": "binary"}}
        content = dict.fromkeys(MEDIA_TYPES.values(), binary)
        responses: Responses = {200: {"description": "The certificate", "content": content}, **refused}
        app.add_api_route(
            "/api/set-up/certificate", self.certificate, tags=["settings"], responses=responses,
            response_class=FileResponse,
        )  # fmt: skip

        image = {"schema": {"type": "string"}}
        drawn: Responses = {200: {"description": "The code, as SVG", "content": {"image/svg+xml": image}},
                            **refusals({422: "No address of a centre, or no name that a centre takes"})}  # fmt: skip
        app.add_api_route("/api/set-up/qr.svg", self.code, tags=["settings"], responses=drawn, response_class=Response)

    def code(
        self, centre: Annotated[str, Query(max_length=MOST_ADDRESS, description="address of a centre's pages")]
    ) -> Response:
        """Draw the code that opens a centre's page Enrolment with the name of this unit; it holds no secret."""
        with self._lock:
            name = json.loads(views.values(self._state).get("vehicle.name", '""'))
        return Response(drawn_code(enrolment_page(centre, name)), media_type="image/svg+xml")

    def certificate(self, form: Form = Form.PDF) -> FileResponse:
        """Make the signed certificate of the drive that was surveyed last, as `obu set-up --certificate` does."""
        result = self.survey.result()
        name = str(result.get("recording")) if result else None
        if name is None or name not in self._library.entries:
            raise HTTPException(404, "the drive that was surveyed is not there any more: measure another one")
        recording = (self._library.folder / name).resolve()
        environment = {"OBU_STATE": str(self.survey.folder), "OBU_KEYS": str(keys_folder(self._state_dir).resolve())}
        by_hand = f"obu set-up {name} --certificate FILE.{form}"

        def how(path: Path) -> Making:
            arguments = ("set-up", str(recording), "--json", "--certificate", str(path))
            return Making(arguments, MEDIA_TYPES[form], JOB_S, by_hand, environment)

        saved = f"{Path(name).stem}-installation.{form}"
        return self._files.make(how, saved, "another file is being made; wait until it is there")

    def report(self, step: Annotated[str, Query(max_length=20)] = "") -> SetUpReport:
        """Every step with its state; `step=imu` lets the samples of the IMU come for 5 s."""
        if step == "imu":
            look_at(self._state, self._lock, self._now_ns, (IMU,))
            with self._lock:
                envelopes = list(self._state.samples)
                self._state.samples.clear()
            with self._of_samples:
                self._note_samples(envelopes)
                shown = views.level(self._batches)
        running = self.survey.running  # first: it takes up the result of a survey that has ended
        result, confirmed = self.survey.result(), self._confirmed()
        with self._lock:
            now_ns = self._now_ns()
            speed = views.speed_of(self._state, now_ns)
            values = views.values(self._state, OF_SETS)
            return {
                "now_ns": now_ns,
                "steps": views.steps(self._state, confirmed, result, now_ns),
                "speed_m_s": speed,
                "moving": speed is not None and speed > views.MOVING_M_S,
                "devices": views.devices(self._state, now_ns),
                "level": shown if step == "imu" else None,
                "signals": views.signals(self._state, now_ns),
                "corrections": views.corrections(self._state, now_ns),
                "receiver": views.receiver(self._state),
                "values": values,
                "sets": sets(values),
                "survey": self._survey_shown(result, values, running=running),
            }

    async def command(self, request: Request) -> AcceptedRequest:
        """Confirm a step, or survey the newest drive."""
        try:
            command = SetUpCommand.model_validate_json(await body.read(request))
        except ValidationError as error:
            raise body.invalid(error) from error
        if command.action is Action.CONFIRM:
            self._confirm(command.step)
        else:
            self._measure(compare=command.action is Action.COMPARE)
        return {}

    def _confirm(self, step: str) -> None:
        if step not in views.CONFIRMED:
            raise HTTPException(422, f"there is nothing to confirm in step {step!r}: {', '.join(views.CONFIRMED)}")
        kept = {**self._confirmed(), step: self._now_ns()}
        fresh = self._kept.with_name(f"{KEPT_FILE}.new")
        try:
            fresh.write_text(json.dumps(kept), encoding="utf-8")
            fresh.replace(self._kept)
        except OSError as error:
            raise HTTPException(503, f"it cannot be kept: {error.strerror}; make room on the disk") from error

    def _measure(self, *, compare: bool) -> None:
        if self.survey.running:
            raise HTTPException(409, "a survey runs; wait for its result")
        name = self._recording()
        if name is None:
            raise HTTPException(404, "there is no recording to survey; monitoring.recorder makes one of each drive")
        try:
            self.survey.start((self._library.folder / name).resolve(), compare=compare)
        except OSError as error:
            raise HTTPException(503, f"it cannot start: {error.strerror}; make room on the disk") from error

    def _recording(self) -> str | None:
        """The recording in progress, otherwise the newest one."""
        return self._open_name() or max(self._library.entries, default=None)

    def _survey_shown(self, result: Object | None, values: dict[str, str], *, running: bool) -> SurveyShown:
        return {
            "running": running, "comparing": running and self.survey.comparing, "failed": self.survey.failed,
            "result": result, "applied": applied(result, values), "recording": self._recording(),
        }  # fmt: skip

    def _note_samples(self, envelopes: list[Envelope]) -> None:
        for envelope in envelopes:
            with suppress(BadPayload):
                newest = envelope.decode()
                if not isinstance(newest, ImuSamples):
                    continue
                if self._batches and newest.sampled_ns[0] - self._batches[-1].sampled_ns[-1] > FORGOTTEN_NS:
                    self._batches.clear()  # nobody has looked for a while
                self._batches.append(newest)

    def _confirmed(self) -> dict[str, int]:
        kept = _read(self._kept) or {}
        return {step: ns for step, ns in kept.items() if step in views.CONFIRMED and isinstance(ns, int)}


def enrolment_page(centre: str, name: str) -> str:
    """Address of a centre's page Enrolment for a unit; raises `HTTPException`."""
    from shared.fleet.topics import RULE, VEHICLE  # by who has a centre alone

    try:
        place = urlsplit(centre)
        usable = place.scheme == "https" and place.hostname and place.port != 0 and "@" not in place.netloc
    except ValueError:
        usable = False
    if not usable or not place.netloc.isprintable() or place.path not in ("", "/") or place.query or place.fragment:
        raise HTTPException(422, "this is no address of a centre's pages, such as https://centre.example:8090")
    if not VEHICLE.fullmatch(name):
        raise HTTPException(422, f"a centre takes no unit of this name: {RULE}; change vehicle.name")
    return f"https://{place.netloc}/#/enrolment/{name}"


def drawn_code(text: str) -> bytes:
    """QR code of a text as SVG, dark on white whatever the colours of the page."""
    import segno  # by who asks for a code alone

    drawn = io.BytesIO()
    segno.make(text, error="m").save(drawn, kind="svg", scale=4, light="white")
    return drawn.getvalue()


def applied(result: Object | None, values: dict[str, str]) -> list[str]:
    """Quantities whose proposed settings hold."""
    rows = result.get("findings") if result else None
    found = []
    for row in rows if isinstance(rows, list) else ():
        changes = row.get("changes") if isinstance(row, dict) else None
        if isinstance(changes, dict) and changes and all(
            name in values and json.loads(values[name]) == value for name, value in changes.items()
        ):  # fmt: skip
            found.append(str(row["quantity"]))
    return found


def _read(path: Path) -> Object | None:
    """A small JSON object of a file of this unit; None without one, or where it cannot be read."""
    if not path.exists():
        return None
    try:
        found = load_json(read_bytes(path, FILE_BYTES), FILE_BYTES)
    except (OSError, ValueError) as error:
        log.warning("cannot read %s: %s", path, error)
        return None
    return found if isinstance(found, dict) else None
