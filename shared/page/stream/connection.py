"""A WebSocket to which frames are written until it is closed by one side."""

import asyncio
from collections.abc import Coroutine

from fastapi import WebSocket, WebSocketDisconnect

from .clients import Client

TRY_AGAIN_LATER = 1013  # registry of close codes of RFC 6455


async def write_frames(socket: WebSocket, client: Client) -> None:
    """Send what is queued for a browser until its end is."""
    while (frame := await client.frames.get()) is not None:
        if client.packed:
            await socket.send_bytes(frame.packed)
        else:
            await socket.send_text(frame.plain.decode())


async def read_until_closed(socket: WebSocket) -> None:
    """Listen only for the end: a dashboard has nothing to say."""
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass


async def run_first_of(*coroutines: Coroutine[None, None, None]) -> None:
    """Run until the first one ends, and end the others."""
    tasks = [asyncio.create_task(coroutine) for coroutine in coroutines]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            if not isinstance(task.exception(), WebSocketDisconnect):
                task.result()
    finally:
        for task in tasks:
            task.cancel()
