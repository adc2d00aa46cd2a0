"""Errors of the program of a page, as the browser reports them: counted in the health of this process."""

import logging
from queue import Full, Queue

from fastapi import FastAPI, HTTPException, Request
from pydantic import ValidationError

from shared.bus.bus import Bus
from shared.page import body
from shared.page.answers import AcceptedRequest, reference_to, refusals
from shared.page.page_error import PageError

log = logging.getLogger(__name__)  # limited: a visitor decides how much comes

REJECT = "page error"  # as the heartbeat of monitoring.status counts it
MAX_PENDING = 8  # reports that are not yet counted


BODY = {"content": {"application/json": {"schema": reference_to(PageError)}}, "required": True}


class PageErrorsApi:
    """Takes reports of pages, a few at a time: a page that fails in a loop says nothing new."""

    def __init__(self) -> None:
        self.reports: Queue[PageError] = Queue(MAX_PENDING)

    def add_to(self, app: FastAPI) -> None:
        """Add the route."""
        refused = refusals({403: "A page from elsewhere", 413: "Too long", 422: "Not a report",
                            503: "Reports are waiting"})  # fmt: skip
        app.add_api_route(
            "/api/page-error", self.report, methods=["POST"], status_code=202, response_description="Counted",
            tags=["unit"], responses=refused, openapi_extra={"requestBody": BODY},
        )  # fmt: skip

    async def report(self, request: Request) -> AcceptedRequest:
        """Report an error of the dashboard's program: counted as `page error` in the health of monitoring.status."""
        try:
            report = PageError.model_validate_json(await body.read(request))
        except ValidationError as error:
            raise body.invalid(error) from error
        try:
            self.reports.put_nowait(report)
        except Full as error:
            raise HTTPException(503, "reports before this one are waiting; it is left out") from error
        return {}


def count(errors: PageErrorsApi, bus: Bus) -> None:
    """Count what pages have reported: the heartbeat has the number, and the newest as its last error."""
    while not errors.reports.empty():
        bus.rejects[REJECT] += 1
        bus.last_error = errors.reports.get_nowait().sentence
        log.error("%s", bus.last_error)
