"""What our client writes a broker reads, and what it reads quickly means the same as what is read thoroughly."""

import contextlib

from hypothesis import given
from hypothesis import strategies as st

from shared.bus.mqtt import client_packets, packets, wire
from shared.bus.mqtt.client_packets import Delivery, decode_answer, decode_delivery, encode_connect, encode_subscribe
from shared.bus.mqtt.framing import Framer
from shared.bus.mqtt.packets import Connect, Disconnect, Publish, Subscribe, Subscription
from shared.bus.mqtt.properties import Properties, Property
from shared.bus.mqtt.wire import ProtocolError, Reader, Reason, in_words

texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=40)
users = st.dictionaries(texts, texts, max_size=5)
LIMIT = 1 << 20


def packet_of(frame: bytes) -> tuple[int, bytes]:
    (packet,) = Framer(LIMIT).feed(frame)
    return packet


@st.composite
def publishes(draw: st.DrawFn, user: dict[str, str]) -> Publish:
    qos = draw(st.sampled_from([0, 1]))
    return Publish(
        draw(texts), draw(st.binary(max_size=200)), qos, draw(st.booleans()),
        duplicate=bool(qos) and draw(st.booleans()), packet_id=draw(st.integers(1, 65_535)) if qos else 0,
        properties=b"".join(client_packets.user_property(k, v) for k, v in user.items()),
        expiry_s=draw(st.none() | st.integers(0, 2**32 - 1)),
    )  # fmt: skip


def thoroughly(first: int, body: bytes) -> Delivery | Reason:
    try:
        message = packets.decode_publish(first & 15, Reader(body))
    except ProtocolError as error:
        return error.reason
    user = dict(client_packets.user_properties(message.properties))
    return Delivery(message.topic, message.payload, user, message.qos, message.retain, message.packet_id)


def quickly(first: int, body: bytes) -> Delivery | Reason:
    try:
        return decode_delivery(first, body)
    except ProtocolError as error:
        return error.reason


@given(users.flatmap(lambda user: st.tuples(st.just(user), publishes(user))))
def test_a_message_arrives_with_its_user_properties(given_: tuple[dict[str, str], Publish]) -> None:
    user, message = given_
    delivery = decode_delivery(*packet_of(packets.encode_publish(message)))
    expected = Delivery(message.topic, message.payload, user, message.qos, message.retain, message.packet_id)
    assert delivery == expected


@given(users.flatmap(publishes), st.data())
def test_damaged_messages_are_judged_as_the_broker_would_judge_them(message: Publish, data: st.DataObject) -> None:
    first, whole = packet_of(packets.encode_publish(message))
    body = bytearray(whole)
    for _ in range(data.draw(st.integers(0, 3))):
        at = data.draw(st.integers(0, len(body) - 1))
        body[at] = data.draw(st.integers(0, 255))
    assert quickly(first, bytes(body)) == thoroughly(first, bytes(body))


@given(st.integers(0x30, 0x3F), st.binary(max_size=60))
def test_any_bytes_are_judged_as_the_broker_would_judge_them(first: int, body: bytes) -> None:
    assert quickly(first, body) == thoroughly(first, body)


def test_a_message_that_is_cut_at_any_byte_is_malformed_or_has_a_shorter_payload() -> None:
    properties = client_packets.user_property("from", "x") + client_packets.user_property("seq", "1")
    frame = packets.encode_publish(Publish("obu/car/imu/raw", b"payload", 1, packet_id=7, properties=properties))
    first, body = packet_of(frame)
    for cut in range(len(body)):
        outcome = quickly(first, body[:cut])
        if cut < len(body) - len(b"payload"):
            assert outcome is Reason.MALFORMED_PACKET, cut
        else:
            assert isinstance(outcome, Delivery) and b"payload".startswith(outcome.payload)


@given(texts, texts, st.none() | texts, st.none() | users.flatmap(publishes), st.integers(0, 65_535))
def test_the_broker_reads_our_wish_to_connect(
    client_id: str, user: str, password: str | None, will: Publish | None, keep_alive_s: int
) -> None:
    if will is not None:
        will = will._replace(duplicate=False, packet_id=0)
    wish = Connect(client_id, True, keep_alive_s, user, will, Properties({Property.RECEIVE_MAXIMUM: 100}))
    assert packets.decode(*packet_of(encode_connect(wish, password))) == wish


@given(
    st.integers(1, 65_535),
    st.lists(
        st.builds(Subscription, texts, st.integers(0, 2), st.booleans(), st.booleans(), st.integers(0, 2)), min_size=1
    ),
)
def test_the_broker_reads_our_subscriptions(packet_id: int, filters: list[Subscription]) -> None:
    request = packets.decode(*packet_of(encode_subscribe(packet_id, filters)))
    assert request == Subscribe(packet_id, tuple(filters), Properties())


@given(st.integers(0, 255).filter(lambda first: first >> 4 != 3), st.binary(max_size=60))
def test_no_bytes_of_a_broker_raise_anything_but_a_protocol_error(first: int, body: bytes) -> None:
    with contextlib.suppress(ProtocolError):  # which is what the client waits for
        decode_answer(first, body)


def test_a_farewell_of_the_broker_says_why() -> None:
    farewell = decode_answer(*packet_of(packets.encode_disconnect(Reason.SESSION_TAKEN_OVER)))
    assert isinstance(farewell, Disconnect)
    assert in_words(farewell.reason) == "session taken over"
    assert in_words(0xFE) == "reason code 0xfe"


@given(st.lists(st.binary(max_size=300), min_size=1, max_size=4), st.integers(0, 1500))
def test_one_packet_is_recognised_and_anything_else_is_left_to_the_framer(bodies: list[bytes], cut: int) -> None:
    stream = b"".join(bytes((0x30,)) + wire.varint(len(body)) + body for body in bodies)
    framer = Framer(LIMIT)
    part = stream[: len(stream) - cut] if cut < len(stream) else stream
    expected = list(Framer(LIMIT).feed(part))
    only = framer.only(part)
    if only is None:
        assert list(framer.feed(part)) == expected
    else:
        assert list(only) == expected
    assert Framer(10).only(b"\x30\x09" + bytes(9)) is None, "longer than what is taken"
