"""The web server of a page."""

from collections.abc import Iterable

import uvicorn
from fastapi import FastAPI

from .access.limits import BACKLOG, IDLE_S, Connections, CountedWebSocket, LimitedHttp, limit_logs


def make_server(app: FastAPI, connections: Connections, limited_logs: Iterable[str] = ()) -> uvicorn.Server:
    """Make the server, which the app may end; no compression of frames, which would double its work.

    Headers of proxies are read by the guard, which knows whom to believe. `limited_logs` names loggers whose records
    clients cause: few of each text are written.
    """
    limit_logs(limited_logs)
    app.state.connections = connections
    config = uvicorn.Config(
        app,
        http=LimitedHttp,
        ws=CountedWebSocket,
        ws_per_message_deflate=False,
        ws_max_size=4096,
        backlog=BACKLOG,
        proxy_headers=False,
        timeout_keep_alive=IDLE_S,
        timeout_graceful_shutdown=1,
        server_header=False,
        access_log=False,
        log_config=None,
        log_level="warning",
    )
    server = uvicorn.Server(config)
    app.state.server = server
    return server
