"""The quick way to open a message gives what the thorough way gives, whatever came before."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.bus.envelope import Envelope, Opener
from shared.bus.mqtt.client_packets import user_property
from shared.bus.mqtt.framing import Framer
from shared.bus.mqtt.packets import Publish, encode_publish
from shared.bus.mqtt.wire import ProtocolError, Reason

TOPICS = ("obu/car/imu/raw", "obu/car/imu/sample", "obu/car/health/core.fusion", "obu/car/no/topic")
numbers = st.one_of(st.integers(-5, 2**63).map(str), st.sampled_from(["", "x", "007", "٣", "9" * 30]))


@st.composite
def bodies(draw: st.DrawFn) -> tuple[int, bytes]:
    user = {
        "from": draw(st.sampled_from(["a", "b"])),
        "life": draw(st.sampled_from(["1", "2", "x"])),
        "seq": draw(numbers),
    }
    if draw(st.booleans()):
        user |= {"received_ns": draw(numbers), "source": draw(st.sampled_from(["imu", "ü"]))}
    if draw(st.integers(0, 9)) == 0:
        user = dict(draw(st.permutations(sorted(user.items()))))
        user.pop(draw(st.sampled_from(sorted(user))))
    qos = draw(st.sampled_from([0, 0, 0, 1]))
    properties = b"".join(user_property(key, value) for key, value in user.items())
    message = Publish(
        draw(st.sampled_from(TOPICS)), draw(st.binary(max_size=30)), qos, draw(st.booleans()), packet_id=qos,
        properties=properties, expiry_s=draw(st.sampled_from([None, None, 30])),
    )  # fmt: skip
    ((first, body),) = Framer(1 << 20).feed(encode_publish(message))
    if draw(st.integers(0, 4)) == 0:
        damaged = bytearray(body)
        damaged[draw(st.integers(0, len(body) - 1))] = draw(st.integers(0, 255))
        body = bytes(damaged[: draw(st.integers(len(body) // 2, len(body)))])
    return first, body


def outcome(opener: Opener, first: int, body: bytes) -> Envelope | Reason | None:
    try:
        return opener(first, body)
    except ProtocolError as error:
        return error.reason


def opener() -> Opener:
    return Opener("obu/car/", lambda: 42)


@given(st.lists(bodies(), min_size=2, max_size=12))
def test_what_came_before_does_not_change_what_a_message_says(stream: list[tuple[int, bytes]]) -> None:
    experienced = opener()
    for first, body in stream:
        assert outcome(experienced, first, body) == outcome(opener(), first, body)


@pytest.mark.parametrize("retain", [False, True])
def test_the_numbers_of_like_messages_are_their_own(retain: bool) -> None:
    one = opener()
    for sequence in (*range(8, 13), 99, 100, 7):
        user = {"from": "sensors.imu", "life": "5", "seq": str(sequence), "received_ns": str(10**18 + sequence)}
        properties = b"".join(user_property(k, v) for k, v in (user | {"source": "imu"}).items())
        packet = encode_publish(Publish("obu/car/imu/raw", b"x" * sequence, retain=retain, properties=properties))
        ((first, body),) = Framer(1 << 20).feed(packet)
        expected = Envelope(
            "imu/raw", b"x" * sequence, {"received_ns": str(10**18 + sequence), "source": "imu"}, 42,
            "sensors.imu", 5, sequence, retain,
        )  # fmt: skip
        assert one(first, body) == expected
    assert len(one._forms) == 1
