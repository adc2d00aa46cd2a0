"""What one client of the simulated broker can take from the others: sessions, kept bytes, sizes, turns."""

import pytest

from broker.contract import Bounds
from broker.passwords import Passwords, line
from broker.simulated.broker import Broker
from broker.simulated.packets import Answer, Connect, ProtocolError, Publish, Subscribe
from broker.simulated.session import Limits, Session


class StoredMessages:
    """Stores what is written."""

    writable = True

    def __init__(self) -> None:
        self.frames: list[bytes] = []
        self.ended = False

    def write(self, frame: bytes) -> None:
        self.frames.append(frame)

    def end(self, *, will: bool = True) -> None:
        self.ended = True


def connect(broker: Broker, client_id: str, user: str | None = "a", password: str | None = None) -> Session:
    return broker.connect(Connect(client_id, True, 60, user, None, password), StoredMessages())


def test_one_user_has_so_many_sessions_and_others_are_served() -> None:
    broker = Broker(limits=Limits(sessions_of_user=3))
    for number in range(3):
        connect(broker, f"c{number}")
    with pytest.raises(ProtocolError) as refused:
        connect(broker, "c3")
    assert refused.value.answer is Answer.SERVER_UNAVAILABLE
    connect(broker, "other", "b")


def test_with_passwords_the_user_is_the_session_and_its_secret_is_asked_for() -> None:
    broker = Broker(passwords=Passwords(line("a", "secret")))
    first = connect(broker, "one", "a", "secret")
    assert first.client_id == "a"
    second = connect(broker, "two", "a", "secret")
    assert isinstance(first.writer, StoredMessages) and first.writer.ended and broker.sessions == {"a": second}
    for user, password in (("a", "guess"), ("a", None), ("b", "secret"), (None, None)):
        with pytest.raises(ProtocolError) as refused:
            connect(broker, "three", user, password)
        assert refused.value.answer is Answer.NOT_AUTHORIZED
    assert broker.sessions == {"a": second}, "who is refused ends nobody's session"


def test_kept_messages_take_no_more_than_their_share() -> None:
    broker = Broker(limits=Limits(retained_bytes=1000), bounds=lambda _: None)
    session = connect(broker, "c")
    for number in range(10):
        broker.receive(Publish(f"t/{number}", bytes(300), retain=True), session)
    assert len(broker.retained) == 3 and broker.retained_bytes == 900
    assert broker.counters.counts["retained full"] == 7
    broker.receive(Publish("t/0", bytes(100), retain=True), session)
    assert broker.retained_bytes == 700
    broker.receive(Publish("t/0", b"", retain=True), session)
    broker.receive(Publish("t/9", bytes(300), retain=True), session)
    assert broker.retained_bytes == 900 and set(broker.retained) == {"t/1", "t/2", "t/9"}


def test_a_topic_has_a_size_and_says_whether_it_is_kept() -> None:
    broker = Broker(bounds=lambda topic: Bounds(100, retain=topic == "kept"))
    session, listener = connect(broker, "c"), connect(broker, "l", "b")
    broker.subscribe(Subscribe(1, (("#", 0),)), listener)
    broker.receive(Publish("kept", bytes(101), retain=True), session)
    assert not broker.retained and broker.counters.counts["too large"] == 1
    broker.receive(Publish("kept", bytes(100), retain=True), session)
    broker.receive(Publish("passing", bytes(100), retain=True), session)
    assert set(broker.retained) == {"kept"}
    assert isinstance(listener.writer, StoredMessages) and len(listener.writer.frames) == 2, "both were delivered"
