"""The codec: what is written is read again, what another program writes is read, and no bytes do harm."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties as PahoProperties

from shared.bus.mqtt import packets, properties, wire
from shared.bus.mqtt.framing import Framer
from shared.bus.mqtt.packets import Connect, Publish, Subscribe, Subscription, Unsubscribe, UnsupportedVersion
from shared.bus.mqtt.properties import Properties, Property
from shared.bus.mqtt.wire import ProtocolError, Reader, Reason
from tests.support import raw_mqtt

texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=40)
pairs = st.lists(st.tuples(texts, texts), max_size=5)
LIMIT = 1 << 20


def passed_on(user: list[tuple[str, str]]) -> bytes:
    return b"".join(b"&" + wire.text(key) + wire.text(value) for key, value in user)


@st.composite
def publishes(draw: st.DrawFn) -> Publish:
    qos = draw(st.sampled_from([0, 1]))
    return Publish(
        topic=draw(texts),
        payload=draw(st.binary(max_size=300)),
        qos=qos,
        retain=draw(st.booleans()),
        duplicate=bool(qos) and draw(st.booleans()),
        packet_id=draw(st.integers(1, 65_535)) if qos else 0,
        properties=passed_on(draw(pairs)),
        expiry_s=draw(st.none() | st.integers(0, 2**32 - 1)),
    )


def only_packet(frame: bytes) -> packets.Packet:
    ((first, body),) = Framer(LIMIT).feed(frame)
    return packets.decode(first, body)


@given(publishes())
def test_a_message_survives_writing_and_reading(message: Publish) -> None:
    assert only_packet(packets.encode_publish(message)) == message


@given(st.integers(0, wire.LONGEST_VARINT))
def test_a_length_survives_writing_and_reading(value: int) -> None:
    encoded = wire.varint(value)
    assert len(encoded) == 1 + sum(value >= 128**power for power in (1, 2, 3))
    assert Reader(encoded).varint() == value


@pytest.mark.parametrize("encoded", [b"\x80\x00", b"\xff\xff\xff\xff\x00", b"\x80\x80\x80\x80\x01", b"\xff"])
def test_a_length_that_is_not_in_its_shortest_form_is_malformed(encoded: bytes) -> None:
    with pytest.raises(ProtocolError) as caught:
        Reader(encoded).varint()
    assert caught.value.reason == Reason.MALFORMED_PACKET


def test_a_length_beyond_four_bytes_is_not_written() -> None:
    with pytest.raises(ValueError, match="does not fit"):
        wire.varint(wire.LONGEST_VARINT + 1)


@given(
    st.fixed_dictionaries(
        {},
        optional={
            Property.SESSION_EXPIRY_S: st.integers(0, 2**32 - 1),
            Property.RECEIVE_MAXIMUM: st.integers(1, 65_535),
            Property.MAXIMUM_PACKET_SIZE: st.integers(1, 2**32 - 1),
            Property.REQUEST_PROBLEM_INFORMATION: st.integers(0, 1),
        },
    ),
    st.fixed_dictionaries({}, optional={Property.AUTHENTICATION_METHOD: texts}),
    pairs,
)
def test_properties_survive_writing_and_reading(
    numbers: dict[Property, int], words: dict[Property, str], user: list[tuple[str, str]]
) -> None:
    written = Properties(numbers, words, passed_on(user))
    assert properties.decode(Reader(properties.encode(written)), properties.ON_CONNECT) == written


@given(pairs, st.integers(0, 2**32 - 1), texts, st.binary(max_size=50), st.integers(0, 1))
def test_properties_that_paho_writes_are_read(
    user: list[tuple[str, str]], expiry_s: int, content_type: str, correlation: bytes, payload_format: int
) -> None:
    paho = PahoProperties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]  # paho leaves it untyped
    paho.UserProperty = user
    paho.MessageExpiryInterval = expiry_s
    paho.ContentType = content_type
    paho.CorrelationData = correlation
    paho.PayloadFormatIndicator = payload_format
    found = properties.decode(Reader(paho.pack()), properties.ON_PUBLISH)  # type: ignore[no-untyped-call]  # as above
    assert found.numbers == {Property.MESSAGE_EXPIRY_S: expiry_s, Property.PAYLOAD_FORMAT: payload_format}
    assert found.texts == {Property.CONTENT_TYPE: content_type}
    assert passed_on(user) in found.passed_on
    assert wire.binary(correlation) in found.passed_on


@pytest.mark.parametrize(
    ("encoded", "reason"),
    [
        ("03 21 0001", Reason.PROTOCOL_ERROR),  # receive maximum, not on PUBLISH
        ("0a 02 00000001 02 00000001", Reason.PROTOCOL_ERROR),  # the same twice
        ("02 01 02", Reason.PROTOCOL_ERROR),  # a flag of 2
        ("01 02", Reason.MALFORMED_PACKET),  # a value beyond the end
        ("02 02 00000001", Reason.MALFORMED_PACKET),  # a value beyond the length
        ("02 7f 01", Reason.PROTOCOL_ERROR),  # no such property
    ],
)
def test_properties_that_break_the_rules_are_refused(encoded: str, reason: Reason) -> None:
    with pytest.raises(ProtocolError) as caught:
        properties.decode(Reader(bytes.fromhex(encoded)), properties.ON_PUBLISH)
    assert caught.value.reason == reason


def test_connect_is_read_with_its_will_and_user() -> None:
    will_properties = b"\x05\x02\0\0\0\x09"
    body = (
        raw_mqtt.string("MQTT")
        + bytes.fromhex("05 ee 0005 05 11 0000003c")
        + raw_mqtt.string("core.fusion")
        + will_properties
        + raw_mqtt.string("health/core.fusion")
        + raw_mqtt.string("lost")
        + raw_mqtt.string("user")
        + raw_mqtt.string("password")
    )
    will = Publish("health/core.fusion", b"lost", 1, True, expiry_s=9)
    expected = Connect("core.fusion", True, 5, "user", will, Properties({Property.SESSION_EXPIRY_S: 60}))
    assert packets.decode(0x10, body) == expected


def test_subscribe_is_read_with_its_options() -> None:
    body = b"\0\7\0" + raw_mqtt.string("a/#") + b"\x2d" + raw_mqtt.string("b") + b"\x00"
    expected = (Subscription("a/#", 1, True, True, 2), Subscription("b"))
    assert packets.decode(0x82, body) == Subscribe(7, expected, properties.NONE)


def test_unsubscribe_is_read() -> None:
    assert packets.decode(0xA2, b"\0\7\0" + raw_mqtt.string("a/#")) == Unsubscribe(7, ("a/#",))


@given(st.integers(0, 255), st.binary(max_size=60))
def test_arbitrary_bytes_are_read_or_refused_and_nothing_else(first: int, body: bytes) -> None:
    try:
        packet = packets.decode(first, body)
    except (ProtocolError, UnsupportedVersion) as refused:
        assert str(refused)
    else:
        assert len(repr(packet)) < 400 + 5 * len(body)


@given(publishes(), st.data())
def test_a_packet_with_one_changed_byte_is_read_or_refused(message: Publish, data: st.DataObject) -> None:
    frame = bytearray(packets.encode_publish(message))
    frame[data.draw(st.integers(0, len(frame) - 1))] = data.draw(st.integers(0, 255))
    try:
        found = [packets.decode(first, body) for first, body in Framer(LIMIT).feed(bytes(frame))]
    except (ProtocolError, UnsupportedVersion) as refused:
        assert str(refused)
    else:
        assert sum(len(packet.payload) for packet in found if isinstance(packet, Publish)) <= len(frame)


@given(st.lists(publishes(), max_size=6), st.data())
def test_a_stream_gives_the_same_packets_however_it_is_cut(messages: list[Publish], data: st.DataObject) -> None:
    stream = b"".join(packets.encode_publish(message) for message in messages)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    framer = Framer(LIMIT)
    pieces = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    found = [packets.decode(first, body) for piece in pieces for first, body in framer.feed(piece)]
    assert found == messages


def test_a_packet_is_refused_by_its_announced_size_before_its_bytes_come() -> None:
    with pytest.raises(ProtocolError) as caught:
        list(Framer(1000).feed(b"\x30" + wire.varint(1000)))
    assert caught.value.reason == Reason.PACKET_TOO_LARGE
    assert list(Framer(1000).feed(b"\x30" + wire.varint(997) + bytes(997))) == [(0x30, bytes(997))]


@pytest.mark.parametrize(("level", "answer"), [(3, "20020001"), (4, "20020001"), (6, "2003008400")])
def test_an_older_client_is_refused_in_its_own_tongue(level: int, answer: str) -> None:
    assert packets.encode_refusal(level).hex() == answer
