"""Settings over the web: what holds, and commands to `controller.settings`."""

import logging
from collections.abc import Callable
from contextlib import AbstractContextManager
from queue import Queue

from fastapi import FastAPI, Request
from typing_extensions import TypedDict

from shared.messages.settings import SettingsAnswer, SettingsCatalogue, SettingsCommand, SettingsState
from shared.page import body
from shared.page.answers import Object, answer, reference_to, refusals
from shared.words.words import reason

from ..state import State
from .access.guard import visitor_of
from .command import CommandAccepted, new_id, put, read_command

log = logging.getLogger(__name__)

MAX_PENDING = 4  # commands that are not yet published
BODY = {"content": {"application/json": {"schema": reference_to(SettingsCommand)}}, "required": True}


@answer()
class SettingsReport(TypedDict):
    """The settings of this unit, and what has become of changes."""

    settings: list[Object]
    """rows of `settings/catalogue`; empty while controller.settings has not told them"""
    state: Object | None
    """as `settings/state`; null while controller.settings has not told it"""
    answer: Object | None
    """the newest `settings/answer`: what a command would change, or why it is refused"""
    problem: str | None
    """what `state` says is wrong or was noticed, in English"""
    reasons: list[str]
    """why the change in `state` was taken back, in English"""
    refusals: list[str]
    """why the command in `answer` is refused, in English"""
    now_ns: int
    """time of this answer on the unit's time line"""
    alive: bool
    """whether controller.settings runs"""


class SettingsApi:
    """Shows the settings, and queues commands for the bus; the answers are `settings/answer` and `settings/state`."""

    def __init__(self, state: State, lock: AbstractContextManager[object], now_ns: Callable[[], int]) -> None:
        self._state, self._lock, self._now_ns = state, lock, now_ns
        self.commands: Queue[SettingsCommand] = Queue(MAX_PENDING)

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        refused = refusals({403: "Not the role, or a page from elsewhere", 413: "Too long", 422: "Not a command",
                            503: "Commands are waiting"})  # fmt: skip
        app.add_api_route("/api/settings", self.settings, tags=["settings"], response_description="Settings")
        app.add_api_route(
            "/api/settings", self.command, methods=["POST"], status_code=202, response_description="Published",
            tags=["settings"], responses=refused, openapi_extra={"requestBody": BODY},
        )  # fmt: skip

    def settings(self) -> SettingsReport:
        """Every setting with its value, the newest change, and the newest answer to a command."""
        with self._lock:
            catalogue = self._state.topics["settings/catalogue"].message
            state = self._state.topics["settings/state"].message
            answered = self._state.topics["settings/answer"].message
            alive = not self._state.has_ended("controller.settings")
        told = state if isinstance(state, SettingsState) else None
        newest = answered.change if isinstance(answered, SettingsAnswer) else None
        return {
            "settings": [
                row.model_dump(mode="json")
                for row in (catalogue.settings if isinstance(catalogue, SettingsCatalogue) else ())
            ],
            "state": told.model_dump(mode="json", exclude={"digests"}) if told else None,
            "answer": newest.model_dump(mode="json") if newest else None,
            "problem": reason(told.problem) if told and told.problem else None,
            "reasons": [reason(one) for one in told.change.reasons] if told and told.change else [],
            "refusals": [reason(one) for one in newest.reasons] if newest else [],
            "now_ns": self._now_ns(),
            "alive": alive,
        }

    async def command(self, request: Request) -> CommandAccepted:
        """Check or change settings, confirm a change or take it back; 202 with the request ID of the answer."""
        visitor = visitor_of(request)
        by = (visitor.name if visitor else "unknown")[:64]
        command = read_command(
            await body.read(request), SettingsCommand, '{"action": "check", "changes": {...}}',
            lambda given: {**given, "request_id": new_id(), "by": by},
        )  # fmt: skip
        log.info("settings: %s by %s: %s", command.action, command.by, ", ".join(command.changes))
        put(self.commands, command)
        return {"request_id": command.request_id}
