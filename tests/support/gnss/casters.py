"""A fake NTRIP caster: a TCP server that answers each connection with what a test tells it to, right or wrong."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from tests.support.patience import HANGS_S

Answer = Callable[[socket.socket, bytes], None]


class FakeCaster:
    """Answers the n-th connection with the n-th function, and further ones with the last; stores the requests."""

    def __init__(self, *answers: Answer) -> None:
        self.requests: list[bytes] = []
        self.received = b""  # after the requests
        self.stopping = False
        self.raw = False  # whether the answer reads the request itself, as over TLS
        self._answers = answers
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.05)
        self.port = int(self._server.getsockname()[1])
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def url(self, mount: str = "MOUNT", user: str = "", options: str = "") -> str:
        return f"ntrip://{user}{'@' if user else ''}127.0.0.1:{self.port}/{mount}{options}"

    def listen(self, connection: socket.socket, for_s: float) -> None:
        """Store what the client sends."""
        connection.settimeout(0.02)
        until = time.monotonic() + for_s
        while time.monotonic() < until and not self.stopping:
            with suppress(TimeoutError, ConnectionError):
                self.received += connection.recv(4096)

    def stop(self) -> None:
        self.stopping = True
        self._server.close()
        for thread in self._threads:
            thread.join(HANGS_S)

    def _accept(self) -> None:
        while not self.stopping:
            try:
                connection, _ = self._server.accept()
            except TimeoutError:
                continue
            except OSError:
                return
            answer = self._answers[min(len(self.requests), len(self._answers) - 1)]
            thread = threading.Thread(target=self._serve, args=(connection, answer))
            self._threads.append(thread)
            thread.start()

    def _serve(self, connection: socket.socket, answer: Answer) -> None:
        with connection:
            connection.settimeout(2.0)
            request = b""
            with suppress(TimeoutError, ConnectionError):
                while not self.raw and b"\r\n\r\n" not in request and (part := connection.recv(4096)):
                    request += part
            self.requests.append(request)
            with suppress(ConnectionError):
                answer(connection, request)


@contextmanager
def fake_caster(*answers: Answer) -> Iterator[FakeCaster]:
    caster = FakeCaster(*answers)
    try:
        yield caster
    finally:
        caster.stop()


def saying(data: bytes, then_s: float = 0.0) -> Answer:
    """Answer with bytes, and keep the connection open for a while."""

    def answer(connection: socket.socket, _request: bytes) -> None:
        connection.sendall(data)
        time.sleep(then_s)

    return answer
