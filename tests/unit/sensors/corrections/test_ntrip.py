"""Answers of casters, right and wrong, without a network."""

from base64 import b64encode

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.sensors.corrections.address import Address
from services.sensors.corrections.fault import SourceFault
from services.sensors.corrections.ntrip import MAX_HEADER, MAX_LINE, NtripDialogue, nearest_mounts
from tests.support.cases import each
from tests.support.gnss.frames import rtcm

CASTER = Address(name="x", url="", scheme="ntrip", host="caster.example.org", port=2101, mount="MOUNT", user="me")
DATA = rtcm(1005, 19) + rtcm(1077, 300)
OK = b"HTTP/1.1 200 OK\r\nNtrip-Version: Ntrip/2.0\r\nContent-Type: gnss/data\r\n"


def stream(answer: bytes, cut: int = 1, version: int = 2) -> bytes:
    dialogue = NtripDialogue(CASTER, "secret", version)
    return b"".join(dialogue.feed(answer[at : at + cut]) for at in range(0, len(answer), cut))


def chunked(data: bytes, size: int = 100) -> bytes:
    parts = [data[at : at + size] for at in range(0, len(data), size)]
    return b"".join(b"%x\r\n%b\r\n" % (len(part), part) for part in parts)


def fault(answer: bytes, version: int = 2) -> SourceFault:
    dialogue = NtripDialogue(CASTER, "secret", version)
    with pytest.raises(SourceFault) as caught:
        dialogue.feed(answer)
    assert "secret" not in str(caught.value)
    return caught.value


@each("cut", [1, 7, 10_000])
@each(
    "answer",
    [
        b"ICY 200 OK\r\n\r\n" + DATA,
        b"ICY 200 OK\r\n" + DATA,  # str2str
        b"ICY 200 OK\r\nServer: NtripCaster\r\n\r\n" + DATA,
        OK + b"\r\n" + DATA,
        OK + b"Transfer-Encoding: chunked\r\n\r\n" + chunked(DATA),
        b"HTTP/1.0 200 OK\n\n" + DATA,
    ],
)
def test_the_stream_begins_behind_the_answer_however_it_is_cut(answer: bytes, cut: int) -> None:
    assert stream(answer, cut) == DATA


def test_a_stream_of_spartn_without_a_blank_line_is_no_header() -> None:
    """It begins with the letter s."""
    data = b"s\x00\x42\xec" + DATA
    assert stream(b"ICY 200 OK\r\n" + data) == data


@pytest.mark.parametrize("version", [1, 2])
def test_the_request_names_the_mount_point_and_the_user(version: int) -> None:
    request = NtripDialogue(CASTER, "secret", version).request("$GPGGA,1*00\r\n").decode()
    lines = request.split("\r\n")
    assert lines[0] == f"GET /MOUNT HTTP/1.{version - 1}" and request.endswith("\r\n\r\n")
    assert f"Authorization: Basic {b64encode(b'me:secret').decode()}" in lines
    assert ("Ntrip-Version: Ntrip/2.0" in lines) is ("Ntrip-GGA: $GPGGA,1*00" in lines) is (version == 2)


@each(
    ("answer", "words", "refused"),
    [
        (b"HTTP/1.1 401 Unauthorized\r\n\r\n", "user or password", True),
        (b"ERROR - Bad Password\r\n", "user or password", True),
        (b"Error: login failed\r\n", "user or password", True),
        (b"ERROR - 401 Unauthorized\r\n", "user or password", True),
        (b"ERROR - account temporarily locked\r\n", "user or password", True),
        (b"ICY 401 Unauthorized\r\n\r\n", "user or password", True),
        (b"Unauthorized\r\n", "user or password", True),
        (OK + b"\r\nERROR - Bad Password\r\n", "user or password", True),
        (b"ICY 200 OK\r\n\r\nERROR - Mount Point Taken or Invalid\r\n", "does not know the mount point", True),
        (OK.replace(b"gnss/data", b"text/plain") + b"\r\nNo such stream\r\n", "does not know the mount point", True),
        (b"ERROR - Too many users\r\n", "the caster refuses: Too many users", False),
        (b"HTTP/1.1 403 Forbidden\r\n\r\n", "does not allow this user", True),
        (b"HTTP/1.1 404 Not Found\r\n\r\n", "does not know the mount point 'MOUNT'", True),
        (b"ERROR - Mount Point Invalid\r\n", "does not know the mount point", True),
        (
            b"HTTP/1.1 302 Found\r\nLocation: http://else.example.org/\r\n\r\n",
            "moved to http://else.example.org/",
            True,
        ),
        (OK.replace(b"gnss/data", b"text/html") + b"\r\n<html>", "wants you to log in", True),
        (b"HTTP/1.1 503 Busy\r\nRetry-After: 120\r\n\r\n", "overloaded", False),
        (b"SSH-2.0-OpenSSH_9.2\r\n", "is no NTRIP caster", False),
        (b"\x00" * (MAX_LINE + 2), "do not end", False),
        (b"HTTP/1.1 200 OK\r\nX: " + b"a" * (MAX_LINE + 2), "do not end", False),
        (b"HTTP/1.1 200 OK\r\n" + b"X: a\r\n" * MAX_HEADER, "do not end", False),
        (OK + b"Transfer-Encoding: chunked\r\n\r\n5\r\n123456\r\n", "longer than it states", False),
        (OK + b"Transfer-Encoding: chunked\r\n\r\n-5\r\n", "no valid size", False),
        (OK + b"Transfer-Encoding: chunked\r\n\r\nffffffff\r\n", "no valid size", False),
        (OK + b"Transfer-Encoding: chunked\r\n\r\n" + b"1" * 300, "no valid chunk", False),
        (OK + b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n", "ended the stream", False),
    ],
)
def test_what_is_no_stream_is_said_in_a_sentence(answer: bytes, words: str, refused: bool) -> None:
    found = fault(answer)
    assert words in str(found) and found.refused is refused


def test_a_refusal_without_an_empty_line_is_understood_when_the_caster_hangs_up() -> None:
    """As str2str sends it."""
    dialogue = NtripDialogue(CASTER, "secret", 2)
    assert dialogue.feed(b"HTTP/1.0 401 Unauthorized\r\n") == b""
    found = dialogue.ended(SourceFault("closed"))
    assert found.refused and "user or password" in str(found)


def test_a_busy_caster_says_when_to_come_again() -> None:
    assert fault(b"HTTP/1.1 503 Busy\r\nRetry-After: 120\r\n\r\n").wait_s == 120.0
    assert fault(b"HTTP/1.1 429 Slow\r\nRetry-After: 99999999\r\n\r\n").wait_s == 60.0
    assert fault(b"HTTP/1.1 429 Slow\r\nRetry-After: 0\r\n\r\n").wait_s == 10.0


TABLE = b"\r\n".join(
    b"STR;%b;Town;RTCM 3.2;1077(1);2;GPS;NET;DEU;%.2f;%.2f;0;0;x;none;B;N;9600;" % (name, north, east)
    for name, north, east in ((b"MUNICH0", 48.1, 11.6), (b"BERLIN0", 52.5, 13.4), (b"M0UNT", 0.0, 0.0))
)


def test_a_source_table_in_place_of_a_stream_names_the_mount_points_near_to_it() -> None:
    found = fault(b"SOURCETABLE 200 OK\r\nServer: x\r\n\r\n" + TABLE + b"\r\nENDSOURCETABLE\r\n", version=1)
    assert "does not know the mount point 'MOUNT'; near to it are M0UNT" in str(found) and found.refused
    head = OK.replace(b"gnss/data", b"gnss/sourcetable") + b"Transfer-Encoding: chunked\r\n\r\n"
    assert "M0UNT" in str(fault(head + chunked(TABLE + b"\r\nENDSOURCETABLE\r\n")))
    assert "its list is empty" in str(fault(b"SOURCETABLE 200 OK\r\n\r\nENDSOURCETABLE\r\n"))
    assert "near to it are MNT" in str(fault(b"SOURCETABLE 200 OK\r\n\r\nSTR;MNT;\r\nENDSOURCETABLE\r\n"))  # str2str


TABLE_WITH_END = TABLE + b"\r\nENDSOURCETABLE\r\n"


@each("cut", [1, 7, 10_000])
@each(
    "answer",
    [
        OK.replace(b"gnss/data", b"gnss/sourcetable") + b"Content-Length: 9\r\n" + TABLE_WITH_END,
        OK.replace(b"gnss/data", b"text/plain") + b"\r\n" + TABLE_WITH_END,
        OK.replace(b"gnss/data", b"text/html") + b"\r\n" + TABLE_WITH_END,
        OK + b"\r\n\r\nCAS;else.example.org;2101;\r\n" + TABLE_WITH_END,
        OK + b"Transfer-Encoding: chunked\r\n\r\n" + chunked(TABLE) + b"0\r\n\r\n",
        b"ICY 200 OK\r\n" + TABLE_WITH_END,
        b"ICY 200 OK\r\nServer: x\r\n\r\nSOURCETABLE 200 OK\r\n\r\n" + TABLE_WITH_END,
        TABLE_WITH_END,
        TABLE,
    ],
)
def test_a_source_table_is_told_by_its_lines_whatever_it_is_called(answer: bytes, cut: int) -> None:
    dialogue, given = NtripDialogue(CASTER, "secret", 2), b""
    with pytest.raises(SourceFault, match="does not know the mount point 'MOUNT'; near to it are M0UNT"):
        for at in range(0, len(answer), cut):
            given += dialogue.feed(answer[at : at + cut])
        raise dialogue.ended(SourceFault("closed"))
    assert not given and not dialogue.streaming


@pytest.mark.parametrize("answer", [b"ERROR - Bad Password", b"HTTP/1.0 401 Unauthorized", b"ICY 401 Unauthorized\r\n"])
def test_a_refusal_without_a_line_end_is_understood_when_the_caster_hangs_up(answer: bytes) -> None:
    dialogue = NtripDialogue(CASTER, "secret", 1)
    assert dialogue.feed(answer) == b""
    found = dialogue.ended(SourceFault("closed"))
    assert found.refused and "user or password" in str(found) and "is it an NTRIP caster" not in str(found)


def test_a_stream_that_waits_for_a_position_is_one_before_its_first_byte() -> None:
    dialogue = NtripDialogue(CASTER, "", 2)
    assert dialogue.feed(OK + b"\r\n") == b"" and dialogue.streaming


def test_stations_near_the_vehicle_follow_those_with_a_similar_name() -> None:
    assert nearest_mounts(TABLE, "MOUNT", (52.0, 13.0)) == ["M0UNT", "BERLIN0", "MUNICH0"]
    assert nearest_mounts(TABLE, "xyz", (48.0, 11.0))[0] == "MUNICH0"


def test_a_caster_of_version_1_that_hangs_up_is_asked_again_in_version_1() -> None:
    assert NtripDialogue(CASTER, "", 2).ended(SourceFault("closed")).older
    assert not NtripDialogue(CASTER, "", 1).ended(SourceFault("closed")).older
    assert fault(b"HTTP/1.0 400 Bad Request\r\n\r\n").older


@given(st.lists(st.binary(max_size=300), max_size=12), st.sampled_from([b"", b"ICY 200 OK\r\n", OK, OK + b"\r\n"]))
@settings(max_examples=60, deadline=None)
def test_any_bytes_end_in_a_stream_or_in_a_sentence(parts: list[bytes], head: bytes) -> None:
    dialogue = NtripDialogue(CASTER, "", 2)
    try:
        for part in [head, *parts]:
            dialogue.feed(part)
    except SourceFault as found:
        assert str(found).isprintable() and len(str(found)) < 400
