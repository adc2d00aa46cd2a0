"""Runs a web server within a process that is ended by cancelling it."""

import asyncio

import uvicorn


async def until_cancelled(server: uvicorn.Server) -> None:
    """Serve; when cancelled, let requests and streams end before that goes on."""
    task = asyncio.create_task(server.serve())
    try:
        await asyncio.shield(task)
    except asyncio.CancelledError:
        server.should_exit = True
        await task
        raise
