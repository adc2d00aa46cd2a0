"""Who a visitor is, and what he may do: tokens, sessions, and the machine itself."""

import hmac
import secrets
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from http.cookies import CookieError, SimpleCookie

from shared.page.access.peer import Network, Peer, as_address, peer_of
from shared.page.access.requests import CSRF_HEADER
from shared.runtime.config import VehicleFile

from .rights import Right
from .tokens import Session, Tokens, is_secret

STILL_VALID_S = 1.0  # between two checks of an open stream
SIMULATED = ("sensors.simulator", "sensors.traffic")
SIMULATED_RADIO = "udp://127.0.0.1:47347"  # default of sensors.v2x


@dataclass(frozen=True)
class Visitor:
    """Somebody who may do something."""

    name: str  # of the token, or "local"
    right: Right
    peer: Peer
    csrf: str | None  # value of the header that a change needs; None: none is needed
    session: Session | None = None
    bearer: str | None = None


@dataclass(frozen=True)
class Rules:
    """When a login is needed, and whose statements are believed."""

    simulated: bool = False
    login_on_loopback: bool | None = None  # None: where the data are not simulated
    published: str | None = None  # address on which a container's port is published; None: not in a container
    trusted_proxies: tuple[Network, ...] = ()
    allowed_hosts: tuple[str, ...] = ()
    session_s: float = 7 * 86_400.0
    per_address: int = 16  # concurrent requests of one address behind a trusted proxy

    def login_needed(self, peer: Peer) -> bool:
        """Whether a visitor without a token is refused."""
        address = as_address(self.published)
        here = peer.loopback or (address is not None and address.is_loopback and not peer.forwarded)
        asked = not self.simulated if self.login_on_loopback is None else self.login_on_loopback
        return asked or not here


@dataclass
class Access:
    """Recognises visitors."""

    rules: Rules
    tokens: Tokens
    _own: str = field(default_factory=lambda: secrets.token_urlsafe(32))  # CSRF value without a session
    _checked: dict[str, tuple[float, bool]] = field(default_factory=dict)

    @property
    def cookie(self) -> str:
        """Name of the cookie: browsers send the cookies of all ports of a host."""
        return f"obu-{self.tokens.content().unit}"

    def peer(self, scope: Mapping[str, object], headers: Mapping[str, str]) -> Peer:
        """From where a request comes."""
        client = scope.get("client")
        host = str(client[0]) if isinstance(client, Sequence) and client else None
        return peer_of(host, str(scope.get("scheme", "http")), headers, self.rules.trusted_proxies)

    def visitor(self, peer: Peer, headers: Mapping[str, str]) -> Visitor | None:
        """Recognise a visitor by bearer token, cookie, or because no login is needed; None: nobody who is known."""
        scheme, _, secret = headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer":
            token = self.tokens.find(secret.strip()) if is_secret(secret.strip()) else None
            if token is None or token.single_use:
                return None
            return Visitor(token.name, token.role, peer, None, bearer=secret.strip())
        cookie = self._cookie_in(headers)
        session = self.tokens.session(cookie) if cookie else None
        if cookie and session:
            return Visitor(session.token, session.role, peer, csrf_of(cookie), session)
        if self.rules.login_needed(peer):
            return None
        return Visitor("local", Right.ADMIN, peer, self._own)

    def still(self, visitor: Visitor) -> bool:
        """Whether a visitor who was recognised would be again; an open stream ends otherwise."""
        key = visitor.session.hash if visitor.session else visitor.bearer
        if key is None:
            return True
        now_s = time.monotonic()
        checked_s, valid = self._checked.get(key, (-STILL_VALID_S, False))
        if now_s - checked_s >= STILL_VALID_S:
            if len(self._checked) > 1000:
                self._checked.clear()
            valid = self._is_valid(visitor)
            self._checked[key] = now_s, valid
        return valid

    def _is_valid(self, visitor: Visitor) -> bool:
        if visitor.session:
            return any(valid_session.hash == visitor.session.hash for valid_session in self.tokens.valid_sessions())
        return visitor.bearer is not None and self.tokens.find(visitor.bearer) is not None

    def _cookie_in(self, headers: Mapping[str, str]) -> str | None:
        try:
            found = SimpleCookie(headers.get("cookie", "")).get(self.cookie)
        except CookieError:
            return None
        return found.value if found and is_secret(found.value) else None


def csrf_of(cookie: str) -> str:
    """The value that changes must carry in a session: it follows from the cookie, which no page can read."""
    return sha256(b"csrf " + cookie.encode()).hexdigest()


def csrf_agrees(visitor: Visitor, headers: Mapping[str, str]) -> bool:
    """Whether a change carries the value that was given to the page."""
    return visitor.csrf is None or hmac.compare_digest(visitor.csrf.encode(), headers.get(CSRF_HEADER, "").encode())


def is_simulated(vehicle: VehicleFile) -> bool:
    """Whether a unit has no device: only simulators, and a radio that receives from this machine."""
    sensors = {name for name in vehicle.processes if name.startswith("sensors.")}
    device = str(vehicle.tables.get("sensors.v2x", {}).get("device", SIMULATED_RADIO))
    if device.startswith("udp://127.0.0.1:"):
        sensors -= {"sensors.v2x"}
    return bool(sensors & set(SIMULATED)) and sensors <= {*SIMULATED, "sensors.replay"}
