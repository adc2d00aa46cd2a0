"""The address of a source of corrections, and the password that belongs to it.

ntrip://user@host:2101/MOUNT       an NTRIP caster; ntrips:// over TLS
tcp://host:port                    a TCP server that sends raw frames
serial:///dev/ttyUSB1?baud=38400   a radio modem or an L-band receiver
mqtt://user@host:1883?topic=/pp/ip/eu   topics of an MQTT broker, such as SPARTN; mqtts:// over TLS
"""

import stat
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import SplitResult, parse_qsl, unquote, urlsplit

from shared.errors import ConfigError
from shared.messages.base import DEVICE_NAME_LENGTH

from .fault import RETRY_S, SourceFault

# Ports of casters and brokers: registered with IANA, and for ntrips:// the one that most casters use beside it.
PORTS = {"ntrip": 2101, "ntrips": 2102, "mqtt": 1883, "mqtts": 8883, "tcp": None}
_TLS = ("password_file", "ca_file", "certificate_file", "key_file")
_OPTIONS = {
    "ntrip": {"password_file", "version", "gga_period_s"},
    "ntrips": {*_TLS, "version", "gga_period_s"},
    "mqtt": {"password_file", "topic"},
    "mqtts": {*_TLS, "topic"},
    "tcp": set[str](),
    "serial": {"baud"},
}
MAX_URL = 1024
MAX_TOPICS = 8
MAX_PASSWORD = 256
EXAMPLE = "ntrip://user@caster.example.org:2101/MOUNT"


@dataclass(frozen=True)
class Address:
    """One source. `name` is what messages call it: without user and options."""

    name: str
    url: str = field(repr=False)  # of a serial port
    scheme: str
    host: str = ""
    port: int = 0
    mount: str = ""
    user: str | None = field(default=None, repr=False)
    topics: tuple[str, ...] = ()
    version: int | None = None  # of NTRIP; None: found out
    gga_period_s: float = 10.0
    password_file: str | None = None
    ca_file: str | None = None
    certificate_file: str | None = None
    key_file: str | None = None

    @property
    def is_ntrip(self) -> bool:
        """Whether it is an NTRIP caster."""
        return self.scheme.startswith("ntrip")

    @property
    def tls(self) -> bool:
        """Whether the connection is encrypted."""
        return self.scheme in ("ntrips", "mqtts")


def parse(url: str, defaults: Mapping[str, str | float | None]) -> Address:
    """Read the URL of a source; `defaults` are the settings of the section for options that it does not have.

    Raises
    ------
    ConfigError
        The URL cannot be used. The text repeats neither user nor password.
    """
    if len(url) > MAX_URL or not url.isprintable() or " " in url:
        raise _wrong("a source", f"has spaces, control characters or more than {MAX_URL} characters: try {EXAMPLE}")
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise _wrong("a source", f"has no valid host and port: try {EXAMPLE}") from error
    if parts.scheme not in _OPTIONS:
        raise _wrong(f"a source of kind {parts.scheme[:16]!r}", f"is not known: try {EXAMPLE}, or tcp, serial, mqtt")
    shown = f"{parts.scheme}://{_host(parts)}{parts.path}"[:DEVICE_NAME_LENGTH]
    if parts.password is not None:
        raise _wrong(shown, "holds a password; write it into a file of its own and name that as password_file")
    topics, options = _options(parts, shown)
    if parts.scheme == "serial":
        return Address(name=shown, url=url, scheme="serial")
    port = port or PORTS[parts.scheme]
    if not parts.hostname or not port:
        raise _wrong(shown, "has no host and port: try tcp://192.168.1.20:5000")
    mount = unquote(parts.path[1:])
    if parts.scheme.startswith("ntrip") and not mount.isascii():
        raise _wrong(shown, "has a mount point that is not ASCII")
    if parts.scheme.startswith("mqtt") and not topics:
        raise _wrong(shown, "names no topic: add ?topic=NAME, and &topic=NAME for each further one")
    if parts.scheme.startswith("ntrip") and not mount:
        raise _wrong(shown, f"names no mount point: try {EXAMPLE}; the caster's list is at http://{_host(parts)}/")
    files = {name: _text(options.get(name) or defaults.get(name)) for name in _TLS}
    return Address(
        name=shown, url="", scheme=parts.scheme, host=parts.hostname, port=port, mount=mount,
        user=None if parts.username is None else unquote(parts.username), topics=topics,
        version=_number(options, "version", shown, (1, 2)),
        gga_period_s=_gga_period_s(options, defaults, shown), **files,
    )  # fmt: skip


def password_of(address: Address) -> str:
    """Read the password of a source; empty without a file.

    Raises
    ------
    SourceFault
        The file cannot be read, or may be read by others.
    """
    if address.password_file is None:
        return ""
    path = Path(address.password_file)
    try:
        if path.stat().st_mode & (stat.S_IROTH | stat.S_IWOTH):
            raise SourceFault(f"others may read {path}: run chmod 600 on it", wait_s=RETRY_S)
        with path.open(encoding="utf-8") as file:
            password = file.readline(MAX_PASSWORD + 2).rstrip("\r\n")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise SourceFault(f"cannot read password_file {path}: {reason}", wait_s=RETRY_S) from error
    if not password or len(password) > MAX_PASSWORD or not password.isprintable():
        raise SourceFault(
            f"password_file {path} holds no password in its first line, or more than {MAX_PASSWORD} characters",
            wait_s=RETRY_S,
        )
    return password


def _wrong(shown: str, what: str) -> ConfigError:
    return ConfigError(f"[sensors.corrections] sources: {shown} {what}")


def _host(parts: SplitResult) -> str:
    return parts.netloc.rpartition("@")[2]


def _options(parts: SplitResult, shown: str) -> tuple[tuple[str, ...], dict[str, str]]:
    pairs = parse_qsl(parts.query)
    known = _OPTIONS[parts.scheme]
    if unknown := [name for name, _ in pairs if name not in known]:
        raise _wrong(shown, f"has no option {unknown[0][:32]!r}; options: {', '.join(sorted(known)) or 'none'}")
    topics = tuple(value for name, value in pairs if name == "topic")
    if len(topics) > MAX_TOPICS:
        raise _wrong(shown, f"names more than {MAX_TOPICS} topics")
    return topics, {name: value for name, value in pairs if name != "topic"}


def _number(options: Mapping[str, str], name: str, shown: str, allowed: tuple[int, ...]) -> int | None:
    if name not in options:
        return None
    if options[name] not in map(str, allowed):
        raise _wrong(shown, f"has {name} = {options[name][:16]!r}; it is one of {', '.join(map(str, allowed))}")
    return int(options[name])


def _gga_period_s(options: Mapping[str, str], defaults: Mapping[str, str | float | None], shown: str) -> float:
    text = options.get("gga_period_s")
    if text is None:
        return float(defaults.get("gga_period_s") or 0.0)
    if not text.isdecimal() or int(text) > 3600:
        raise _wrong(shown, f"has gga_period_s = {text[:16]!r}; it is a number of seconds up to 3600, and 0 for none")
    return float(text)


def _text(value: str | float | None) -> str | None:
    return str(value) if value else None
