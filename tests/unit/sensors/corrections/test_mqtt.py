"""The subscriber against the packets of the standard, and against rubbish."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.sensors.corrections.address import Address
from services.sensors.corrections.fault import SourceFault
from services.sensors.corrections.mqtt import PING_S, MqttDialogue

BROKER = Address(
    name="x", url="", scheme="mqtt", host="broker.example.org", port=1883, user="me", topics=("/pp/ip/eu", "keys")
)
GREETING = b"\x20\x02\x00\x00"
SUBACK = b"\x90\x04\x00\x01\x00\x00"


def publish(topic: bytes, content: bytes) -> bytes:
    body = len(topic).to_bytes(2, "big") + topic + content
    size, length = len(body), b""
    while size > 127:
        length, size = length + bytes((size & 127 | 128,)), size >> 7
    return b"\x30" + length + bytes((size,)) + body


def test_it_subscribes_after_the_greeting_and_gives_the_content_however_it_is_cut() -> None:
    dialogue = MqttDialogue(BROKER, "secret")
    request = dialogue.request()
    assert request[0] == 0x10 and b"\x00\x04MQTT\x04\xc2\x00\x3c" in request and request.endswith(b"\x00\x06secret")
    assert dialogue.answer(0.0) == b"" and dialogue.feed(GREETING) == b""
    assert dialogue.answer(0.0) == b"\x82\x15\x00\x01\x00\x09/pp/ip/eu\x00\x00\x04keys\x00"
    data = SUBACK + publish(b"/pp/ip/eu", b"x" * 300) + b"\xd0\x00" + publish(b"keys", b"yz")
    assert b"".join(dialogue.feed(data[at : at + 1]) for at in range(len(data))) == b"x" * 300 + b"yz"
    assert dialogue.answer(PING_S - 1) == b"" and dialogue.answer(PING_S) == b"\xc0\x00"


@pytest.mark.parametrize(
    ("answer", "words", "refused"),
    [
        (b"\x20\x02\x00\x04", "password_file", True),
        (b"\x20\x02\x00\x05", "certificate_file", True),
        (b"\x20\x02\x00\x03", "not available", False),
        (GREETING + b"\x90\x04\x00\x01\x00\x80", "topics", True),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "is no MQTT broker", False),
        (GREETING + b"\x30\xff\xff\xff\x7f", "over 64 kB", False),
        (GREETING + b"\x30\xff\xff\xff\xff\xff", "is no MQTT broker", False),
    ],
)
def test_what_a_broker_refuses_is_said_in_a_sentence(answer: bytes, words: str, refused: bool) -> None:
    with pytest.raises(SourceFault) as caught:
        MqttDialogue(BROKER, "secret").feed(answer)
    assert words in str(caught.value) and caught.value.refused is refused and "secret" not in str(caught.value)


@given(st.binary(max_size=400), st.booleans())
@settings(max_examples=60, deadline=None)
def test_any_bytes_end_in_content_or_in_a_sentence(data: bytes, greeted: bool) -> None:
    dialogue = MqttDialogue(BROKER, "")
    try:
        dialogue.feed((GREETING if greeted else b"") + data)
    except SourceFault as fault:
        assert str(fault).isprintable()
