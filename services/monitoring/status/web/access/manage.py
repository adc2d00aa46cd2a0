"""Routes of the tokens: list, add, revoke."""

from typing import Annotated, Any, Literal

from fastapi import FastAPI, HTTPException, Request, Response
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from starlette.concurrency import run_in_threadpool

from shared.errors import UserError
from shared.page import body
from shared.page.answers import Refusal, described, reference_to
from shared.page.body import json_response

from ..answers import MadeToken, TokenList
from .rights import Right
from .tokens import Tokens

DAY_S = 86_400.0


class AddToken(BaseModel):
    """A token to be made."""

    model_config = ConfigDict(extra="forbid")
    action: Literal["add"]
    name: str = Field(max_length=40)
    role: Literal["view", "operate", "admin"]
    days: float | None = Field(default=None, gt=0.0, le=3650.0)


class RevokeToken(BaseModel):
    """A token whose logins end with it."""

    model_config = ConfigDict(extra="forbid")
    action: Literal["revoke"]
    name: str = Field(max_length=40)


COMMANDS: TypeAdapter[AddToken | RevokeToken] = TypeAdapter(
    Annotated[AddToken | RevokeToken, Field(discriminator="action")]
)
SCHEMA = {"oneOf": [reference_to(AddToken), reference_to(RevokeToken)]}
BODY = {"content": {"application/json": {"schema": SCHEMA}}, "required": True}


class TokensApi:
    """Lists and changes tokens, as `obu token` does."""

    def __init__(self, tokens: Tokens) -> None:
        self._tokens = tokens

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        wrong = {403: "Not the role, or a page from elsewhere", 409: "It cannot be done", 413: "Too long",
                 422: "Not a command"}  # fmt: skip
        refused: dict[int | str, dict[str, Any]] = {status: described(Refusal, text) for status, text in wrong.items()}
        app.add_api_route(
            "/api/tokens", self.list, response_class=Response, tags=["login"],
            responses={200: described(TokenList, "Tokens and open logins")},
        )  # fmt: skip
        app.add_api_route(
            "/api/tokens", self.change, methods=["POST"], response_class=Response, tags=["login"],
            responses={200: described(MadeToken, "Done"), **refused}, openapi_extra={"requestBody": BODY},
        )  # fmt: skip

    def list(self) -> Response:
        """Names and roles of all tokens, and the logins that are open."""
        content = self._tokens.content()
        return json_response({
            "tokens": [token.model_dump(exclude={"hash"}) for token in content.tokens],
            "sessions": [session.model_dump(exclude={"hash"}) for session in content.sessions],
        })  # fmt: skip

    async def change(self, request: Request) -> Response:
        """Add a token, which is in the answer only, or revoke one and end its logins."""
        try:
            command = COMMANDS.validate_json(await body.read(request))
        except ValidationError as error:
            raise body.invalid(error) from error
        try:
            return json_response({"token": await run_in_threadpool(self._carry_out, command)})
        except UserError as error:
            raise HTTPException(409, str(error)) from error

    def _carry_out(self, command: AddToken | RevokeToken) -> str | None:
        if isinstance(command, RevokeToken):
            self._tokens.revoke(command.name)
            return None
        seconds = None if command.days is None else command.days * DAY_S
        return self._tokens.add(command.name, Right(command.role), seconds=seconds)
