"""The interface of the lanes' cameras: orders in datagrams, each answered; and a simulated camera.

An order is the JSON of `plaza/picture_order`. The camera answers {"picture": ..., "action": ...}, the same ones as in
the order, once it has done it; the same order again changes nothing. `take` keeps the picture of the instant `pulse_ns`
from the camera's ring buffer, `keep` sets its end, `delete` overwrites it. Whatever it receives or not, the camera
deletes a picture at `until_ns`.
"""

import json
import socket
from collections import OrderedDict, deque
from dataclasses import dataclass

from shared.devices.v2x_device import host_and_port
from shared.errors import UserError
from shared.messages.toll import PictureAction, PictureAnswer, PictureOrder

MAX_PICTURES, MAX_WAITING, MAX_ANSWER, ATTEMPTS = 20_000, 1000, 500, 10
REPEAT_NS = 1_000_000_000


class SimulatedCamera:
    """Holds pictures without content."""

    def __init__(self) -> None:
        self.pictures: OrderedDict[str, PictureOrder] = OrderedDict()
        self.answered: deque[PictureAnswer] = deque(maxlen=MAX_WAITING)
        self.failed = 0

    def obey(self, order: PictureOrder, now_ns: int) -> None:
        """Carry out an order."""
        self.expire(now_ns)
        if order.action is PictureAction.DELETE:
            self.pictures.pop(order.picture, None)
        elif order.action is PictureAction.TAKE or order.picture in self.pictures:
            self.pictures[order.picture] = order
        self.answered.append(PictureAnswer(picture=order.picture, action=order.action))
        while len(self.pictures) > MAX_PICTURES:
            self.pictures.popitem(last=False)

    def expire(self, now_ns: int) -> None:
        """Delete what has reached its end."""
        for picture in [name for name, order in self.pictures.items() if order.until_ns <= now_ns]:
            del self.pictures[picture]

    def close(self) -> None:
        """Nothing is open."""


@dataclass
class WaitingOrder:
    """An order that the camera has not answered."""

    order: PictureOrder
    attempts: int = 0
    next_ns: int = 0


class UdpCamera:
    """Sends orders to a camera until it has answered them, ten times; the ledger repeats those without an answer."""

    def __init__(self, url: str) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._address = host_and_port(url)
        self._peer: tuple[str, int] | None = None  # the address of its host
        self._waiting: OrderedDict[tuple[str, str], WaitingOrder] = OrderedDict()
        self.held: dict[str, PictureOrder] = {}  # as the camera has answered
        self.answered: deque[PictureAnswer] = deque(maxlen=MAX_WAITING)
        self.failed = 0

    def obey(self, order: PictureOrder, now_ns: int) -> None:
        """Send an order; of a picture the newest one counts."""
        for key in [key for key in self._waiting if key[0] == order.picture]:
            del self._waiting[key]
        self._waiting[order.picture, order.action.value] = WaitingOrder(order)
        if len(self._waiting) > MAX_WAITING:
            self._waiting.popitem(last=False)
            self.failed += 1
        self.expire(now_ns)

    def expire(self, now_ns: int) -> None:
        """Read answers, and repeat what has none."""
        self._read_answers()
        for key, waiting in list(self._waiting.items()):
            if waiting.next_ns > now_ns:
                continue
            if waiting.attempts >= ATTEMPTS:
                del self._waiting[key]
                self.failed += 1
                continue
            waiting.attempts, waiting.next_ns = waiting.attempts + 1, now_ns + REPEAT_NS
            try:
                if self._peer is None:
                    self._peer = (socket.gethostbyname(self._address[0]), self._address[1])
                self._socket.sendto(waiting.order.model_dump_json(exclude_none=True).encode(), self._peer)
            except OSError:  # as if it was lost: it is repeated, and counted in the end
                continue
        self.held = {picture: order for picture, order in self.held.items() if order.until_ns > now_ns}

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _read_answers(self) -> None:
        for _ in range(MAX_WAITING):
            try:
                data, address = self._socket.recvfrom(MAX_ANSWER)
            except (BlockingIOError, ConnectionError):
                return
            if address == self._peer and (answer := _answer(data)) in self._waiting:
                order = self._waiting.pop(answer).order
                self.answered.append(PictureAnswer(picture=order.picture, action=order.action))
                if order.action is PictureAction.DELETE:
                    self.held.pop(order.picture, None)
                else:
                    self.held[order.picture] = order

    @property
    def pictures(self) -> dict[str, PictureOrder]:
        """Pictures that the camera says it holds."""
        return self.held


def _answer(data: bytes) -> tuple[str, str]:
    try:
        fields = json.loads(data)
        return str(fields["picture"]), str(fields["action"])
    except (ValueError, TypeError, KeyError, RecursionError):
        return "", ""


Camera = SimulatedCamera | UdpCamera


def check_camera(url: str) -> None:
    """Raise `UserError` for a URL of no camera."""
    if url == "simulated:":
        return
    if not url.startswith("udp://"):
        raise UserError(f"unknown camera {url!r}: try udp://127.0.0.1:47361 or simulated:")
    host_and_port(url)


def open_camera(url: str) -> Camera:
    """Open the camera of a URL."""
    return SimulatedCamera() if url == "simulated:" else UdpCamera(url)
