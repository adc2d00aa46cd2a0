"""What a program writes, in a file that does not grow without end: vehicles and strangers cause lines."""

import contextlib
import os
import threading
from collections.abc import Iterator
from pathlib import Path

MAX_BYTES = 5_000_000  # of a file; one older file is kept beside it
TAIL_BYTES = 4096
CAUSES = ("PANIC:", "FATAL:", "error:", "[FTL]")  # of PostgreSQL and nats-server


class BoundedLog:
    """Takes the output of one program at a time."""

    def __init__(self, path: Path, most_bytes: int = MAX_BYTES) -> None:
        self.path, self._most_bytes = path, most_bytes
        self._tail = b""
        self._thread: threading.Thread | None = None

    @contextlib.contextmanager
    def output(self) -> Iterator[int]:
        """Give the descriptor that a program is started with; what it writes is taken until it has ended."""
        reader, writer = os.pipe()
        self._tail = b""
        self._thread = threading.Thread(target=self._take, args=(reader,), name=self.path.stem, daemon=True)
        self._thread.start()
        try:
            yield writer
        finally:
            os.close(writer)

    def cause(self) -> str:
        """The line that says why a program that has ended did so."""
        if self._thread is not None:
            self._thread.join(1.0)  # what it wrote last; a child of it may live on
        return cause_in(self._tail.decode("utf-8", "replace"))

    def _take(self, reader: int) -> None:
        with os.fdopen(reader, "rb", buffering=0) as source:
            while data := source.read(65_536):
                self._tail = (self._tail + data)[-TAIL_BYTES:]
                with contextlib.suppress(OSError):  # a full disk: the program must not wait for it
                    self._write(data)

    def _write(self, data: bytes) -> None:
        if self.path.exists() and self.path.stat().st_size + len(data) > self._most_bytes:
            self.path.replace(self.path.with_name(f"{self.path.name}.1"))
        descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o600)
        with os.fdopen(descriptor, "ab", buffering=0) as file:
            file.write(data)


def cause_in(text: str) -> str:
    """Find the line with the cause, without what stands before it: the last that names one, else the last of all."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    named = [line[line.index(word) :] for line in lines for word in CAUSES if word in line]
    return (named or lines or ["it said nothing"])[-1][-500:]
