"""Requests of the gpsd protocol."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.monitoring.outputs import gpsd_reports
from services.monitoring.outputs.gpsd_session import MAX_ERRORS, MAX_REQUEST, BadClient, Session, SharedReports


def session() -> Session:
    return Session(SharedReports(1_700_000_000_000_000_000, lambda: 1_700_000_001_000_000_000))


def ask(client: Session, text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in client.answer(text.encode()).split(b"\r\n") if line]


def classes(client: Session, text: str) -> list[str]:
    return [answer["class"] for answer in ask(client, text)]


def test_the_greeting_is_the_version() -> None:
    assert json.loads(session().greeting())["class"] == "VERSION"


@pytest.mark.parametrize("end", [";", "\n", "\r\n", ";\r\n"])
def test_a_request_ends_with_a_semicolon_or_a_line(end: str) -> None:
    assert classes(session(), f"?VERSION{end}?DEVICES{end}?DEVICE{end}?WATCH{end}?POLL{end}") == [
        "VERSION", "DEVICES", "DEVICE", "DEVICES", "WATCH", "POLL",
    ]  # fmt: skip


def test_a_request_may_come_in_pieces() -> None:
    client = session()
    assert classes(client, '?WATCH={"enable":true,"js') == []
    assert client.pause() == b""
    assert classes(client, 'on":true}') == ["DEVICES", "WATCH"]
    assert classes(client, ";") == []
    assert client.wants_json


def test_a_closed_argument_ends_a_request() -> None:
    client = session()
    assert classes(client, '?WATCH={"enable":true,"json":true}') == ["DEVICES", "WATCH"]
    assert client.wants_json
    assert classes(client, '?DEVICE={"path":"obu"}?WATCH={"enable":false}') == ["DEVICE", "DEVICES", "WATCH"]
    assert not client.wants_json
    assert classes(client, '?DEVICE={"path":"a}\\"b}') == []  # the braces are in a string
    assert classes(client, '"}') == ["ERROR"]


@pytest.mark.parametrize("name", ["VERSION", "DEVICES", "DEVICE", "WATCH", "POLL"])
def test_a_pause_ends_a_request_without_an_argument(name: str) -> None:
    client, answer = session(), {"WATCH": ["DEVICES", "WATCH"]}.get(name, [name])
    assert classes(client, f"?{name[:3]}") == [] and client.pause() == b""
    assert classes(client, name[3:]) == []
    assert [json.loads(line)["class"] for line in client.pause().split()] == answer
    assert client.pause() == b"" and classes(client, ";\r\n") == []  # it is answered once
    assert classes(client, f"?{name};") == answer
    assert classes(client, f"?{name}") == [] and client.pause()
    assert classes(client, "?VERSION;") == ["VERSION"]


def test_what_comes_behind_a_pause_continues_the_request() -> None:
    client = session()
    assert classes(client, "?WATCH") == []
    assert b'"enable":false' in client.pause()
    assert classes(client, '={"json":true}') == ["DEVICES", "WATCH"]
    assert client.wants_json


def test_watch_selects_what_is_received_and_disable_ends_it() -> None:
    client = session()
    assert not client.wants_json and not client.wants_nmea
    ask(client, '?WATCH={"enable":true,"nmea":true};')
    assert client.wants_nmea and not client.wants_json
    ask(client, '?WATCH={"json":true};')
    assert client.wants_nmea and client.wants_json
    answers = ask(client, '?WATCH={"enable":false};')
    assert answers[1]["enable"] is False and not client.wants_json and not client.wants_nmea


@pytest.mark.parametrize("raw", [1, 2])
def test_raw_data_of_this_device_are_its_sentences(raw: int) -> None:
    client = session()
    ask(client, f'?WATCH={{"enable":true,"raw":{raw}}};')
    assert client.wants_nmea and not client.wants_json


@pytest.mark.parametrize("argument", ['{"enable":true}', "{}", '{"enable":true,"device":"obu"}', '{"scaled":true}'])
def test_a_watch_without_a_mode_streams_nothing(argument: str) -> None:
    client = session()
    watch = ask(client, f"?WATCH={argument};")[1]
    assert (watch["enable"], watch["json"], watch["nmea"], watch["raw"]) == (True, False, False, 0)
    assert not client.wants_json and not client.wants_nmea


def test_a_named_device_must_be_the_one_that_is_there() -> None:
    client = session()
    assert classes(client, '?WATCH={"enable":true,"json":true,"device":"/dev/ttyS0"};') == ["ERROR"]
    assert not client.wants_json
    assert classes(client, '?DEVICE={"path":"/dev/ttyS0"};?DEVICE={"path":"obu","bps":9600};') == ["ERROR", "DEVICE"]
    assert classes(client, '?WATCH={"enable":true,"json":true,"device":"obu"};') == ["DEVICES", "WATCH"]


def test_poll_gives_the_newest_objects() -> None:
    shared = SharedReports(now_ns=lambda: 1_700_000_001_000_000_000)
    client = Session(shared)
    empty = ask(client, "?POLL;")[0]
    assert empty["time"] == "2023-11-14T22:13:21.000Z" and empty["active"] == 1
    assert empty["tpv"] == [{"class": "TPV", "device": "obu", "mode": 1}]
    assert empty["gst"] == [{"class": "GST", "device": "obu"}]
    assert empty["sky"] == [{"class": "SKY", "device": "obu", "nSat": 0, "uSat": 0, "satellites": []}]
    shared.newest.update(TPV={"class": "TPV", "mode": 3}, SKY=None)
    assert ask(client, "?POLL;")[0]["tpv"] == [{"class": "TPV", "mode": 3}]


@pytest.mark.parametrize(
    "text",
    ["hello", "?NOTHING;", "?WATCH={enable};", '?WATCH={"enable":1};', '?WATCH={"raw":"x"};', '?WATCH={"a":[[[};'],
)
def test_what_is_no_request_is_answered_with_an_error(text: str) -> None:
    answer = ask(session(), text + "\n")
    assert [content["class"] for content in answer] == ["ERROR"]


def test_a_client_that_sends_no_requests_is_to_be_dropped() -> None:
    client = session()
    for _ in range(MAX_ERRORS):
        assert classes(client, "GET / HTTP/1.1\r\n") == ["ERROR"]
    with pytest.raises(BadClient, match="bad_requests"):
        client.answer(b"Host: unit\r\n")


@pytest.mark.parametrize("data", [b"?" * (MAX_REQUEST + 1), b"?" * (MAX_REQUEST + 1) + b";"])
def test_a_request_without_an_end_is_to_be_dropped(data: bytes) -> None:
    with pytest.raises(BadClient, match="request_length"):
        session().answer(data)


@given(st.lists(st.one_of(st.binary(max_size=100), st.sampled_from([b"?WATCH={", b'"raw":9}', b";", b"?POLL;"]))))
def test_whatever_bytes_come_answers_are_bounded_objects_or_the_client_is_dropped(parts: list[bytes]) -> None:
    client = session()
    try:
        for part in parts:
            for line in client.answer(part).split(b"\r\n")[:-1]:
                assert len(line) <= gpsd_reports.MAX_LENGTH and "class" in json.loads(line)
    except BadClient:
        pass
