"""A fake ELM327 for tests, on a pseudo-terminal or a TCP port: it is none, and its name says so.

It answers as the data sheet ELM327DSJ describes; the habits of clones and what a vehicle may do are parameters. None of
that was recorded from an adapter.
"""

import os
import pty
import select
import socket
import threading
import time
import tty
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

from tests.support.patience import HANGS_S

BANNER = "ELM327 v1.5 (a fake of the tests)"


@dataclass
class AdapterBehaviour:
    """What an adapter does that an original does not, and what its vehicle answers."""

    echoes_always: bool = False  # ignores ATE0
    spaces_always: bool = False  # ignores ATS0
    no_headers: bool = False  # ignores ATH1
    delay_s: float = 0.0  # of every answer
    noise: bytes = b""  # in front of every line
    loses_prompts: int = 0  # so many, after the set-up
    banner: str = BANNER
    refuses: tuple[str, ...] = ()  # commands answered by ?
    protocol: str = "A6"
    searching: str = "SEARCHING...\r"
    answers: dict[str, list[str]] = field(  # request -> lines with identifiers
        default_factory=lambda: {"0100": ["7E8 06 41 00 BE 3E B8 11"], "010D": ["7E8 03 41 0D 32"]}
    )
    error: str | None = None  # in place of every answer of the vehicle


class FakeElm327:
    """The state of the fake: gives the bytes that answer a command."""

    def __init__(self, habits: AdapterBehaviour) -> None:
        self.habits = habits
        self.commands: list[str] = []
        self.spaces = self.echo = True
        self.headers = False
        self._searched = False
        self._lost = 0

    def answer(self, command: str) -> bytes:
        """What follows a command, with the prompt."""
        habits, self.commands = self.habits, [*self.commands, command]
        echo = f"{command}\r" if self.echo else ""
        lines = self._lines(command.replace(" ", "").upper())
        body = "".join(f"{line}\r" for line in lines).encode("ascii").replace(b"\r", b"\r" + habits.noise)
        prompt = b"\r>"
        if self._lost < habits.loses_prompts and command.startswith("01"):
            self._lost += 1
            prompt = b"\r"
        return echo.encode() + habits.noise + body + prompt

    def _lines(self, command: str) -> list[str]:
        habits = self.habits
        if command in habits.refuses:
            return ["?"]
        if command == "ATZ":
            self.spaces = self.echo = True
            self.headers = self._searched = False
            return ["", habits.banner]
        if command.startswith("AT"):
            return self._set(command)
        if habits.error is not None:
            return [habits.error]
        found = habits.answers.get(command, ["NO DATA"])
        lines = [self._shown(line) for line in found]
        if not self._searched:
            self._searched = True
            lines[0] = habits.searching + lines[0]
        return lines

    def _set(self, command: str) -> list[str]:
        if command == "ATE0":
            self.echo = self.habits.echoes_always
        elif command == "ATS0":
            self.spaces = self.habits.spaces_always
        elif command == "ATH1":
            self.headers = not self.habits.no_headers
        elif command == "ATDPN":
            return [self.habits.protocol]
        return ["OK"]

    def _shown(self, line: str) -> str:
        if not self.headers and line[:2] == "7E":
            line = line[7:]  # without identifier and length
        return line if self.spaces else line.replace(" ", "")


class _Served:
    """Serves a fake in a thread until the end of a `with`."""

    def __init__(self, habits: AdapterBehaviour | None = None) -> None:
        self.fake = FakeElm327(habits or AdapterBehaviour())
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join(HANGS_S)

    def _run(self) -> None:
        raise NotImplementedError

    def _serve(self, descriptor: int) -> None:
        pending = b""
        while not self._stop.is_set():
            if not select.select([descriptor], [], [], 0.02)[0]:
                continue
            try:
                data = os.read(descriptor, 256)
            except OSError:
                return
            if not data:
                return
            *commands, pending = (pending + data).split(b"\r")
            for command in commands:
                time.sleep(self.fake.habits.delay_s)
                os.write(descriptor, self.fake.answer(command.decode("ascii", "replace")))


class SerialFake(_Served):
    """On a pseudo-terminal."""

    def __init__(self, habits: AdapterBehaviour | None = None) -> None:
        super().__init__(habits)
        self._far, self._near = pty.openpty()
        tty.setraw(self._near)
        self.url = f"elm327://{os.ttyname(self._near)}?baud=38400"

    def _run(self) -> None:
        self._serve(self._far)

    def unplug(self) -> None:
        """Close the far end, as a port that is unplugged."""
        self._stop.set()
        self._thread.join(HANGS_S)
        os.close(self._far)


class TcpFake(_Served):
    """On a TCP port of this computer."""

    def __init__(self, habits: AdapterBehaviour | None = None) -> None:
        super().__init__(habits)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(HANGS_S)
        self.url = f"elm327+tcp://127.0.0.1:{self._listener.getsockname()[1]}"

    def _run(self) -> None:
        with self._listener:
            try:
                connection, _ = self._listener.accept()
            except TimeoutError:
                return
        with connection:
            self._serve(connection.fileno())
