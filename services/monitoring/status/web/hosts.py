"""Who may ask: a browser that was lured onto another site shall not read the vehicle's position from here."""

from collections.abc import Iterable
from ipaddress import ip_address
from urllib.parse import urlsplit

LOCAL_SUFFIXES = (".local", ".localhost", ".lan", ".home", ".internal", ".home.arpa")


def host_name(host: str | None) -> str | None:
    """Read the name out of a Host header; None if it is no host."""
    try:
        return urlsplit(f"//{host}").hostname if host else None
    except ValueError:
        return None


def host_allowed(host: str | None, allowed: Iterable[str] = ()) -> bool:
    """Accept addresses and names that cannot be registered publicly, and those that the settings name.

    A page at a public name that was re-pointed to the unit (DNS rebinding) is refused by this.
    """
    name = host_name(host)
    if not name:
        return False
    if name in {entry.lower() for entry in allowed} or "." not in name or name.endswith(LOCAL_SUFFIXES):
        return True
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


def same_origin(origin: str | None, host: str | None) -> bool:
    """Accept a request without Origin (no browser sent it), or one from a page of this very host and port."""
    if origin is None:
        return True
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    return bool(host) and parts.scheme in ("http", "https") and parts.netloc.lower() == str(host).lower()
