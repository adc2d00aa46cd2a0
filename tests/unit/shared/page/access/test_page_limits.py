import asyncio
import logging
import resource
from typing import cast

import pytest

from shared.page.access.limits import Connections, LimitedHttp, RateLimit, quiet_accept
from shared.page.access.peer import networks, place_of


class FakeTransport:
    def __init__(self) -> None:
        self.aborted = False

    def abort(self) -> None:
        self.aborted = True


class FakeProtocol:
    def __init__(self, *, idle: bool) -> None:
        self.idle, self.transport = idle, FakeTransport()


def enter(connections: Connections, client: str, *, idle: bool = False) -> tuple[bool, FakeTransport]:
    protocol = FakeProtocol(idle=idle)
    transport = cast(asyncio.BaseTransport, protocol.transport)
    return connections.admit(cast(LimitedHttp, protocol), transport, client), protocol.transport


def test_one_address_may_have_so_many_and_others_still_connect() -> None:
    connections = Connections(100, 4)
    assert [enter(connections, "192.0.2.1")[0] for _ in range(6)] == [True] * 4 + [False] * 2
    assert connections.refused == 2
    assert enter(connections, "192.0.2.2")[0]


def test_a_network_of_ipv6_is_one_client_where_anybody_may_connect() -> None:
    connections = Connections(100, 4, place=place_of)
    assert sum(enter(connections, f"2001:db8::{n:x}")[0] for n in range(6)) == 4
    assert enter(connections, "2001:db8:0:1::1")[0]
    assert sum(enter(connections, f"{form}192.0.2.1")[0] for form in ("", "::ffff:") * 3) == 4


def test_the_oldest_idle_one_gives_way() -> None:
    connections = Connections(100, 4)
    busy = [enter(connections, "192.0.2.1")[1] for _ in range(2)]
    idle = [enter(connections, "192.0.2.1", idle=True)[1] for _ in range(2)]
    assert enter(connections, "192.0.2.1")[0]
    assert [fake_transport.aborted for fake_transport in (*busy, *idle)] == [False, False, True, False]
    assert len(connections) == 4


def test_all_addresses_together_are_bounded_too() -> None:
    connections = Connections(10, 4)
    found = [enter(connections, f"192.0.2.{n}")[0] for n in range(12)]
    assert found == [True] * 10 + [False] * 2
    _, first = enter(connections, "192.0.2.99", idle=True)
    assert len(connections) == 10 and not first.aborted


@pytest.mark.parametrize("client", ["127.0.0.1", "::1", "10.0.0.3"])
def test_this_machine_and_a_trusted_proxy_may_have_half(client: str) -> None:
    connections = Connections(100, 4, networks(["10.0.0.3"]))
    assert sum(enter(connections, client)[0] for _ in range(60)) == 50


def test_behind_the_gateway_of_containers_all_clients_share_an_address() -> None:
    connections = Connections(100, 4, published="127.0.0.1")
    assert sum(enter(connections, "172.18.0.1")[0] for _ in range(60)) == 50


def test_an_ended_connection_makes_room() -> None:
    connections = Connections(100, 1)
    _, transport = enter(connections, "192.0.2.1")
    connections.leave(cast(asyncio.BaseTransport, transport))
    connections.leave(cast(asyncio.BaseTransport, transport))
    assert enter(connections, "192.0.2.1")[0]


def test_files_are_left_for_other_things(monkeypatch: pytest.MonkeyPatch) -> None:
    for files, maximum in ((1024, 896), (64, 8), (resource.RLIM_INFINITY, 2000)):
        monkeypatch.setattr(resource, "getrlimit", lambda _, soft=files: (soft, soft))
        assert Connections(2000, 16).maximum == maximum


def record(text: str) -> logging.LogRecord:
    return logging.LogRecord("a", logging.WARNING, "", 0, text, (), None)


def test_a_text_is_written_five_times_a_minute_and_the_others_counted() -> None:
    now_s = [0.0]
    limit = RateLimit(lambda: now_s[0])
    assert sum(limit.filter(record("Invalid HTTP request received.")) for _ in range(1000)) == 5
    assert limit.filter(record("another"))
    now_s[0] = 60.0
    later = record("Invalid HTTP request received.")
    assert limit.filter(later)
    assert later.getMessage() == "Invalid HTTP request received. (995 more were not written)"
    now_s[0] = 120.0
    last = record("Invalid HTTP request received.")
    assert limit.filter(last) and "more" not in last.getMessage()


def test_a_lack_of_files_is_one_line_and_other_errors_are_as_before(caplog: pytest.LogCaptureFixture) -> None:
    loop = asyncio.new_event_loop()
    lack = OSError(24, "Too many open files")
    quiet_accept(loop, {"message": "socket.accept() out of system resource", "exception": lack})
    quiet_accept(loop, {"message": "Task exception was never retrieved", "exception": ValueError("x")})
    loop.close()
    lines = [record.getMessage() for record in caplog.records]
    assert lines[0] == "cannot accept connections: Too many open files; the page takes new ones in a second"
    assert lines[1].startswith("Task exception was never retrieved")
