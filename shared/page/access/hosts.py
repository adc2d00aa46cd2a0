"""By which names the unit is reached: a page from elsewhere shall not read the vehicle's position from here."""

import socket
from collections.abc import Iterable
from functools import cache
from ipaddress import ip_address
from urllib.parse import urlsplit

LOCAL_SUFFIXES = ("local", "lan", "home", "internal", "home.arpa")  # of the unit's own name in a local network


def host_name(host: str | None) -> str | None:
    """Read the name out of a Host header; None if it is no host."""
    try:
        return urlsplit(f"//{host}").hostname if host else None
    except ValueError:
        return None


@cache
def own_names() -> frozenset[str]:
    """The names of this machine: its host name alone, and in a local network."""
    name = socket.gethostname().lower()
    short = name.split(".")[0]
    return frozenset((name, short, *(f"{short}.{suffix}" for suffix in LOCAL_SUFFIXES)))


def host_allowed(host: str | None, allowed: Iterable[str] = ()) -> bool:
    """Accept addresses, localhost, the names of this machine, and the names of the settings.

    A page at another name that was re-pointed to the unit (DNS rebinding) is refused by this, also one of the local
    network, where every device may choose its name. An address cannot be re-pointed; which addresses lead here is not
    known to a container.
    """
    name = host_name(host)
    if not name:
        return False
    name = name.removesuffix(".")
    if name == "localhost" or name.endswith(".localhost") or name in own_names():
        return True
    return name in {entry.lower() for entry in allowed} or _is_address(name)


def same_origin(origin: str | None, host: str | None) -> bool:
    """Accept a request without Origin (no browser sent it), or one from a page of this very host and port."""
    if origin is None:
        return True
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    return bool(host) and parts.scheme in ("http", "https") and parts.netloc.lower() == str(host).lower()


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True
