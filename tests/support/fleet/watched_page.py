"""The stream of a vehicle's page that an operator watches."""

from websockets.sync.client import ClientConnection, connect

from tests.support.fleet.web import RunningWeb, Visitor


def stream(running: RunningWeb, visitor: Visitor, vehicle: str) -> ClientConnection:
    """Open it."""
    headers = {"Cookie": f"obu-centre={visitor.http.cookies['obu-centre']}"}
    address = running.address.replace("http", "ws") + f"/vehicles/{vehicle}/live/ws"
    return connect(address, additional_headers=headers, max_size=None)
