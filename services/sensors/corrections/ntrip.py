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
from .fault import SourceFault, refused, shown

LONGEST_LINE = 1024  # [bytes] of a header
LONGEST_HEADER = 16384  # [bytes] of all headers
LONGEST_TABLE = 1 << 20  # [bytes]; that of the largest public caster, with some 700 streams, has about 150 kB
BUSY_S = 60.0  # until the next attempt at a caster that is overloaded
LONGEST_RETRY_AFTER_S = 3600
NEAREST = 4  # names in a sentence
_STATUS = re.compile(rb"HTTP/1\.[01] (\d{3})(?: (.*))?\Z")
_HEADER = re.compile(rb"[A-Za-z0-9-]{1,64}:[ \t]*[ -~\x80-\xff]*\r?\n")
_OLDER = (400, 405, 406, 426, 501, 505)  # answers of casters that know version 1 only
STREAM, TABLE = "gnss/data", "gnss/sourcetable"


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
        self.streaming = False
        self._address, self._password, self._version, self._location = address, password, version, location
        self._buffer = b""
        self._header_bytes = 0
        self._code: int | None = None  # of HTTP, 0 of version 1
        self._reason = ""
        self._headers: dict[str, str] = {}
        self._table: list[bytes] | None = None
        self._chunks: ChunkedDecoder | None = None

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
        if self.streaming:
            return self._chunks.feed(data) if self._chunks else data
        self._buffer += data
        while not self.streaming:
            if self._table is not None:
                self._read_table()
                return b""
            if not self._step():
                return b""
        body, self._buffer = self._buffer, b""
        return self._chunks.feed(body) if self._chunks else body

    def answer(self, now_s: float) -> bytes:
        """Nothing but positions is sent after the request."""
        return b""

    def ended(self, fault: SourceFault) -> SourceFault:
        """Explain the end of the connection by what came before it."""
        if self._table is not None:
            return self._unknown_mount()
        if not self.streaming and self._code:
            try:
                self._answered()  # some casters send no empty line behind a refusal
            except SourceFault as found:
                return found
        if not self.streaming and self._code is None and not self._buffer:
            return SourceFault(f"{fault} without an answer: is it an NTRIP caster?", older=self._version == 2)
        return fault

    def _step(self) -> bool:
        """Read the status or a header; whether something was read."""
        if self._code == 0 and self._begins_stream():
            self.streaming = True
            return True
        line, end, rest = self._buffer.partition(b"\n")
        if not end:
            if len(self._buffer) > LONGEST_LINE:
                raise self._too_long()
            return False
        self._header_bytes += len(line) + 1
        if len(line) > LONGEST_LINE or self._header_bytes > LONGEST_HEADER:
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
        text = buffer[:LONGEST_LINE]
        if buffer == b"\r" or _HEADER.match(text):
            return False
        whole = b"\n" in text or len(buffer) > LONGEST_LINE
        return whole or not re.fullmatch(rb"[A-Za-z0-9-]{1,64}(?::[ -~\x80-\xff]*)?\r?", text)

    def _status(self, line: bytes) -> None:
        if line.startswith(b"ICY 200"):
            self._code = 0
            return
        if line.startswith(b"SOURCETABLE 200"):
            self._table = []
            return
        if line.startswith(b"ERROR"):
            raise self._error(shown(line[5:]).lstrip(" -"))
        match = _STATUS.match(line)
        if match is None:
            raise SourceFault(
                f"{self._address.host}:{self._address.port} is no NTRIP caster: it answers {shown(line, 40)!r}"
            )
        self._code, self._reason = int(match[1]), shown(match[2] or b"")

    def _error(self, reason: str) -> SourceFault:
        lower = reason.lower()
        if "password" in lower or "auth" in lower:
            return self._bad_password(reason)
        if "mount" in lower and "taken" not in lower:
            return refused(f"the caster does not know the mount point {self._address.mount!r}: {reason}")
        return SourceFault(f"the caster refuses: {reason or 'it states no reason'}", wait_s=BUSY_S)

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
                f"the caster refuses: {code} {self._reason}", wait_s=None if older else BUSY_S, older=older
            )
        self._begin(self._headers.get("content-type", STREAM).partition(";")[0].strip().lower())

    def _begin(self, kind: str) -> None:
        if kind.startswith("text/html"):
            raise refused(
                f"{self._address.host}:{self._address.port} answers with a web page: it is no caster, or this network "
                "wants you to log in", BUSY_S,
            )  # fmt: skip
        if "chunked" in self._headers.get("transfer-encoding", "").lower():
            self._chunks = ChunkedDecoder()
        if kind == TABLE or self._reason.upper().startswith("SOURCETABLE"):
            self._table = []
        else:
            self.streaming = True

    def _bad_password(self, reason: str) -> SourceFault:
        user = "without a user" if self._address.user is None else "user or password"
        return refused(
            f"the caster refuses {user} for {self._address.mount!r} ({reason or 'no reason given'}); check user and "
            "password_file, then restart sensors.corrections: the next attempt by itself is in 5 minutes"
        )

    def _retry_after_s(self) -> float:
        text = self._headers.get("retry-after", "")
        return float(min(max(int(text), 10), LONGEST_RETRY_AFTER_S)) if text.isdecimal() and len(text) < 8 else BUSY_S

    def _too_long(self) -> SourceFault:
        return SourceFault(f"{self._address.host}:{self._address.port} is no NTRIP caster: its headers do not end")

    def _read_table(self) -> None:
        """Collect the source table that was sent in place of a stream, up to its end."""
        assert self._table is not None
        data, self._buffer = self._buffer, b""
        self._table.append(self._chunks.feed(data) if self._chunks else data)
        tail = b"".join(self._table[-2:])
        if b"ENDSOURCETABLE" in tail or sum(map(len, self._table)) > LONGEST_TABLE:
            raise self._unknown_mount()

    def _unknown_mount(self) -> SourceFault:
        near = nearest_mounts(b"".join(self._table or ()), self._address.mount, self._location)
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
    found = [by_name[name] for name in get_close_matches(mount.lower(), by_name, n=NEAREST)]
    if location is not None:
        distances = {name: _distance(place, location) for name, place in places.items() if place is not None}
        found += [name for name in sorted(distances, key=lambda name: distances[name]) if name not in found]
    return (found or list(places))[:NEAREST]


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
