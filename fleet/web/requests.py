"""Bodies of changes: bounded, checked, and with the first fault named."""

from typing import TypeVar

from fastapi import HTTPException, Request
from pydantic import BaseModel, ConfigDict, ValidationError

from shared.page import body

B = TypeVar("B", bound="Body")


class Body(BaseModel):
    """A body that has no other fields than those it names."""

    model_config = ConfigDict(extra="forbid")


async def read(request: Request, kind: type[B]) -> B:
    """Read the body of a request; raises `HTTPException` 422 for another one."""
    try:
        return kind.model_validate_json(await body.read(request))
    except ValidationError as error:
        raise body.invalid(error) from error


def conflict(text: str) -> HTTPException:
    """The answer to a change that what is there does not allow."""
    return HTTPException(409, text)
