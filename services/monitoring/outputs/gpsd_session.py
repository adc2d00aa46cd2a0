"""One client of the gpsd protocol: its requests, and what it wants to receive.

Requests begin with ?: VERSION, DEVICES, DEVICE, WATCH, POLL. A request ends with a semicolon, a line end, the closing
brace of its argument, the next request, or, as gpsd ends what it has read by itself, a pause. What is no request is
answered with ERROR; a client that sends too much of it, or a request that does not end, is to be dropped.
"""

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from . import gpsd_reports as reports
from .gpsd_reports import Object, encoded

MAX_REQUEST = 1024  # bytes; gpsd itself accepts 80 in a request
MAX_ERRORS = 10  # a port scanner, or a browser; a program asks for a few things that this server does not know
REQUEST = re.compile(r"\?([A-Z]{1,16})(?:=(\{.*\}))?")
NAMES = frozenset((b"?VERSION", b"?DEVICES", b"?DEVICE", b"?WATCH", b"?POLL"))
ENDS, QUERY, OPEN, CLOSE, QUOTE, BACKSLASH = b";\r\n", *b'?{}"\\'
WATCH_DEFAULTS: Object = {
    "enable": False, "json": False, "nmea": False, "raw": 0, "scaled": False, "timing": False, "split24": False,
    "pps": False,
}  # fmt: skip


class BadClient(Exception):
    """A client that is to be dropped; the text is the key of the counter."""


@dataclass
class SharedReports:
    """What all clients see: the newest objects, for POLL, and since when the unit runs [ns, UTC]."""

    started_ns: int = 0
    now_ns: Callable[[], int] = lambda: 0  # UTC
    newest: dict[str, Object | None] = field(default_factory=dict)  # by class; None: not known now


class Session:
    """State of one client."""

    def __init__(self, shared: SharedReports) -> None:
        self._shared = shared
        self._watch = dict(WATCH_DEFAULTS)
        self._pending = b""
        self._answered = b""  # a bare name that a pause has ended; an argument may still follow
        self._errors = 0

    @property
    def wants_json(self) -> bool:
        """Whether it receives objects."""
        return bool(self._watch["enable"] and self._watch["json"])

    @property
    def wants_nmea(self) -> bool:
        """Whether it receives sentences: those are the raw data of this device, too."""
        return bool(self._watch["enable"] and (self._watch["nmea"] or self._watch["raw"]))

    def greeting(self) -> bytes:
        """What is sent before any request."""
        return encoded(reports.version())

    def answer(self, data: bytes) -> bytes:
        """Take bytes of the client and give the answers to the requests that they complete; raises `BadClient`."""
        self._pending += data
        *requests, self._pending = _split(self._pending)
        if requests and self._answered:
            requests, self._answered = requests[requests[0] == self._answered :], b""
        if len(self._pending) > MAX_REQUEST or any(len(request) > MAX_REQUEST for request in requests):
            raise BadClient("request_length")
        return b"".join(encoded(content) for request in requests for content in self._answer(request))

    def pause(self) -> bytes:
        """Give the answer to a request without an argument that has no end, once nothing more comes."""
        if self._pending == self._answered or self._pending not in NAMES:
            return b""
        self._answered = self._pending
        return b"".join(encoded(content) for content in self._answer(self._pending))

    def _answer(self, request: bytes) -> Iterator[Object]:
        text = request.decode("ascii", "replace").strip()
        if not text:
            return
        match = REQUEST.fullmatch(text)
        name = match[1] if match else ""
        try:
            arguments = json.loads(match[2]) if match and match[2] else None
        except (ValueError, RecursionError):
            yield self._error(f"Invalid {name}: its argument is no JSON object")
            return
        match name:
            case "VERSION":
                yield reports.version()
            case "DEVICES":
                yield self._devices()
            case "DEVICE":
                yield from self._about_device(arguments or {})
            case "WATCH":
                yield from self._changed_watch(arguments)
            case "POLL":
                yield self._poll()
            case _:
                yield self._error(f"Unrecognized request '{_printable(text)}'")

    def _devices(self) -> Object:
        return {"class": "DEVICES", "devices": [reports.device(self._shared.started_ns)]}

    def _about_device(self, arguments: Object) -> Iterator[Object]:
        """Answer with the device; its speed and mode are not to be set from here."""
        if self._names_another(arguments.get("path")):
            yield self._error("No such device: this server has the device 'obu'")
        else:
            yield reports.device(self._shared.started_ns)

    def _changed_watch(self, arguments: Object | None) -> Iterator[Object]:
        """Change what is received; an argument enables it unless it says otherwise, and no mode streams nothing."""
        wanted = dict(self._watch) if arguments is None else {**self._watch, "enable": True}
        arguments = arguments or {}
        for name, default in WATCH_DEFAULTS.items():
            value = arguments.get(name, wanted[name])
            # `raw` is a number from 0 to 2, the others are true or false
            if not isinstance(value, int) or (isinstance(default, bool) and not isinstance(value, bool)):
                yield self._error(f"Invalid WATCH: {name} is neither true nor false")
                return
            wanted[name] = min(max(int(value), 0), 2) if name == "raw" else value
        if self._names_another(arguments.get("device")):
            yield self._error("No such device: this server has the device 'obu'")
            return
        self._watch = wanted
        yield self._devices()
        yield {"class": "WATCH", **wanted}

    def _poll(self) -> Object:
        """Answer with one object of each class for the one device, which is active also before it has a position."""
        newest = self._shared.newest
        objects = {name: newest.get(name) or reports.unknown(name) for name in ("TPV", "GST", "SKY")}
        return {
            "class": "POLL",
            "time": reports.iso(self._shared.now_ns()),
            "active": 1,
            **{name.lower(): [content] for name, content in objects.items()},
        }

    def _error(self, message: str) -> Object:
        self._errors += 1
        if self._errors > MAX_ERRORS:
            raise BadClient("bad_requests")
        return reports.error(message)

    @staticmethod
    def _names_another(path: object) -> bool:
        return path is not None and path != reports.DEVICE


def _split(data: bytes) -> list[bytes]:
    """Cut at semicolons, line ends, closed arguments and behind bare names; the last part has not ended yet."""
    parts, start, depth, quoted, escaped = [], 0, 0, False, False
    for at, byte in enumerate(data):
        if byte in ENDS:
            parts.append(data[start:at])
            start, depth, quoted, escaped = at + 1, 0, False, False
        elif byte == QUERY and data[start:at] in NAMES:
            parts.append(data[start:at])
            start = at
        elif quoted:  # braces in a string close nothing
            quoted, escaped = escaped or byte != QUOTE, byte == BACKSLASH and not escaped
        elif byte == QUOTE and depth:
            quoted = True
        elif byte == OPEN:
            depth += 1
        elif byte == CLOSE and depth:
            depth -= 1
            if not depth and data.startswith(b"?", start):
                parts.append(data[start : at + 1])
                start = at + 1
    return [*parts, data[start:]]


def _printable(text: str) -> str:
    return "".join(char for char in text[:40] if char.isprintable() and char not in "\"'\\")
