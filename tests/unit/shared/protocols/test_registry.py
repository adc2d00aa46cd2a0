"""The registry of protocols: none begins like another, and every reason of a reject has a meaning and a remedy."""

import re
from itertools import combinations

import pytest

from shared.protocols import nmea, text, ubx, undecoded
from shared.protocols.framing.framing import can_begin_alike
from shared.protocols.protocol import Protocol
from shared.protocols.registry import PROTOCOLS, check, read_at
from shared.rejects import PARTS, reason_of
from tests.support.cases import each


class DollarFraming(text.LineFraming):
    """A protocol that takes every dollar sign for its own, as NMEA was once framed."""

    protocol, begins, starts = "dollar", ((b"$",),), rb"\$[ -~]+\n"


def test_two_protocols_that_can_begin_alike_are_an_error() -> None:
    with pytest.raises(ValueError, match="NMEA and dollar can begin alike"):
        check([*PROTOCOLS, Protocol(DollarFraming(), "dollar")])
    with pytest.raises(ValueError, match="two protocols have the name UBX"):
        check([*PROTOCOLS, ubx.PROTOCOL])
    assert not any(can_begin_alike(a.framing, b.framing) for a, b in combinations(PROTOCOLS, 2))


def test_blocks_of_sbf_and_sentences_begin_with_a_dollar_sign_and_are_told_apart() -> None:
    sbf = undecoded.SbfFraming()
    assert not nmea.PROTOCOL.framing.sync.match(b"$@") and sbf.sync.match(b"$@")
    assert not can_begin_alike(sbf, nmea.PROTOCOL.framing)


@each("protocol", PROTOCOLS)
def test_what_a_framing_rejects_has_a_reason(protocol: Protocol) -> None:
    framing = protocol.framing
    stated = {framing.malformed, framing.too_long, framing.bad_header} - {None, ""}
    assert stated <= protocol.reasons.keys()
    assert all(reason.meaning and reason.remedy for reason in protocol.reasons.values())


@each("protocol", PROTOCOLS)
def test_headers_begin_as_the_registry_says(protocol: Protocol) -> None:
    """All one- to three-byte beginnings that the pattern of headers refuses at once are refused by `begins` too."""
    framing = protocol.framing
    if not framing.begins:
        assert protocol is text.LINES, "only lines of text claim what no other protocol does"
        return
    if framing.begun:
        begun = re.compile(framing.begun)
        for beginning in framing.begins:
            assert begun.fullmatch(bytes(place[0] for place in beginning)), framing.begun
    for first in range(256):
        head = bytes([first]) + bytes(40)
        assert not re.compile(framing.starts).match(head) or framing.sync.match(head)


def test_every_protocol_is_read_somewhere_or_says_what_to_switch_on() -> None:
    assert all(protocol.read_at or protocol.remedy for protocol in PROTOCOLS)
    assert (read_at("gnss"), read_at("imu")) == (("UBX", "NMEA", "GnssLogger"), ("Xbus", "text lines"))


def test_the_table_has_no_reason_twice() -> None:
    kinds = [kind for reasons in PARTS.values() for kind in reasons]
    assert len(kinds) == len(set(kinds))
    assert reason_of("no such reason") is None
