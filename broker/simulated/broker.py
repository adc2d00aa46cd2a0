"""The broker itself: sessions, subscriptions, retained messages and wills, without any input or output."""

from .access_list import Acl
from .counters import Counters
from .packets import REFUSED, Answer, Connect, ProtocolError, Publish, Subscribe, Unsubscribe, encode_publish
from .session import Limits, Session, Writer
from .topic_filters import is_filter, is_name, matches

LONGEST_CLIENT_ID = 256
REMEMBERED = 1_000  # topics
Route = tuple[Session, int]  # receiver of a topic, and QoS


class Broker:
    """State of the broker; each method is called with a packet that was decoded."""

    def __init__(self, acl: Acl | None = None, limits: Limits | None = None) -> None:
        self.acl = acl
        self.limits = limits or Limits()
        self.counters = Counters()
        self.sessions: dict[str, Session] = {}
        self.retained: dict[str, Publish] = {}
        self._routes: dict[str, list[Route]] = {}  # cached until a subscription changes
        self._assigned = 0

    def connect(self, request: Connect, writer: Writer) -> Session:
        """Begin a session; an existing one of the same name ends."""
        self._check(request)
        self._assigned += not request.client_id
        client_id = request.client_id or f"assigned-{self._assigned}"
        if client_id in self.sessions:
            self.sessions[client_id].writer.end()
        session = self.sessions[client_id] = Session(
            client_id, request.user, request.will, writer, self.limits, self.counters
        )
        return session

    def _check(self, request: Connect) -> None:
        if len(request.client_id) > LONGEST_CLIENT_ID:
            raise ProtocolError("a client identifier that is too long", Answer.IDENTIFIER_REJECTED)
        if request.client_id not in self.sessions and len(self.sessions) >= self.limits.sessions:
            raise ProtocolError(f"{len(self.sessions)} sessions are the maximum", Answer.SERVER_UNAVAILABLE)
        if request.will is not None and not is_name(request.will.topic):
            raise ProtocolError(f"a will on {request.will.topic!r}")
        if request.will is not None and not self._may_write(request.user, request.will.topic):
            detail = f"{request.user} may not write its will to {request.will.topic}"
            raise ProtocolError(detail, Answer.NOT_AUTHORIZED)

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
        if self._may_write(session.user, message.topic):
            self.publish(message)
        else:
            self.counters.note("not authorized", f"{session.user} may not write {message.topic}")

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
        if not message.payload:
            self.retained.pop(message.topic, None)
        elif message.topic in self.retained or len(self.retained) < self.limits.retained:
            self.retained[message.topic] = message
        else:
            self.counters.note("retained full", message.topic)

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
