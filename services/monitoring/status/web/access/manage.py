"""Routes of the tokens: list, add, revoke."""

from collections.abc import Iterable
from typing import Annotated, Literal

from fastapi import FastAPI, HTTPException, Request
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from starlette.concurrency import run_in_threadpool
from typing_extensions import TypedDict

from shared.errors import UserError
from shared.page import body
from shared.page.answers import answer, reference_to, refusals

from .rights import Right
from .tokens import Tokens

DAY_S = 86_400.0


@answer()
class TokenRow(TypedDict):
    """One token, without its text."""

    name: str
    role: Right
    created_s: float
    """since 1970"""
    expires_s: float | None
    """since 1970; null: never"""
    single_use: bool
    """of a link, which logs in once"""


@answer()
class SessionRow(TypedDict):
    """One open login."""

    token: str
    """name of the token, which may have been used up"""
    role: Right
    created_s: float
    expires_s: float


@answer()
class TokenList(TypedDict):
    """Who may log in, and who has."""

    tokens: list[TokenRow]
    sessions: list[SessionRow]


@answer()
class IssuedToken(TypedDict):
    """A new token; null after a revocation."""

    token: str | None


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
        refused = refusals({403: "Not the role, or a page from elsewhere", 409: "It cannot be done", 413: "Too long",
                            422: "Not a command"})  # fmt: skip
        app.add_api_route("/api/tokens", self.list, tags=["login"], response_description="Tokens and open logins")
        app.add_api_route(
            "/api/tokens", self.change, methods=["POST"], tags=["login"], response_description="Done",
            responses=refused, openapi_extra={"requestBody": BODY},
        )  # fmt: skip

    def list(self) -> TokenList:
        """Names and roles of all tokens, and the logins that are open."""
        content = self._tokens.content()
        tokens: Iterable[TokenRow] = (
            {
                "name": token.name, "role": token.role, "created_s": token.created_s, "expires_s": token.expires_s,
                "single_use": token.single_use,
            } for token in content.tokens
        )  # fmt: skip
        sessions: Iterable[SessionRow] = (
            {
                "token": session.token,
                "role": session.role,
                "created_s": session.created_s,
                "expires_s": session.expires_s,
            }
            for session in content.sessions
        )
        return {"tokens": [*tokens], "sessions": [*sessions]}

    async def change(self, request: Request) -> IssuedToken:
        """Add a token, which is in the answer only, or revoke one and end its logins."""
        try:
            command = COMMANDS.validate_json(await body.read(request))
        except ValidationError as error:
            raise body.invalid(error) from error
        try:
            return {"token": await run_in_threadpool(self._carry_out, command)}
        except UserError as error:
            raise HTTPException(409, str(error)) from error

    def _carry_out(self, command: AddToken | RevokeToken) -> str | None:
        if isinstance(command, RevokeToken):
            self._tokens.revoke(command.name)
            return None
        seconds = None if command.days is None else command.days * DAY_S
        return self._tokens.add(command.name, Right(command.role), seconds=seconds)
