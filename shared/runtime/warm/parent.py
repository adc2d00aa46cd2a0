"""The parent: imports what its children share, and forks one for each request of the supervisor."""

import array
import gc
import json
import os
import socket
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from pydantic import BaseModel

from .kernel import threads
from .rights import Start

MOST_BYTES = 64 * 1024  # of a request
ROOM = socket.CMSG_SPACE(4 * array.array("i").itemsize)  # for the descriptors of a request: those of `Born`

GO_AHEAD = b"1"  # from the supervisor to a child, once it knows its number


class TooManyThreads(RuntimeError):
    """A library has started a thread, whose locks a fork would copy as they are."""


def prepare(modules: Iterable[str]) -> None:
    """Import modules so that forks share their memory: collections of garbage would write into each object."""
    gc.disable()
    for name in modules:
        import_module(name)
    build_validators(BaseModel)


def build_validators(base: type[BaseModel]) -> None:
    """Build what messages build with their first use: each child would have its own."""
    for model in base.__subclasses__():
        model.model_rebuild(raise_errors=False)
        build_validators(model)


def loaded_files() -> dict[Path, tuple[int, int, int]]:
    """Each file of a module that is imported, with what changes where it is replaced."""
    files = (getattr(module, "__file__", None) for module in tuple(sys.modules.values()))
    return {path: _version(path) for path in {Path(file) for file in files if isinstance(file, str)}}


def _version(path: Path) -> tuple[int, int, int]:
    """Time of the last change [ns], number of the file, and size: images may give every file the same time."""
    try:
        status = path.stat()
    except OSError:
        return 0, 0, 0  # it is being replaced, or inside an archive
    return status.st_mtime_ns, status.st_ino, status.st_size


@dataclass(frozen=True)
class Born:
    """What a child finds: its start, and descriptors of its output, errors and environment, and of the go-ahead."""

    start: Start
    output: int
    errors: int
    environment: int
    go_ahead: int


def serve(connection: socket.socket) -> Born | None:
    """Answer the requests of the supervisor until it closes the connection; returns in each child what it shall be.

    An answer holds the process that was made, or why none was.
    """
    made_of = loaded_files()
    _send(connection, {"ready": os.getpid()})
    for start, descriptors in _requests(connection):
        if any(_version(path) != version for path, version in made_of.items()):
            _send(connection, {"refused": "is of files that have changed", "stale": True})
            return None
        try:
            child = fork(start)
        except (TooManyThreads, OSError) as error:
            _send(connection, {"refused": str(error)})
        else:
            if child is None:
                return Born(start, *descriptors)
            _send(connection, {"pid": child})
        for descriptor in descriptors:
            os.close(descriptor)
    return None


def fork(start: Start) -> int | None:
    """Fork a child of the supervisor; returns its number, and None in the child.

    The process in between ends at once, so that the kernel gives its child to the supervisor.
    """
    if (count := threads()) != 1:
        raise TooManyThreads(f"has {count} threads, and cannot fork {' '.join(start.arguments)}")
    gc.freeze()
    gc.collect()  # of nothing, but it returns free lists, which each child would do in pages of its own
    reading, writing = os.pipe()
    try:
        between = os.fork()
    except OSError:
        os.close(reading)
        os.close(writing)
        raise
    if between == 0:
        child = -1
        try:
            child = os.fork()
        finally:
            if child < 0:  # whatever the error is, this process is no second parent
                os._exit(1)
        if child == 0:
            gc.enable()
            return None  # with the pipe, which it closes with all others
        os.write(writing, str(child).encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as answer:
        text = answer.read(32) if os.waitpid(between, 0)[1] == 0 else b""
    if not text:
        raise OSError("has no child: the process in between could not fork")
    return int(text)


def _requests(connection: socket.socket) -> Iterator[tuple[Start, list[int]]]:
    while True:
        text, ancillary, _, _ = connection.recvmsg(MOST_BYTES, ROOM)
        if not text:
            return
        descriptors = array.array("i")
        for level, kind, data in ancillary:
            if (level, kind) == (socket.SOL_SOCKET, socket.SCM_RIGHTS):
                descriptors.frombytes(data)
        yield Start.parse(json.loads(text)), descriptors.tolist()


def _send(connection: socket.socket, answer: dict[str, object]) -> None:
    connection.send(json.dumps(answer).encode())
