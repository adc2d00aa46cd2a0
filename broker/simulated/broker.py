"""The broker itself: sessions, subscriptions, retained messages and wills, without any input or output."""

import time
from collections.abc import Callable

from shared.topics import BROKER_LOG

from ..contract import Bounds, bounds_of
from ..passwords import Passwords
from .access_list import Acl
from .counters import Counters
from .packets import REFUSED, Answer, Connect, ProtocolError, Publish, Subscribe, Unsubscribe, encode_publish
from .session import Limits, Session, Writer
from .topic_filters import is_filter, is_name, matches

MAX_CLIENT_ID = 256
REMEMBERED = 1_000  # topics
Route = tuple[Session, int]  # receiver of a topic, and QoS


class Broker:
    """State of the broker; each method is called with a packet that was decoded."""

    def __init__(
        self,
        acl: Acl | None = None,
        limits: Limits | None = None,
        *,
        passwords: Passwords | None = None,
        bounds: Callable[[str], Bounds | None] = bounds_of,
    ) -> None:
        self.acl = acl
        self.passwords = passwords  # without it every client is who it says
        self.limits = limits or Limits()
        self.counters = Counters()
        self.sessions: dict[str, Session] = {}
        self.retained: dict[str, Publish] = {}
        self.retained_bytes = 0
        self._bounds = bounds
        self._routes: dict[str, list[Route]] = {}  # cached until a subscription changes
        self._assigned = 0

    def connect(self, request: Connect, writer: Writer) -> Session:
        """Begin a session; an existing one of the same name ends."""
        self._check(request)
        self._assigned += not request.client_id
        client_id = request.client_id or f"assigned-{self._assigned}"
        if self.passwords is not None and request.user is not None:
            client_id = request.user  # so that nobody takes over another's session
        if client_id in self.sessions:
            self.sessions[client_id].writer.end()
        session = self.sessions[client_id] = Session(
            client_id, request.user, request.will, writer, self.limits, self.counters
        )
        return session

    def _check(self, request: Connect) -> None:
        if len(request.client_id) > MAX_CLIENT_ID:
            raise ProtocolError("a client identifier that is too long", Answer.IDENTIFIER_REJECTED)
        if self.passwords is not None and not self.passwords.matches(request.user, request.password):
            self._log(f"Client {_printable(request.user or '<unknown>')} disconnected, not authorised.")
            raise ProtocolError(f"{request.user} without its secret", Answer.NOT_AUTHORIZED)
        if sum(session.user == request.user for session in self.sessions.values()) >= self.limits.sessions_of_user:
            detail = f"{self.limits.sessions_of_user} sessions of {request.user} are the maximum"
            raise ProtocolError(detail, Answer.SERVER_UNAVAILABLE)
        if request.client_id not in self.sessions and len(self.sessions) >= self.limits.sessions:
            raise ProtocolError(f"{len(self.sessions)} sessions are the maximum", Answer.SERVER_UNAVAILABLE)
        if request.will is not None and not is_name(request.will.topic):
            raise ProtocolError(f"a will on {request.will.topic!r}")
        if request.will is not None and not self._may_write(request.user, request.will.topic):
            detail = f"{request.user} may not write its will to {request.will.topic}"
            raise ProtocolError(detail, Answer.NOT_AUTHORIZED)

    def turn_away(self, peer: object) -> None:
        """Note a connection beyond the maximum."""
        self.counters.note("too many connections", f"{self.limits.connections} are the maximum")
        where = peer[0] if isinstance(peer, tuple) else "unix-socket"
        self._log(f"Client connection from {where} denied: max_connections exceeded.")

    def _log(self, text: str) -> None:
        """Tell in Mosquitto's words what was refused, on its topic."""
        self.publish(Publish(BROKER_LOG, f"{int(time.time())}: {text}".encode()))

    def _may_write(self, user: str | None, topic: str) -> bool:
        return self.acl is None or self.acl.may_write(user, topic)

    def leave(self, session: Session, *, will: bool) -> None:
        """End a session; its will is published unless the client sent DISCONNECT."""
        if self.sessions.get(session.client_id) is session:
            del self.sessions[session.client_id]
        self._routes.clear()
        if will and session.will is not None:
            self.publish(session.will)

    def receive(self, message: Publish, session: Session) -> None:
        """Process a message of a client; an unauthorised one is dropped, as MQTT 3.1.1 has no code for it."""
        if not is_name(message.topic):
            raise ProtocolError(f"a message to {message.topic!r}")
        bounds = self._bounds(message.topic)
        if not self._may_write(session.user, message.topic):
            self.counters.note("not authorized", f"{session.user} may not write {message.topic}")
        elif bounds is not None and len(message.payload) > bounds.payload_bytes:
            self.counters.note("too large", f"{len(message.payload)} bytes of {session.user} on {message.topic}")
        else:
            may_be_kept = bounds is None or bounds.retain or not message.payload
            self.publish(message if may_be_kept else message._replace(retain=False))

    def publish(self, message: Publish) -> None:
        """Store a retained message, and send the message to its subscribers, encoded once."""
        if message.retain:
            self._retain(message)
        sample = Publish(message.topic, message.payload)
        frame = encode_publish(sample)
        for session, granted in self._routes_of(message.topic):
            if message.qos and granted:
                session.send(sample._replace(qos=1))
            else:
                session.send(sample, frame)

    def _retain(self, message: Publish) -> None:
        """Replace the retained message of a topic; an empty one deletes it."""
        before = self.retained.get(message.topic)
        size = self.retained_bytes + len(message.payload) - (len(before.payload) if before else 0)
        if not message.payload:
            self.retained.pop(message.topic, None)
        elif size <= self.limits.retained_bytes and (before or len(self.retained) < self.limits.retained):
            self.retained[message.topic] = message
        else:
            self.counters.note("retained full", message.topic)
            return
        self.retained_bytes = size

    def _routes_of(self, topic: str) -> list[Route]:
        """Receivers of a topic: each client once, with the highest QoS of its matching filters."""
        routes = self._routes.get(topic)
        if routes is None:
            if len(self._routes) >= REMEMBERED:
                self._routes.clear()
            routes = self._routes[topic] = []
            for session in self.sessions.values():
                granted = [qos for pattern, qos in session.subscriptions.items() if matches(pattern, topic)]
                if granted and self._may_read(session, topic):
                    routes.append((session, max(granted)))
        return routes

    def _may_read(self, session: Session, topic: str) -> bool:
        return self.acl is None or self.acl.may_read(session.user, topic)

    def subscribe(self, request: Subscribe, session: Session) -> tuple[bytes, list[Publish]]:
        """Add subscriptions; gives the QoS granted to each, and the retained messages to send after the answer."""
        granted = bytearray()
        kept: list[Publish] = []
        for pattern, qos in request.filters:
            refusal = self._refusal(pattern, session)
            if refusal:
                self.counters.note("subscription refused", f"{session.user} to {pattern!r}: {refusal}")
                granted.append(REFUSED)
                continue
            session.subscriptions[pattern] = qos
            granted.append(qos)
            kept += [
                message._replace(qos=min(message.qos, qos), packet_id=0)
                for topic, message in self.retained.items()
                if matches(pattern, topic) and self._may_read(session, topic)
            ]
        self._routes.clear()
        return bytes(granted), kept

    def _refusal(self, pattern: str, session: Session) -> str | None:
        if not is_filter(pattern) or pattern.startswith("$share/"):
            return "no filter"
        if pattern not in session.subscriptions and len(session.subscriptions) >= self.limits.subscriptions:
            return "too many subscriptions"
        if self.acl is not None and not self.acl.may_subscribe(session.user, pattern):
            return "not authorized"
        return None

    def unsubscribe(self, request: Unsubscribe, session: Session) -> None:
        """Remove subscriptions."""
        self._routes.clear()
        for pattern in request.filters:
            session.subscriptions.pop(pattern, None)


def _printable(text: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in text[:64])
