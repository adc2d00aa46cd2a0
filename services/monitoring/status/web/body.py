"""Reads the body of a command, which is short."""

import asyncio

from fastapi import HTTPException, Request

BODY_BYTES = 2048
BODY_S = 5.0


async def read(request: Request) -> bytes:
    """Read the body of a request, of a bounded length, within a bounded time."""
    data = b""
    try:
        async with asyncio.timeout(BODY_S):
            async for part in request.stream():
                data += part
                if len(data) > BODY_BYTES:
                    raise HTTPException(413, f"a command has at most {BODY_BYTES} bytes")
    except TimeoutError as error:
        raise HTTPException(408, f"the command was not complete after {BODY_S:g} s; send it again") from error
    return data
