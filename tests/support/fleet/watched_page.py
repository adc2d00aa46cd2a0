"""The stream of a vehicle's page that an operator watches."""

from typing import Any

from websockets.sync.client import ClientConnection, connect

from tests.support.fleet.web import RunningWeb, Visitor


def stream(running: RunningWeb, visitor: Visitor, vehicle: str) -> ClientConnection:
    """Open it."""
    headers = {"Cookie": f"obu-centre={visitor.http.cookies['obu-centre']}"}
    address = running.address.replace("http", "ws") + f"/vehicles/{vehicle}/live/ws"
    return connect(address, additional_headers=headers, max_size=None)


def merge(state: dict[str, Any], changes: dict[str, Any]) -> None:
    """Put the changes of a frame into the state."""
    for key, value in changes.items():
        if isinstance(value, dict) and isinstance(state.get(key), dict):
            merge(state[key], value)
        else:
            state[key] = value
