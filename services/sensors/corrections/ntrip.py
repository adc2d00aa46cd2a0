"""The client's side of NTRIP, versions 1 and 2: requests, answers, source tables. It does no input and output itself.

References
----------
RTCM 10410.1, "Networked Transport of RTCM via Internet Protocol (Ntrip)", version 2.0, with version 1.0 in its annex.
RFC 9110, RFC 9112: HTTP.
"""

import re
from base64 import b64encode
from difflib import get_close_matches
from math import cos, hypot, radians

from shared import VERSION

from .address import Address
from .chunked import ChunkedDecoder
from .fault import ConnectionEnded, SourceFault, refused, shown

MAX_LINE = 1024  # [bytes] of a header
MAX_HEADER = 16384  # [bytes] of all headers
MAX_TABLE = 1 << 20  # [bytes]; that of the largest public caster, with some 700 streams, has about 150 kB
OVERLOAD_PAUSE_S = 60.0  # until the next attempt at a caster that is overloaded
MAX_RETRY_AFTER_S = 3600
MAX_NAMES = 4  # names in a sentence
# Some casters of version 1 write the codes of HTTP behind ICY, or alone.
_STATUS = re.compile(rb"(?:(?:HTTP/\d(?:\.\d)?|ICY|NTRIP(?:/\d\.\d)?) +|(?=[45]))(\d{3})(?: +(.*))?\Z", re.I)
_HEADER = re.compile(rb"[A-Za-z0-9-]{1,64}:[ \t]*[ -~\x80-\xff]*\r?\n")
_OLDER = (400, 405, 406, 426, 501, 505)  # answers of casters that know version 1 only
STREAM, TABLE = "gnss/data", "gnss/sourcetable"
# Lines with which a source table begins (RTCM 10410.1, table 4), in a form with which no frame of corrections begins.
_TABLE_LINES = (b"STR;", b"CAS;", b"NET;", b"ENDSOURCETABLE", b"SOURCETABLE 200")
_ERROR = b"ERROR"
_TEXT = re.compile(rb"[\t\r\n -~]*\Z")
# What the reasons of a refusal say, in lower case and in the order in which they are judged: version 1 has no codes.
_LOCKED = re.compile(r"locked|blocked|banned|suspended")
_BUSY = re.compile(r"already|in use|too many|maximum|limit|busy|overload|temporar|try again|capacity|\bfull\b")
_CREDENTIALS = re.compile(
    r"passw|auth|credential|log ?in|\buser|account|denied|forbidden|not allowed|permi(?:ssion|tted)|expired|"
    r"subscription|licen[cs]e|disabled"
)
_MOUNT = re.compile(r"mount|stream|station|source")
_UNKNOWN = re.compile(r"invalid|unknown|\bno(?:t|ne)?\b|n't|bad|wrong|unavailable")
# A refusal without a status, as the first line.
_REFUSAL = re.compile(
    rb"(?:bad|invalid|wrong|incorrect) |unauthori[sz]ed|forbidden|authenticat|authori[sz]ation|access denied|log ?in",
    re.IGNORECASE,
)
_OTHER_VERSION = re.compile(r"bad request|version|protocol|not implemented|unsupported|not supported")


class NtripDialogue:
    """One request for a mount point, and its answer.

    Parameters
    ----------
    address : Address
        Caster, mount point and user.
    password : str
        [-] Empty without one.
    version : int
        1 or 2. A caster of version 1 that answers a request of version 2 is understood as well.
    location : tuple of float, optional
        [deg, deg] Latitude and longitude, by which near mount points are suggested.
    """

    def __init__(
        self, address: Address, password: str, version: int, location: tuple[float, float] | None = None
    ) -> None:
        self.streaming = False  # the caster has granted the stream; it may wait for a position before it sends any
        self._address, self._password, self._version, self._location = address, password, version, location
        self._buffer = b""
        self._header_bytes = 0
        self._code: int | None = None  # of HTTP, 0 of version 1
        self._reason = ""
        self._headers: dict[str, str] = {}
        self._table: bytearray | None = None
        self._chunks: ChunkedDecoder | None = None
        self._body: bytes | None = None  # what is behind the headers, until it is known what that is
        self._is_stream = False  # it is known

    def request(self, gga: str | None = None) -> bytes:
        """Write the request, with the position if there is one."""
        address = self._address
        http = "1.1" if self._version == 2 else "1.0"
        lines = [f"GET /{address.mount} HTTP/{http}"]
        if self._version == 2:
            lines += [f"Host: {address.host}:{address.port}", "Ntrip-Version: Ntrip/2.0"]
        lines.append(f"User-Agent: NTRIP OBU/{VERSION}")
        if address.user is not None:
            token = b64encode(f"{address.user}:{self._password}".encode()).decode()
            lines.append(f"Authorization: Basic {token}")
        if self._version == 2:
            lines += [f"Ntrip-GGA: {gga.strip()}"] if gga else []
            lines.append("Connection: close")
        return ("\r\n".join(lines) + "\r\n\r\n").encode()

    def feed(self, data: bytes) -> bytes:
        """Process received bytes; return those of the stream.

        Raises
        ------
        SourceFault
            The caster refuses, or what it sends is no answer of one.
        """
        if self._is_stream:
            return self._decoded(data)
        self._buffer += data
        while self._body is None and self._table is None:
            if not self._step():
                return b""
        received, self._buffer = self._buffer, b""
        content = self._decoded(received)
        if self._table is None:
            self._body, content = b"", (self._body or b"") + content
            if not self._judge_body(content):
                return content if self._is_stream else b""
        self._read_table(content)
        return b""

    def answer(self, now_s: float) -> bytes:
        """Nothing but positions is sent after the request."""
        return b""

    def ended(self, fault: SourceFault) -> SourceFault:
        """Explain the end of the connection by what came before it, be it incomplete."""
        if self._is_stream:
            return fault
        try:
            self._read_to_the_end()
        except SourceFault as found:
            return found
        if self._code is None:
            return SourceFault(
                f"{fault} without an answer: is it an NTRIP caster?", wait_s=fault.wait_s, older=self._version == 2
            )
        return fault

    def _decoded(self, data: bytes) -> bytes:
        """Content of received bytes; raises SourceFault behind the last chunk."""
        if self._chunks is None:
            return data
        content = self._chunks.feed(data)
        if self._chunks.finished and not content:
            raise self.ended(ConnectionEnded("the caster ended the stream"))
        return content

    def _read_to_the_end(self) -> None:
        """Judge what was left undecided: some casters end no line, or send no empty line behind a refusal."""
        if self._table is None and self._body is None:
            self._buffer += b"\n" if self._buffer else b""
            while self._body is None and self._table is None and self._step():
                pass
        if self._table is not None:
            raise self._unknown_mount()
        if self._body is None and self._code:
            self._answered()
        self._judge_body((self._body or b"").strip() + b"\n" if self._body else b"", whole=True)

    def _step(self) -> bool:
        """Read the status or a header; whether something was read."""
        if self._buffer.startswith(_TABLE_LINES):  # no empty line, or no status, is before it
            self._table = bytearray()
            return True
        if self._code == 0 and self._begins_stream():
            self._body, self.streaming = b"", True
            return True
        line, end, rest = self._buffer.partition(b"\n")
        if not end:
            if len(self._buffer) > MAX_LINE:
                raise self._too_long()
            return False
        self._header_bytes += len(line) + 1
        if len(line) > MAX_LINE or self._header_bytes > MAX_HEADER:
            raise self._too_long()
        self._buffer = rest
        line = line.rstrip(b"\r")
        if self._code is None:
            self._status(line)
        elif line:
            name, _, value = line.partition(b":")
            self._headers[shown(name).lower()] = shown(value, 200)
        else:
            self._answered()
        return True

    def _begins_stream(self) -> bool:
        """Whether the stream of version 1 begins: behind an empty line, or, from some casters, without one."""
        buffer = self._buffer
        if not buffer:
            return False
        if buffer.startswith((b"\r\n", b"\n")):
            self._buffer = buffer[1 + (buffer[0] == 13) :]
            return True
        text = buffer[:MAX_LINE]
        if buffer == b"\r" or _HEADER.match(text):
            return False
        whole = b"\n" in text or len(buffer) > MAX_LINE
        return whole or not re.fullmatch(rb"[A-Za-z0-9-]{1,64}(?::[ -~\x80-\xff]*)?\r?", text)

    def _status(self, line: bytes) -> None:
        if line.startswith(b"ICY 200"):
            self._code = 0
            return
        if line.upper().startswith(_ERROR):
            raise self._error(shown(line[len(_ERROR) :]))
        match = _STATUS.match(line)
        if match is None:
            if _REFUSAL.match(line):
                raise self._error(shown(line))  # the reason alone
            raise SourceFault(
                f"{self._address.host}:{self._address.port} is no NTRIP caster: it answers {shown(line, 40)!r}"
            )
        self._code, self._reason = int(match[1]), shown(match[2] or b"")

    def _error(self, reason: str) -> SourceFault:
        """Judge a refusal by its words."""
        reason = reason.lstrip(" -:")
        if code := re.match(r"([45]\d\d)\b[ -]*", reason):
            self._code, self._reason = int(code[1]), reason[code.end() :]
            self._answered()
        lower = reason.lower()
        busy = _BUSY.search(lower)
        if _LOCKED.search(lower) or (_CREDENTIALS.search(lower) and not busy):
            return self._bad_password(reason)
        if _MOUNT.search(lower) and _UNKNOWN.search(lower) and not busy:
            return refused(f"the caster does not know the mount point {self._address.mount!r}: {reason}")
        older = self._version == 2 and bool(_OTHER_VERSION.search(lower))
        return SourceFault(
            f"the caster refuses: {reason or 'it states no reason'}",
            wait_s=None if older else OVERLOAD_PAUSE_S,
            older=older,
        )

    def _answered(self) -> None:
        """Judge an answer of HTTP, whose headers are complete."""
        code = self._code or 0
        if code in (401, 407):
            raise self._bad_password(self._reason)
        if code == 403:
            raise refused(
                f"the caster does not allow this user the mount point {self._address.mount!r}; ask its operator"
            )
        if code in (404, 410):
            raise refused(
                f"the caster does not know the mount point {self._address.mount!r}; "
                f"its list is at http://{self._address.host}:{self._address.port}/"
            )
        if 300 <= code < 400:
            to = self._headers.get("location", "another address")
            raise refused(f"the caster has moved to {shown(to)}: if you trust it, write that into sources")
        if code in (429, 503):
            raise SourceFault(f"the caster is overloaded: {code} {self._reason}", wait_s=self._retry_after_s())
        if code != 200:
            older = self._version == 2 and code in _OLDER
            raise SourceFault(
                f"the caster refuses: {code} {self._reason}", wait_s=None if older else OVERLOAD_PAUSE_S, older=older
            )
        self._begin()

    def _kind(self) -> str:
        """Content type of the answer."""
        return self._headers.get("content-type", STREAM).partition(";")[0].strip().lower()

    def _begin(self) -> None:
        if "chunked" in self._headers.get("transfer-encoding", "").lower():
            self._chunks = ChunkedDecoder()
        if self._kind() == TABLE or self._reason.upper().startswith("SOURCETABLE"):
            self._table = bytearray()
        else:
            self._body, self.streaming = b"", not self._kind().startswith("text/")

    def _judge_body(self, content: bytes, *, whole: bool = False) -> bool:
        """Whether the content is a source table; otherwise it is a stream, or kept until that can be told.

        Its content type does not count: casters send tables and reasons of refusals as text, or as a stream.
        """
        start = content.lstrip()
        if start.startswith(_TABLE_LINES):
            self._table, self.streaming = bytearray(), False
            return True
        line, end, _ = start.partition(b"\n")
        is_text = self._kind().startswith("text/")
        expected = (*_TABLE_LINES, _ERROR, b"<")
        undecided = not whole and any(head.startswith(start) for head in expected)
        refusal = start.startswith(_ERROR) or (is_text and bool(start) and bool(_TEXT.match(line)))
        if not undecided and self._kind().startswith("text/html") and (start or whole):
            raise refused(
                f"{self._address.host}:{self._address.port} answers with a web page: it is no caster, or this network "
                "wants you to log in", OVERLOAD_PAUSE_S,
            )  # fmt: skip
        if refusal and not undecided and (end or len(line) > MAX_LINE):
            raise self._error(shown(line.removeprefix(_ERROR)))
        if undecided or (refusal and not end):
            self._body = content
        else:
            self._is_stream = self.streaming = bool(content)
        return False

    def _bad_password(self, reason: str) -> SourceFault:
        user = "without a user" if self._address.user is None else "user or password"
        return refused(
            f"the caster refuses {user} for {self._address.mount!r} ({reason or 'no reason given'}); check user and "
            "password_file, then restart sensors.corrections: the next attempt by itself is in 5 minutes"
        )

    def _retry_after_s(self) -> float:
        text = self._headers.get("retry-after", "")
        return (
            float(min(max(int(text), 10), MAX_RETRY_AFTER_S))
            if text.isdecimal() and len(text) < 8
            else OVERLOAD_PAUSE_S
        )

    def _too_long(self) -> SourceFault:
        return SourceFault(f"{self._address.host}:{self._address.port} is no NTRIP caster: its headers do not end")

    def _read_table(self, content: bytes) -> None:
        """Collect the source table that was sent in place of a stream, up to its end."""
        assert self._table is not None
        searched = max(len(self._table) - len(b"ENDSOURCETABLE"), 0)
        self._table += content
        if self._table.find(b"ENDSOURCETABLE", searched) >= 0 or len(self._table) > MAX_TABLE:
            raise self._unknown_mount()

    def _unknown_mount(self) -> SourceFault:
        near = nearest_mounts(bytes(self._table or b""), self._address.mount, self._location)
        return refused(
            f"the caster does not know the mount point {self._address.mount!r}; "
            + (f"near to it are {', '.join(near)}" if near else "its list is empty")
        )


def nearest_mounts(table: bytes, mount: str, location: tuple[float, float] | None) -> list[str]:
    """Find the mount points of a source table with similar names, then those whose stations are nearest.

    Parameters
    ----------
    table : bytes
        Lines of RTCM 10410.1, table 5: those that begin with "STR;" describe streams.
    mount : str
        The name that the caster does not know.
    location : tuple of float, optional
        [deg, deg] Latitude and longitude of the vehicle.

    Returns
    -------
    list of str
        At most four names.
    """
    places: dict[str, tuple[float, float] | None] = {}
    for line in table.decode("latin-1").splitlines():
        fields = line.split(";")
        if fields[0] == "STR" and len(fields) > 1 and (name := shown(fields[1], 32)):
            places[name] = _place(*fields[9:11]) if len(fields) > 10 else None  # some casters give names only
    by_name = {name.lower(): name for name in places}
    found = [by_name[name] for name in get_close_matches(mount.lower(), by_name, n=MAX_NAMES)]
    if location is not None:
        distances = {name: _distance(place, location) for name, place in places.items() if place is not None}
        found += [name for name in sorted(distances, key=lambda name: distances[name]) if name not in found]
    return (found or list(places))[:MAX_NAMES]


def _place(latitude: str, longitude: str) -> tuple[float, float] | None:
    try:
        place = float(latitude), float(longitude)
    except ValueError:
        return None
    return place if abs(place[0]) <= 90.0 and abs(place[1]) <= 360.0 else None


def _distance(place: tuple[float, float], location: tuple[float, float]) -> float:
    """Distance in degrees of latitude on a sphere, good enough to sort by."""
    east = (place[1] - location[1] + 180.0) % 360.0 - 180.0
    return hypot(place[0] - location[0], east * cos(radians(location[0])))
