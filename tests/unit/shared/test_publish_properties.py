"""Our encoding of a message's properties against paho's own, which stays the oracle."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from paho.mqtt import _packet
from paho.mqtt.client import MQTTv5
from paho.mqtt.enums import MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from shared.publish_properties import PublishProperties, use_for_received_messages

TEXT = st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=40)
USER = st.dictionaries(TEXT, TEXT, max_size=8)
EXPIRY_S = st.none() | st.integers(1, 2**32 - 1)


def by_paho(user: dict[str, str], expiry_s: int | None) -> Properties:
    properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]  # paho leaves it untyped
    if user:
        properties.UserProperty = list(user.items())
    if expiry_s:
        properties.MessageExpiryInterval = expiry_s
    return properties


def packed(properties: Properties) -> bytes:
    encoded: bytes = properties.pack()  # type: ignore[no-untyped-call]  # paho leaves it untyped
    return encoded


@given(USER, EXPIRY_S)
def test_what_is_sent_is_what_paho_would_send(user: dict[str, str], expiry_s: int | None) -> None:
    assert PublishProperties(user, expiry_s).pack() == packed(by_paho(user, expiry_s))


@given(USER, EXPIRY_S, st.binary(max_size=20))
def test_what_is_received_is_what_was_sent(user: dict[str, str], expiry_s: int | None, payload: bytes) -> None:
    encoded = packed(by_paho(user, expiry_s))
    properties, length = PublishProperties().unpack(encoded + payload)
    assert length == len(encoded)
    assert dict(getattr(properties, "UserProperty", ())) == user
    assert getattr(properties, "MessageExpiryInterval", None) == expiry_s


def test_properties_that_the_unit_does_not_send_are_left_to_paho() -> None:
    foreign = by_paho({"from": "elsewhere"}, 7)
    foreign.ContentType = "application/json"
    properties, _ = PublishProperties().unpack(packed(foreign))
    expected = {"ContentType": "application/json", "UserProperty": [("from", "elsewhere")], "MessageExpiryInterval": 7}
    assert expected.items() <= vars(properties).items()


@pytest.mark.parametrize("cut", range(1, 12))
def test_cut_properties_are_refused(cut: int) -> None:
    whole = PublishProperties({"from": "x", "seq": "1"}).pack()
    with pytest.raises(_packet.DECODE_ERRORS):
        PublishProperties().unpack(whole[:-cut])


def test_paho_decodes_received_messages_with_it() -> None:
    use_for_received_messages()
    topic, encoded = b"obu/x/gnss/raw", PublishProperties({"seq": "5"}).pack()
    packet = struct.pack("!H", len(topic)) + topic + encoded + b"payload"
    message = _packet.decode_publish(0x30, packet, MQTTProtocolVersion(MQTTv5))
    assert isinstance(message.properties, PublishProperties)
    assert vars(message.properties)["UserProperty"] == [("seq", "5")]
    assert message.payload == b"payload"
