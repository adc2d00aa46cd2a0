"""When a login is needed, from where a request comes, and what recognises a visitor."""

from pathlib import Path

import pytest

from services.monitoring.status.process import Config
from services.monitoring.status.web.access.access import Access, Rules, csrf_agrees, csrf_of, is_simulated
from services.monitoring.status.web.access.rights import Right
from services.monitoring.status.web.access.tokens import Tokens
from shared.page.access.peer import Peer, networks, peer_of
from shared.runtime.config import load_vehicle, parse_vehicle
from tests.support.cases import each

VEHICLES = Path(__file__).parents[6] / "deploy" / "vehicles"
HERE, ELSEWHERE = "127.0.0.1", "192.168.1.20"


def peer(client: str | None, **headers: str) -> Peer:
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return peer_of(client, "http", named, networks(["127.0.0.1", "10.0.0.0/24", "fd00::/64"]))


@pytest.mark.parametrize("client", ["127.0.0.1", "127.8.8.8", "::1", "::ffff:127.0.0.1"])
def test_this_machine_is_recognised(client: str) -> None:
    assert peer(client).loopback


@pytest.mark.parametrize("client", ["192.168.1.2", "::ffff:10.0.0.9", "fe80::1", "testclient", "", None])
def test_another_machine_is_none_of_this(client: str | None) -> None:
    assert not peer(client).loopback


@pytest.mark.parametrize(
    "header",
    ["x_forwarded_for", "x_forwarded_host", "x_forwarded_proto", "forwarded", "x_real_ip", "via", "x_forwarded_port"],
)
def test_a_header_of_a_proxy_makes_a_peer_foreign(header: str) -> None:
    found = peer("127.0.0.1", **{header: "127.0.0.1"})
    assert found.forwarded and not found.loopback


@each(
    ("client", "chain", "address"),
    [
        ("127.0.0.1", "203.0.113.7", "203.0.113.7"),
        ("127.0.0.1", "1.2.3.4, 203.0.113.7", "203.0.113.7"),  # the first was stated by the client
        ("127.0.0.1", "203.0.113.7, 10.0.0.3", "203.0.113.7"),  # two proxies
        ("10.0.0.3", "203.0.113.7", "203.0.113.7"),
        ("fd00::5", "2001:db8::7", "2001:db8::7"),
        ("127.0.0.1", "127.0.0.1", "127.0.0.1"),
        ("127.0.0.1", "nonsense", "127.0.0.1"),
        ("127.0.0.1", "1.2.3.4, nonsense", "127.0.0.1"),
        ("192.0.2.1", "203.0.113.7", "192.0.2.1"),  # not trusted
    ],
)
def test_the_client_is_the_last_address_that_is_no_trusted_proxy(client: str, chain: str, address: str) -> None:
    found = peer(client, x_forwarded_for=chain)
    assert found.address == address
    assert not found.loopback
    assert found.proxied is (client != "192.0.2.1")


def test_https_is_believed_of_a_trusted_proxy() -> None:
    assert peer("127.0.0.1", x_forwarded_proto="https").encrypted
    assert not peer("127.0.0.1", x_forwarded_proto="http").encrypted
    assert not peer("192.0.2.1", x_forwarded_proto="https").encrypted
    assert peer_of("192.0.2.1", "wss", {}, ()).encrypted


@each(
    ("rules", "here", "elsewhere", "through_proxy"),
    [
        (Rules(simulated=True), False, True, True),
        (Rules(simulated=False), True, True, True),
        (Rules(simulated=False, login_on_loopback=False), False, True, True),
        (Rules(simulated=True, login_on_loopback=True), True, True, True),
        # in a container every browser comes from the gateway of its network
        (Rules(simulated=True, published="127.0.0.1"), False, False, True),
        (Rules(simulated=True, published="::1"), False, False, True),
        (Rules(simulated=True, published="0.0.0.0"), False, True, True),
        (Rules(simulated=True, published="192.168.1.7"), False, True, True),
        (Rules(simulated=True, published="localhost"), False, True, True),
        (Rules(simulated=False, published="127.0.0.1"), True, True, True),
        (Rules(simulated=False, published="127.0.0.1", login_on_loopback=False), False, False, True),
    ],
)
def test_a_login_is_needed_unless_the_data_are_simulated_and_the_browser_is_here(
    rules: Rules, here: bool, elsewhere: bool, through_proxy: bool
) -> None:
    assert rules.login_needed(peer(HERE)) is here
    assert rules.login_needed(peer("172.18.0.1")) is elsewhere
    assert rules.login_needed(peer(HERE, x_forwarded_for=HERE)) is through_proxy


@each(
    ("text", "simulated"),
    [
        ("[sensors.simulator]", True),
        ("[sensors.simulator]\n[sensors.gnss]\ndevice = 'serial:///dev/x'", False),
        ("[sensors.simulator]\n[sensors.replay]\nfile = 'a.mcap'", True),
        ("[sensors.gnss]\n[sensors.replay]\nfile = 'a.mcap'", False),
        ("[sensors.replay]\nfile = 'a.mcap'", False),
        ("[vehicle]\nrole = 'rsu'\n[sensors.traffic]\n[sensors.v2x]", True),
        ("[vehicle]\nrole = 'rsu'\n[sensors.traffic]\n[sensors.v2x]\ndevice = 'udp://127.0.0.1:5000'", True),
        ("[vehicle]\nrole = 'rsu'\n[sensors.traffic]\n[sensors.v2x]\ndevice = 'udp://192.168.1.5:5000'", False),
        ("[vehicle]\nrole = 'rsu'\n[sensors.v2x]", False),
        ("", False),
    ],
)
def test_a_unit_is_simulated_if_it_has_no_device(text: str, simulated: bool) -> None:
    assert is_simulated(parse_vehicle(text)) is simulated


@pytest.mark.parametrize(("name", "simulated"), [("simulated", True), ("rsu", True), ("pi", False)])
def test_delivered_vehicles_are_told_apart(name: str, simulated: bool) -> None:
    assert is_simulated(load_vehicle(VEHICLES / f"{name}.toml")) is simulated


@pytest.fixture
def access(tmp_path: Path) -> Access:
    tokens = Tokens(tmp_path)
    tokens.make()
    return Access(Rules(), tokens)


def test_a_bearer_token_needs_no_value_of_a_page(access: Access) -> None:
    secret = access.tokens.add("script", Right.OPERATE)
    found = access.visitor(peer(ELSEWHERE), {"authorization": f"Bearer {secret}"})
    assert found and (found.name, found.right, found.csrf) == ("script", Right.OPERATE, None)
    assert csrf_agrees(found, {})


@pytest.mark.parametrize("value", ["Bearer", "Bearer ", "Bearer x", "Basic YTpi", "bearer " + "y" * 43, "Bearer é"])
def test_another_authorization_is_nobody(access: Access, value: str) -> None:
    assert access.visitor(peer(ELSEWHERE), {"authorization": value}) is None


def test_a_wrong_token_is_refused_also_where_none_is_needed(tmp_path: Path) -> None:
    access = Access(Rules(simulated=True), Tokens(tmp_path))
    assert access.visitor(peer(HERE), {})
    assert access.visitor(peer(HERE), {"authorization": "Bearer " + "y" * 43}) is None


def test_the_token_of_a_link_is_none_of_a_program(access: Access) -> None:
    secret = access.tokens.add_temporary("link", Right.VIEW, seconds=60.0, single_use=True)
    assert access.visitor(peer(ELSEWHERE), {"authorization": f"Bearer {secret}"}) is None


def test_a_cookie_is_a_visitor_whose_changes_need_its_value(access: Access) -> None:
    secret = access.tokens.add("guest", Right.OPERATE)
    cookie, session = access.tokens.log_in(secret, 60.0) or pytest.fail("no login")
    found = access.visitor(peer(ELSEWHERE), {"cookie": f"a=b; {access.cookie}={cookie}"})
    assert found and found.session == session and found.csrf == csrf_of(cookie)
    assert csrf_agrees(found, {"x-obu-csrf": csrf_of(cookie)})
    for wrong in ({}, {"x-obu-csrf": ""}, {"x-obu-csrf": csrf_of(secret)}, {"x-obu-csrf": "é"}):
        assert not csrf_agrees(found, wrong)
    access.tokens.log_out(session)
    assert access.visitor(peer(ELSEWHERE), {"cookie": f"{access.cookie}={cookie}"}) is None


@pytest.mark.parametrize("cookie", ["", "=;;", "obu-x=1", "{name}=short", "{name}=" + "y" * 43, '{name}="; a'])
def test_another_cookie_is_nobody(access: Access, cookie: str) -> None:
    assert access.visitor(peer(ELSEWHERE), {"cookie": cookie.format(name=access.cookie)}) is None


def test_who_needs_no_login_may_do_everything_with_the_value_of_the_page(tmp_path: Path) -> None:
    access = Access(Rules(simulated=True), Tokens(tmp_path))
    found = access.visitor(peer(HERE), {})
    assert found and found.right is Right.ADMIN and found.csrf
    assert not csrf_agrees(found, {})
    assert csrf_agrees(found, {"x-obu-csrf": found.csrf})
    assert access.visitor(peer(ELSEWHERE), {}) is None


def test_proxies_are_addresses_or_networks() -> None:
    assert Config(trusted_proxies=("127.0.0.1", "10.0.0.0/8", "fd00::/8"))
    with pytest.raises(ValueError, match="does not appear to be an IPv4 or IPv6"):
        Config(trusted_proxies=("proxy.example",))
