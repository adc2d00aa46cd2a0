import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.errors import RejectedFrame
from shared.v2x import geonetworking
from tests.support.cases import each
from tests.support.v2x import cams

PAYLOAD = bytes.fromhex("0202000027")
PACKET = geonetworking.encode_packet(PAYLOAD, cams.SENDER)


def changed(place: int, value: int) -> bytes:
    return PACKET[:place] + bytes([value]) + PACKET[place + 1 :]


def test_the_payload_of_a_packet_is_found_and_padding_behind_it_is_not_part_of_it() -> None:
    assert geonetworking.decode_payload(PACKET) == PAYLOAD
    assert geonetworking.decode_payload(PACKET + bytes(20)) == PAYLOAD


@each(
    ("packet", "reason"),
    [
        (b"", "truncated"),
        (PACKET[:43], "truncated"),
        (PACKET[:-1], "truncated"),  # the payload length of the header says one byte more
        (changed(9, 3), "truncated"),  # a payload that is shorter than the BTP header
        (changed(0, 0x01), "geonetworking_version"),
        (changed(0, 0x21), "geonetworking_version"),
        (changed(0, 0x12), "network_header"),  # secured
        (changed(0, 0x10), "network_header"),
        (changed(5, 0x51), "packet_type"),  # multi-hop broadcast
        (changed(5, 0x40), "packet_type"),  # geographically scoped broadcast
        (changed(4, 0x10), "transport"),  # BTP-A
        (changed(41, 0xD2), "port"),  # 2002: DENM
    ],
)
def test_a_packet_that_is_no_unsecured_cam_is_rejected_with_its_reason(packet: bytes, reason: str) -> None:
    with pytest.raises(RejectedFrame) as rejected:
        geonetworking.decode_payload(packet)
    assert rejected.value.reason == reason


def test_the_byte_order_of_the_port_is_big_endian() -> None:
    assert PACKET[40:42] == bytes([0x07, 0xD1])
    with pytest.raises(RejectedFrame, match="port"):
        geonetworking.decode_payload(PACKET[:40] + bytes([0xD1, 0x07]) + PACKET[42:])


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=120), st.integers(0, 44))
def test_random_bytes_behind_a_valid_start_are_decoded_or_rejected(tail: bytes, keep: int) -> None:
    packet = PACKET[:keep] + tail
    try:
        assert len(geonetworking.decode_payload(packet)) <= len(packet) - geonetworking.PAYLOAD_AT
    except RejectedFrame as error:
        assert error.reason


@pytest.mark.parametrize(("speed_m_s", "code"), [(-0.01, 0x7FFF), (-500.0, 0x4000), (500.0, 0x3FFF), (0.0, 0)])
def test_the_speed_of_the_position_vector_is_signed_15_bits_and_saturates(speed_m_s: float, code: int) -> None:
    sender = geonetworking.PositionVector(bytes(6), 5, 0, 0.0, 0.0, False, speed_m_s, 0.0)
    (found,) = struct.unpack_from(">H", geonetworking.encode_packet(b"", sender), 32)
    assert found == code


def test_a_heading_just_below_a_full_turn_is_north() -> None:
    sender = geonetworking.PositionVector(bytes(6), 5, 0, 0.0, 0.0, True, 0.0, math.radians(359.97))
    assert geonetworking.encode_packet(b"", sender)[34:36] == bytes(2)
