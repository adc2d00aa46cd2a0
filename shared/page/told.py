"""What somebody who opens an address in a browser is told where there is no page: a page, in place of JSON."""

import html
import json
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any, cast

from fastapi import FastAPI, Request, Response
from fastapi.exception_handlers import http_exception_handler
from fastapi.responses import HTMLResponse
from starlette.exceptions import HTTPException

from . import assets
from .access.table import SAFE_METHODS

API = "/api/"  # for programs: JSON, whoever asks
TITLES = {
    HTTPStatus.NOT_FOUND: "There is no such page",
    HTTPStatus.FORBIDDEN: "This page is not open to you",
    HTTPStatus.SERVICE_UNAVAILABLE: "This page cannot be shown now",
}
PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark"><title>{title}</title><link rel="icon" href="data:,">
<link rel="stylesheet" href="{top}{style}"></head>
<body><main class="boot"><h1>{title}</h1><p>{detail}</p><p><a href="{top}">Back to the first page</a></p></main></body>
</html>
"""


def tell_browsers(app: FastAPI, style: str) -> None:
    """Answer errors of an app's routes with a page where a browser opens one; `style` is the address of its style."""

    async def told(request: Request, error: Exception) -> Response:
        refused = cast("HTTPException", error)
        answer = await http_exception_handler(request, refused)
        return readable(answer, request.scope, dict(request.headers), style)

    app.add_exception_handler(HTTPException, told)


def readable(refusal: Response, scope: Mapping[str, Any], headers: Mapping[str, str], style: str) -> Response:
    """Give the page that says what a refusal in JSON says, where a browser opens a page; else the refusal itself."""
    path = str(scope["path"])
    opens = scope.get("method") in SAFE_METHODS and "text/html" in headers.get("accept", "")
    if not opens or API in path or refusal.status_code < HTTPStatus.BAD_REQUEST or not refusal.body:
        return refusal
    detail = str(json.loads(bytes(refusal.body))["detail"])
    title = TITLES.get(HTTPStatus(refusal.status_code), "This page cannot be shown")
    top = "../" * (path.count("/") - 1) or "./"  # relative: a proxy may have put the pages below a path
    text = PAGE.format(title=title, detail=html.escape(detail[:1].upper() + detail[1:]), top=top, style=style)
    kept = {name: value for name, value in refusal.headers.items() if name not in ("content-length", "content-type")}
    head = {**kept, "Cache-Control": "no-store", "Content-Security-Policy": assets.security_policy("")}
    return HTMLResponse(text, refusal.status_code, head)
