"""Reads the body of a command, which is short."""

from fastapi import HTTPException, Request

BODY_BYTES = 2048


async def read(request: Request) -> bytes:
    """Read the body of a request, of a bounded length."""
    data = b""
    async for part in request.stream():
        data += part
        if len(data) > BODY_BYTES:
            raise HTTPException(413, f"a command has at most {BODY_BYTES} bytes")
    return data
