"""The connection of a process of the centre to NATS."""

import contextlib
import logging
import time
from collections.abc import Iterable
from typing import Any

import nats
from nats.aio.client import Client

from shared.tls import reason_of

from .servers.nats import NatsAccess

log = logging.getLogger(__name__)

RETRY_PERIOD_S = 0.5
SAY_AGAIN_S = 60.0  # a server that is away would fill the log with two lines a second
TELL_S = 3  # in which a server that works answers


async def connect(server: NatsAccess, name: str, **options: Any) -> Client:
    """Connect with options of the library, by TLS where the server has it."""
    logging.getLogger("asyncio").addFilter(_is_of_use)
    return await nats.connect(server.url, name=name, **server.tls, **options)


async def connected(server: NatsAccess, name: str) -> Client:
    """Connect, as often as it takes; a connection that is lost comes back by itself."""
    said, said_s = "", 0.0

    async def tell(error: Exception) -> None:
        """One line: the default logs where in the library it occurred. What goes on is said once a minute."""
        nonlocal said, said_s
        text, now_s = reason_of(error), time.monotonic()
        if text == said and now_s - said_s < SAY_AGAIN_S:
            return
        said, said_s = text, now_s
        log.warning("NATS at %s: %s", server.url.rpartition("@")[2], text)

    return await connect(
        server, name, max_reconnect_attempts=-1, reconnect_time_wait=RETRY_PERIOD_S, allow_reconnect=True, error_cb=tell
    )


def _is_of_use(record: logging.LogRecord) -> bool:
    """Of each connection by TLS that ends, asyncio says how the library's stream is written."""
    return "eof_received() has no effect" not in record.msg


async def closed(client: Client) -> None:
    """End a connection, also one that is lost now."""
    with contextlib.suppress(OSError, nats.errors.Error):
        await client.close()


async def told(client: Client, subject: str, contents: Iterable[bytes]) -> bool:
    """Publish, and tell whether a server has it: what waits for a connection would be sent at some other time."""
    try:
        for content in contents:
            await client.publish(subject, content)
        await client.flush(TELL_S)
    except (OSError, nats.errors.Error) as error:
        log.warning("NATS does not answer: %s", str(error) or type(error).__name__)
        return False
    return client.is_connected
