"""Who receives a message: each client once, however many of its filters take the topic."""

from collections.abc import Iterable
from typing import NamedTuple

from .acl import Acl
from .session import Session
from .topics import matches

REMEMBERED = 1_000  # topics


class Route(NamedTuple):
    """One receiver; QoS -1 where it wants nothing."""

    session: Session
    qos: int
    qos_of_own: int  # for messages that it sent itself
    retain_as_published: bool


class Routes:
    """Receivers of each topic, remembered until a subscription changes."""

    def __init__(self, acl: Acl | None) -> None:
        self._acl = acl
        self._known: dict[str, tuple[Route, ...]] = {}

    def forget(self) -> None:
        """Take note that a subscription, a user or a session has changed."""
        self._known.clear()

    def of(self, topic: str, sessions: Iterable[Session]) -> tuple[Route, ...]:
        """List the receivers of a topic."""
        routes = self._known.get(topic)
        if routes is None:
            if len(self._known) >= REMEMBERED:
                self._known.clear()
            found = (self._route(session, topic) for session in sessions)
            routes = self._known[topic] = tuple(route for route in found if route is not None)
        return routes

    def _route(self, session: Session, topic: str) -> Route | None:
        taking = [s for s in session.subscriptions.values() if matches(s.pattern, topic)]
        if not taking or (self._acl is not None and not self._acl.may_read(session.user, topic)):
            return None
        return Route(
            session,
            max(s.qos for s in taking),
            max((s.qos for s in taking if not s.no_local), default=-1),
            any(s.retain_as_published for s in taking),
        )
