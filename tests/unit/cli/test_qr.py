"""Names of networks as NetworkManager writes them."""

import pytest

from cli.qr import network_of, wifi_text

FILE = "[connection]\nid=obu-access-point\n[wifi]\nmode=ap\nssid={}\n[wifi-security]\npsk={}\n"


@pytest.mark.parametrize(
    ("written", "name"),
    [
        ("OBU truck 7", "OBU truck 7"),
        ("79;66;85;", "OBU"),
        ("76;195;164;59;", "L\u00e4;"),
        (r"a\;b\\c", "a;b\\c"),
        (r"\sinside\s", " inside "),
        ("100%", "100%"),
        ("300;1;", "300;1;"),
        ("76", "76"),
    ],
)
def test_a_name_is_what_a_phone_shows(written: str, name: str) -> None:
    assert network_of(FILE.format(written, "abc")) == (name, "abc")
    assert wifi_text(name, "abc").startswith("WIFI:")


@pytest.mark.parametrize("text", ["", "[wifi]\nssid=x\n", "no section", "[wifi]\nssid=x\nssid=y\n"])
def test_what_is_no_connection_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="no connection of NetworkManager"):
        network_of(text)
