"""From where a request comes: the address of the client, directly or behind a reverse proxy."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network

Address = IPv4Address | IPv6Address
Network = IPv4Network | IPv6Network
FORWARDING_HEADERS = ("forwarded", "via", "x-real-ip", "x-client-ip", "true-client-ip", "cf-connecting-ip")
FORWARDED_PREFIX = "x-forwarded-"
UNKNOWN = "unknown"


@dataclass(frozen=True)
class Peer:
    """A client: its address, and what is known of the way."""

    address: str
    loopback: bool  # this machine, without a proxy in between
    forwarded: bool  # some header says that a proxy passed the request on
    proxied: bool  # by a trusted proxy: `address` is the one that it has stated
    encrypted: bool  # the client's connection is HTTPS


def peer_of(client: str | None, scheme: str, headers: Mapping[str, str], trusted: Sequence[Network]) -> Peer:
    """Find the client of a request.

    Parameters
    ----------
    client : str or None
        Address of the connection.
    scheme : str
        http, https, ws or wss, of the connection.
    headers : mapping
        Names in lower case; a header that is repeated is joined by commas.
    trusted : sequence of networks
        Proxies whose statements are believed.
    """
    forwarded = any(name in FORWARDING_HEADERS or name.startswith(FORWARDED_PREFIX) for name in headers)
    address = as_address(client)
    encrypted = scheme in ("https", "wss")
    if address is None:
        return Peer(client or UNKNOWN, False, forwarded, False, encrypted)
    if not (forwarded and contains(trusted, address)):
        return Peer(str(address), address.is_loopback and not forwarded, forwarded, False, encrypted)
    chain = [as_address(part.strip()) for part in headers.get("x-forwarded-for", "").split(",")]
    # The last one that is not a proxy of our own: what stands before it was stated by the client.
    found = next((item for item in reversed(chain) if item is None or not contains(trusted, item)), chain[0])
    encrypted = encrypted or headers.get("x-forwarded-proto", "").split(",")[-1].strip().lower() == "https"
    return Peer(str(found or address), False, True, True, encrypted)


def as_address(text: str | None) -> Address | None:
    """Read an address; one of IPv4 in the form of IPv6 is that of IPv4."""
    try:
        address = ip_address((text or "").strip("[]"))
    except ValueError:
        return None
    mapped = address.ipv4_mapped if isinstance(address, IPv6Address) else None
    return mapped or address


def place_of(client: str) -> str:
    """What clients are counted by: the address, of IPv6 the network of 64 bits, which one machine may have whole."""
    address = as_address(client)
    if address is None:  # a socket of this machine
        return client
    return str(address) if isinstance(address, IPv4Address) else str(IPv6Network((int(address) >> 64 << 64, 64)))


def networks(texts: Iterable[str]) -> tuple[Network, ...]:
    """Read addresses and networks; raises `ValueError` for another text."""
    return tuple(ip_network(text) for text in texts)


def contains(trusted: Sequence[Network], address: Address) -> bool:
    """Whether an address is in one of the networks."""
    return any(address.version == network.version and address in network for network in trusted)
