import pytest

from shared.page.access.hosts import host_allowed, own_names, same_origin


@pytest.fixture(autouse=True)
def _name(monkeypatch: pytest.MonkeyPatch) -> None:
    own_names.cache_clear()
    monkeypatch.setattr("socket.gethostname", lambda: "Truck7.fleet.example")


@pytest.mark.parametrize(
    "host",
    [
        "localhost", "localhost:8080", "a.localhost", "127.0.0.1:8080", "[::1]:8080", "192.168.1.7", "truck7",
        "truck7.local:8080", "TRUCK7.LOCAL.", "truck7.lan", "truck7.fleet.example",
    ],
)  # fmt: skip
def test_addresses_and_the_own_names_are_answered(host: str) -> None:
    assert host_allowed(host)


@pytest.mark.parametrize(
    "host",
    [
        "attacker.example",
        "obu.local.attacker.example",
        "127.0.0.1.nip.example",
        "",
        None,
        "[::",
        "obu",
        "printer.local",
        "truck7.example",
        "obu.local:8080",
        "truck7.local.attacker.example",
    ],
)
def test_other_names_are_refused_because_anyone_can_point_them_here(host: str | None) -> None:
    assert not host_allowed(host)


def test_a_name_in_the_settings_is_answered() -> None:
    assert host_allowed("Truck.Fleet.Example:443", ["truck.fleet.example"])


def test_a_page_may_connect_back_to_where_it_came_from_only() -> None:
    assert same_origin("http://obu.local:8080", "obu.local:8080")
    assert same_origin("https://obu.local", "OBU.local")
    assert not same_origin("http://obu.local:9090", "obu.local:8080")
    assert not same_origin("http://attacker.example", "obu.local:8080")
    assert not same_origin("null", "obu.local:8080")


@pytest.mark.parametrize("origin", ["http://[", "http://[::1", "http://[x]", "//]"])
def test_an_origin_that_is_no_address_is_refused(origin: str) -> None:
    assert not same_origin(origin, "obu.local:8080")


def test_a_program_that_sends_no_origin_is_no_browser() -> None:
    assert same_origin(None, "obu.local:8080")
