"""`obu command`: sends a command of the operator to a running unit, and prints what becomes of it."""

import json
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path
from uuid import uuid4

from services.monitoring.status.web.access.tokens import Tokens, tokens_folder
from services.monitoring.status.web.command import right_of
from shared.bus.bus import Bus, decoded
from shared.errors import UserError
from shared.messages.operation import CommandStage, ModeAnswer, OperatorCommand
from shared.runtime.config import VehicleFile, broker_address, page_of, state_dir
from shared.topics import BY_NAME

CONNECT_S = 5.0
TOKEN_S = 60.0  # for which the token of a command is valid
FIRST_ANSWER_S = 10.0  # controller.mode reads the bus ten times a second
LAST_ANSWER_S = 320.0  # a cold start may take 300 s


def send(kind: OperatorCommand, vehicle: VehicleFile, *, source: str | None, period_s: float | None, wait: bool) -> int:
    """Send a command; returns 0 if it is done (or accepted, without `wait`), 1 if it has failed.

    Raises
    ------
    UserError
        If no unit runs here, or the command is none.
    """
    folder = state_dir()
    address = page_of(folder)
    if address is None:
        raise UserError(
            f"no unit is running with its state in {folder}; start it with `obu up`, or set OBU_STATE to its folder"
        )
    request_id = uuid4().hex[:12]
    bus = Bus("observer", vehicle.name, broker_address(), (BY_NAME["mode/answer"],), folder, observer=True)
    try:
        _connect(bus)
        given = {"request_id": request_id, "command": kind.value, "source": source, "navigation_period_s": period_s}
        _post(folder, address, kind, {key: value for key, value in given.items() if value is not None})
        return _follow(bus, request_id, wait=wait)
    finally:
        bus.close()


def _connect(bus: Bus) -> None:
    until = time.monotonic() + CONNECT_S
    while not bus.connected:
        bus.receive(0.1)
        if time.monotonic() > until:
            raise UserError(f"{bus.last_error or 'no broker responds'}; is the unit running?")


def _post(folder: Path, address: str, kind: OperatorCommand, given: dict[str, object]) -> None:
    """Send the command with a token of its own: who may write to the folder of the page may command the unit."""
    token = Tokens(tokens_folder(folder)).add_temporary("command", right_of(kind), seconds=TOKEN_S)
    headers = {"Content-Type": "application/json", "Authorization": f"Bearer {token}"}
    request = urllib.request.Request(f"{address}/api/command", json.dumps(given).encode(), headers, method="POST")
    try:
        with urllib.request.urlopen(request, timeout=CONNECT_S):  # the unit's own address
            return
    except urllib.error.HTTPError as error:
        raise UserError(f"the unit refuses the command: {_detail(error)}") from error
    except OSError as error:
        raise UserError(f"the unit does not answer at {address}: {error}; is it running?") from error


def _detail(error: urllib.error.HTTPError) -> str:
    try:
        return str(json.loads(error.read(4096))["detail"])
    except (ValueError, KeyError, TypeError):
        return f"status {error.code}"


def _follow(bus: Bus, request_id: str, *, wait: bool) -> int:
    """Print the answers until the last one."""
    until, accepted = time.monotonic() + FIRST_ANSWER_S, False
    while time.monotonic() < until:
        for envelope in bus.receive(0.2):
            answer = decoded(bus, envelope)
            if not isinstance(answer, ModeAnswer) or answer.request_id != request_id:
                continue
            print(f"{answer.stage}{f': {answer.reason}' if answer.reason else ''}", flush=True)
            if answer.stage is CommandStage.FAILED:
                return 1
            if answer.stage is CommandStage.DONE or not wait:
                return 0
            until, accepted = time.monotonic() + LAST_ANSWER_S, True
    silent = "controller.mode does not say what has become of it" if accepted else "controller.mode does not answer"
    print(f"obu: {silent}; `obu doctor` says whether it runs", file=sys.stderr)
    return 1
