"""Commands of the operator over the web."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from queue import Full, Queue
from typing import TypeVar
from uuid import uuid4

from fastapi import FastAPI, HTTPException, Request
from pydantic import ValidationError
from pydantic_core import from_json, to_json
from typing_extensions import TypedDict

from shared.messages.base import Message
from shared.messages.operation import ModeCommand, OperatorCommand
from shared.page import body
from shared.page.answers import answer, reference_to, refusals

from ..state import State
from .access.guard import insist_on
from .access.rights import Right

M = TypeVar("M", bound=Message)

MAX_PENDING = 8  # commands that are not yet published
BODY = {"content": {"application/json": {"schema": reference_to(ModeCommand)}}, "required": True}


@answer({"request_id": "5f0c9a7be2d1"})
class CommandAccepted(TypedDict):
    """A command was published; the answer on the bus has this ID."""

    request_id: str


class CommandApi:
    """Checks commands and queues them for the bus; the answers of `controller.mode` are `mode/answer`."""

    def __init__(self, state: State, lock: AbstractContextManager[object], now_ns: Callable[[], int]) -> None:
        self._state, self._lock, self._now_ns = state, lock, now_ns
        self.commands: Queue[ModeCommand] = Queue(MAX_PENDING)

    def add_to(self, app: FastAPI) -> None:
        """Add the route."""
        refused = refusals({403: "Not the role, or a page from elsewhere", 413: "Too long", 422: "Not a command",
                            503: "Commands are waiting"})  # fmt: skip
        app.add_api_route(
            "/api/command", self.command, methods=["POST"], status_code=202, response_description="Published",
            tags=["command"], responses=refused, openapi_extra={"requestBody": BODY},
        )  # fmt: skip

    async def command(self, request: Request) -> CommandAccepted:
        """Publish a command; 202 with the request ID that `mode/answer` will carry."""
        command = _command(await body.read(request))
        insist_on(request, right_of(command.command))
        put(self.commands, command)
        return {"request_id": command.request_id}


def right_of(command: OperatorCommand) -> Right:
    """The right that a command needs: who confirms a position takes the responsibility for it."""
    return Right.ADMIN if command is OperatorCommand.CONFIRM_POSITION else Right.OPERATE


def _command(data: bytes) -> ModeCommand:
    example = '{"command": "cold_start", "source": "gnss0"}'
    return read_command(data, ModeCommand, example, lambda given: {"request_id": new_id(), **given})


def new_id() -> str:
    """ID of a request, by which its answer on the bus is known."""
    return uuid4().hex[:12]


def read_command(
    data: bytes, kind: type[M], example: str, complete: Callable[[dict[str, object]], dict[str, object]]
) -> M:
    """Read a command, whose fields `complete` adds to; raises 422 with what is wrong with it."""
    try:
        given = from_json(data, allow_inf_nan=False)
        if not isinstance(given, dict):
            raise ValueError(f"a command is an object such as {example}")
        return kind.model_validate_json(to_json(complete(given)))
    except ValidationError as error:
        raise body.invalid(error) from error
    except ValueError as error:
        raise HTTPException(422, str(error)) from error


def put(commands: "Queue[M]", command: M) -> None:
    """Queue a command for the bus; raises 503 while those before it are not taken."""
    try:
        commands.put_nowait(command)
    except Full as error:
        raise HTTPException(503, "the bus does not take the commands before this one; try again") from error
