"""The broker itself: sessions, subscriptions, retained messages and wills, without any input or output."""

import time
from collections.abc import Callable
from dataclasses import replace

from shared.bus.mqtt.packets import Connect, Publish, Subscribe, Subscription, Unsubscribe, encode_publish
from shared.bus.mqtt.properties import Property
from shared.bus.mqtt.wire import ProtocolError, Reason

from .acl import Acl
from .retained import Kept, Retained
from .routing import Routes
from .session import Delivery, Limits, Session, Writer
from .tally import Tally
from .topics import is_filter, is_name

LONGEST_CLIENT_ID = 256


class Broker:
    """State of the broker; each method is called with a packet that was decoded."""

    def __init__(
        self, acl: Acl | None = None, limits: Limits | None = None, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self.acl = acl
        self.limits = limits or Limits()
        self.tally = Tally()
        self.sessions: dict[str, Session] = {}
        self.retained = Retained(self.limits.retained)
        self.now_s = now_s
        self._routes = Routes(acl)
        self._assigned = 0

    def connect(self, request: Connect, writer: Writer) -> tuple[Session, bool]:
        """Begin or take up a session; the second value says whether there was one. The caller answers, then resumes."""
        client_id = request.client_id or self._assign()
        self._check(request, client_id)
        session = self.sessions.get(client_id)
        if session is not None and session.writer is not None:
            session.writer.end(Reason.SESSION_TAKEN_OVER)
            session = self.sessions.get(client_id)
        if session is not None and (request.clean_start or self._ended(session)):
            del self.sessions[client_id]
            session = None
        present = session is not None
        if session is None:
            session = self.sessions[client_id] = Session(client_id, self.limits, self.tally)
        numbers = request.properties.numbers
        session.user, session.will, session.writer, session.ends_s = request.user, request.will, writer, None
        session.expiry_s = min(numbers.get(Property.SESSION_EXPIRY_S, 0), self.limits.session_expiry_s)
        session.window = min(numbers.get(Property.RECEIVE_MAXIMUM, 65_535), self.limits.in_flight)
        session.packet_bytes = numbers.get(Property.MAXIMUM_PACKET_SIZE, 268_435_460)
        self._routes.forget()
        return session, present

    def _assign(self) -> str:
        self._assigned += 1
        return f"assigned-{self._assigned}"

    def _check(self, request: Connect, client_id: str) -> None:
        if len(client_id) > LONGEST_CLIENT_ID:
            raise ProtocolError(Reason.QUOTA_EXCEEDED, "a client identifier that is too long")
        if client_id not in self.sessions and len(self.sessions) >= self.limits.sessions:
            raise ProtocolError(Reason.QUOTA_EXCEEDED, f"{len(self.sessions)} sessions are enough")
        if Property.AUTHENTICATION_METHOD in request.properties.texts:
            raise ProtocolError(Reason.BAD_AUTHENTICATION_METHOD, "no authentication method is known")
        if request.will is not None and not is_name(request.will.topic):
            raise ProtocolError(Reason.TOPIC_NAME_INVALID, "the topic of the will")
        if request.will is not None and not self._may_write(request.user, request.will.topic):
            raise ProtocolError(Reason.NOT_AUTHORIZED, f"{request.user} may not write its will to {request.will.topic}")

    def _may_write(self, user: str | None, topic: str) -> bool:
        return self.acl is None or self.acl.may_write(user, topic)

    def _ended(self, session: Session) -> bool:
        return session.ends_s is not None and session.ends_s <= self.now_s()

    def leave(self, session: Session, *, will: bool) -> None:
        """Note that the connection of a session is gone; its will goes out unless the client took leave."""
        session.writer = None
        if session.expiry_s == 0:
            self._forget(session)
        else:
            session.ends_s = self.now_s() + session.expiry_s
        testament, session.will = session.will, None
        if will and testament is not None:
            self.publish(testament, session)

    def _forget(self, session: Session) -> None:
        if self.sessions.get(session.client_id) is session:
            del self.sessions[session.client_id]
        self._routes.forget()

    def receive(self, message: Publish, session: Session) -> Reason:
        """Take a message from a client; the reason code is for its acknowledgement."""
        if not is_name(message.topic):
            raise ProtocolError(Reason.TOPIC_NAME_INVALID, f"a message to {message.topic!r}")
        if not self._may_write(session.user, message.topic):
            self.tally.note("not authorized", f"{session.user} may not write {message.topic}")
            return Reason.NOT_AUTHORIZED
        if message.retain and not self.retained.takes(message.topic):
            self.tally.note("retained full", message.topic)
            return Reason.QUOTA_EXCEEDED
        self.publish(message, session)
        return Reason.SUCCESS

    def publish(self, message: Publish, origin: Session) -> None:
        """Keep a message where it is retained, and send it to everyone who wants it, encoded once."""
        now_s = self.now_s()
        deadline_s = None if message.expiry_s is None else now_s + message.expiry_s
        if message.retain:
            self._keep(Kept(message, deadline_s, origin.client_id))
        copies: dict[tuple[int, bool], Delivery] = {}
        for route in self._routes.of(message.topic, self.sessions.values()):
            granted = route.qos_of_own if route.session is origin else route.qos
            if granted < 0:
                continue
            form = min(message.qos, granted), message.retain and route.retain_as_published
            delivery = copies.get(form)
            if delivery is None:
                delivery = copies[form] = _delivery(message, form, deadline_s)
            route.session.send(delivery, now_s)

    def _keep(self, kept: Kept) -> None:
        """Keep a message where there is room: a will has nobody left to whom it could be refused."""
        if self.retained.takes(kept.message.topic):
            self.retained.keep(kept)
        else:
            self.tally.note("retained full", kept.message.topic)

    def subscribe(self, request: Subscribe, session: Session) -> tuple[list[int], list[Kept]]:
        """Add subscriptions; gives their reason codes and the retained messages to send after the answer."""
        if Property.SUBSCRIPTION_IDENTIFIER in request.properties.numbers:
            raise ProtocolError(Reason.SUBSCRIPTION_IDENTIFIERS_NOT_SUPPORTED, "a subscription identifier")
        reasons: list[int] = []
        kept: list[Kept] = []
        for wanted in request.subscriptions:
            refusal = self._refusal(wanted, session)
            if refusal is not None:
                self.tally.note("subscription refused", f"{session.user} to {wanted.pattern!r}: {refusal.name}")
                reasons.append(refusal)
                continue
            granted = replace(wanted, qos=min(wanted.qos, 1))
            new = granted.pattern not in session.subscriptions
            session.subscriptions[granted.pattern] = granted
            reasons.append(granted.qos)
            if granted.retain_handling == 0 or (granted.retain_handling == 1 and new):
                kept += self._retained_for(granted, session)
        self._routes.forget()
        return reasons, kept

    def _refusal(self, wanted: Subscription, session: Session) -> Reason | None:
        if not is_filter(wanted.pattern):
            return Reason.TOPIC_FILTER_INVALID
        if wanted.pattern.startswith("$share/"):
            return Reason.SHARED_SUBSCRIPTIONS_NOT_SUPPORTED
        if wanted.pattern not in session.subscriptions and len(session.subscriptions) >= self.limits.subscriptions:
            return Reason.QUOTA_EXCEEDED
        if self.acl is not None and not self.acl.may_subscribe(session.user, wanted.pattern):
            return Reason.NOT_AUTHORIZED
        return None

    def _retained_for(self, wanted: Subscription, session: Session) -> list[Kept]:
        return [
            kept._replace(message=kept.message._replace(qos=min(kept.message.qos, wanted.qos), duplicate=False))
            for kept in self.retained.matching(wanted.pattern, self.now_s())
            if (self.acl is None or self.acl.may_read(session.user, kept.message.topic))
            and not (wanted.no_local and kept.client_id == session.client_id)
        ]

    def unsubscribe(self, request: Unsubscribe, session: Session) -> list[int]:
        """Remove subscriptions; gives their reason codes."""
        self._routes.forget()
        return [
            Reason.SUCCESS if session.subscriptions.pop(pattern, None) else Reason.NO_SUBSCRIPTION_EXISTED
            for pattern in request.patterns
        ]

    def sweep(self) -> None:
        """Forget sessions and retained messages whose time is over; called about once a second."""
        self.retained.sweep(self.now_s())
        for session in [s for s in self.sessions.values() if self._ended(s)]:
            self._forget(session)


def _delivery(message: Publish, form: tuple[int, bool], deadline_s: float | None) -> Delivery:
    qos, retain = form
    copy = message._replace(qos=qos, retain=retain, duplicate=False, packet_id=0)
    return Delivery(copy, deadline_s, encode_publish(copy) if qos == 0 and deadline_s is None else b"")
