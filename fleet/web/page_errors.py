"""Errors of the program of the centre's pages, as browsers report them: counted, and the newest is kept."""

import logging
import time

from fastapi import FastAPI, Request, Response
from pydantic import ValidationError

from shared.page import body
from shared.page.body import json_response
from shared.page.page_error import PageError

from .access.guard import visitor_of

log = logging.getLogger(__name__)

LOG_PERIOD_S = 1.0  # between two that are logged: a visitor decides how many come


class PageErrorsApi:
    """Takes reports of pages; the page Audit shows how many."""

    def __init__(self) -> None:
        self._count, self._left_out = 0, 0
        self._newest: dict[str, object] | None = None
        self._logged_s = -LOG_PERIOD_S

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        app.add_api_route("/api/page-error", self.report, methods=["POST"])
        app.add_api_route("/api/page-errors", self.show)

    async def report(self, request: Request) -> Response:
        """Count an error of the pages' program; who may log in may report."""
        try:
            report = PageError.model_validate_json(await body.read(request))
        except ValidationError as error:
            raise body.invalid(error) from error
        self._count += 1
        self._newest = {"at_ms": time.time_ns() // 1_000_000, "sentence": report.sentence}
        now_s = time.monotonic()
        if now_s - self._logged_s >= LOG_PERIOD_S:
            more = f" ({self._left_out} before it are left out)" if self._left_out else ""
            log.error("%s, of %s%s", report.sentence, visitor_of(request).name, more)
            self._logged_s, self._left_out = now_s, 0
        else:
            self._left_out += 1
        return json_response({}, 202)

    async def show(self) -> Response:
        """Errors since the start of this process; of all tenants, the newest without who had it."""
        return json_response({"errors": self._count, "newest": self._newest})
