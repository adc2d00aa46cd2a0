"""Attacks on a simulated vehicle over the web."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from queue import Queue

from fastapi import FastAPI, HTTPException, Request

from shared.attacks import BY_NAME
from shared.messages.simulation import AttackCommand, SimulationAttack
from shared.page import body
from shared.page.answers import reference_to, refusals

from ..state import State
from ..views import simulation as views
from ..views.models.simulation import Simulation
from .command import CommandAccepted, new_id, put, read_command

MAX_PENDING = 8  # commands that are not yet published
BODY = {"content": {"application/json": {"schema": reference_to(SimulationAttack)}}, "required": True}


class SimulationApi:
    """Checks commands and queues them for the bus; the answer of the simulator is `simulation/state`."""

    def __init__(self, state: State, lock: AbstractContextManager[object], now_ns: Callable[[], int]) -> None:
        self._state, self._lock, self._now_ns = state, lock, now_ns
        self.commands: Queue[SimulationAttack] = Queue(MAX_PENDING)

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        refused = refusals({403: "A page from elsewhere", 409: "Not simulated", 413: "Too long", 422: "Not a command",
                            503: "Commands are waiting"})  # fmt: skip
        app.add_api_route("/api/simulation", self.simulation, tags=["simulation"], response_description="Attacks")
        app.add_api_route(
            "/api/simulation/attack", self.attack, methods=["POST"], status_code=202, response_description="Published",
            tags=["simulation"], responses=refused, openapi_extra={"requestBody": BODY},
        )  # fmt: skip

    def simulation(self) -> Simulation:
        """The attacks that are possible, those of this drive, and whether the verdict was right."""
        with self._lock:
            shown = views.simulation(self._state, self._now_ns())
        return {**views.catalogue(), "simulation": shown}

    async def attack(self, request: Request) -> CommandAccepted:
        """Start or stop an attack; 202 with the request ID that `simulation/state` will carry."""
        with self._lock:
            simulated = self._state.simulated(self._now_ns())
        if not simulated:
            raise HTTPException(
                409, "the data of this unit are not simulated, so nothing can be attacked; run obu demo"
            )
        command = _command(await body.read(request))
        put(self.commands, command)
        return {"request_id": command.request_id}


def _command(data: bytes) -> SimulationAttack:
    example = '{"command": "start", "attack": "drag_off"}'
    command = read_command(data, SimulationAttack, example, lambda given: {**given, "request_id": new_id()})
    if command.command is AttackCommand.START:
        try:
            if command.attack is None:
                raise ValueError("name the attack that shall start; GET /api/simulation lists them")
            BY_NAME[command.attack].complete(command.parameters)
        except ValueError as error:
            raise HTTPException(422, str(error)) from error
    return command
