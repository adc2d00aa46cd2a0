"""Bodies: of a command, which is short, and of an answer in JSON."""

import asyncio

from fastapi import HTTPException, Request, Response
from pydantic import ValidationError
from pydantic_core import to_json

BODY_BYTES = 2048
BODY_S = 5.0


async def read(request: Request, most: int = BODY_BYTES, within_s: float = BODY_S) -> bytes:
    """Read the body of a request, of a bounded length, within a bounded time."""
    data = b""
    try:
        async with asyncio.timeout(within_s):
            async for part in request.stream():
                data += part
                if len(data) > most:
                    raise HTTPException(413, f"it may have at most {most} bytes")
    except TimeoutError as error:
        raise HTTPException(408, f"it was not complete after {within_s:g} s; send it again") from error
    return data


def invalid(error: ValidationError) -> HTTPException:
    """The answer to a body that is no such command: its first fault, and where."""
    first = error.errors(include_url=False, include_input=False)[0]
    return HTTPException(422, f"{'.'.join(map(str, first['loc']))}: {first['msg']}")


def json_response(content: object, status: int = 200, media_type: str = "application/json") -> Response:
    """Answer with an object as JSON, which no browser keeps."""
    return Response(to_json(content), status, {"Cache-Control": "no-store"}, media_type)
