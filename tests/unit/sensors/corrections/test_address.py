"""URLs of sources, and the password file."""

from pathlib import Path

import pytest

from services.sensors.corrections.address import Address, parse, password_of
from services.sensors.corrections.fault import SourceFault
from services.sensors.corrections.process import Config, Process
from shared.errors import ConfigError
from tests.support.cases import each

SETTINGS: dict[str, str | float | None] = {"password_file": "/etc/obu/ntrip.password", "gga_period_s": 10.0}


def test_a_url_gives_host_mount_point_and_user_and_the_name_has_no_user() -> None:
    found = parse("ntrip://me%40home@caster.example.org/MOUNT?gga_period_s=0&version=1", SETTINGS)
    assert (found.host, found.port, found.mount, found.user) == ("caster.example.org", 2101, "MOUNT", "me@home")
    assert (found.gga_period_s, found.version, found.password_file) == (0.0, 1, "/etc/obu/ntrip.password")
    assert found.name == "ntrip://caster.example.org/MOUNT" and "me" not in repr(found).replace(
        "name", ""
    ).lower().split("@")
    mqtt = parse("mqtts://pp.example.org?topic=/pp/ip/eu&topic=/pp/ubx/0236/ip&ca_file=/etc/ca.pem", SETTINGS)
    assert (mqtt.port, mqtt.tls, mqtt.topics) == (8883, True, ("/pp/ip/eu", "/pp/ubx/0236/ip"))
    assert parse("serial:///dev/ttyUSB1?baud=38400", SETTINGS).url == "serial:///dev/ttyUSB1?baud=38400"


@each(
    ("url", "words"),
    [
        ("ntrip://me:hunter2@caster.example.org/MOUNT", "password_file"),
        ("ntrip://me@caster.example.org", "names no mount point"),
        ("ntrip://me@caster.example.org/A\r\nX: hunter2", "control characters"),
        ("ntrip://me@caster.example.org/M?gga=5&password=hunter2", "has no option"),
        ("ntrip://me@caster.example.org:99999999/M", "no valid host and port"),
        ("http://caster.example.org/M", "not known"),
        ("tcp://192.168.1.20", "no host and port"),
        ("mqtt://broker.example.org", "names no topic"),
        ("ntrip://c.example.org/M?gga_period_s=hunter2", "number of seconds"),
        ("ntrip://me:hunter2@" + "x" * 2000, "characters"),
    ],
)
def test_what_is_wrong_with_a_url_is_said_without_user_and_password(url: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        Process(Config(sources=(url,)))
    assert words in str(caught.value)
    if "gga_period_s" not in url:
        assert "hunter2" not in str(caught.value) and "me@" not in str(caught.value)


def test_no_source_or_one_twice_is_a_wrong_configuration() -> None:
    with pytest.raises(ConfigError, match="sources is empty"):
        Process(Config())
    with pytest.raises(ConfigError, match="twice"):
        Process(Config(sources=("tcp://a:1", "tcp://a:1")))


def address(path: Path) -> Address:
    return Address(name="x", url="", scheme="ntrip", host="h", port=1, mount="M", user="u", password_file=str(path))


def test_the_password_is_the_first_line_of_a_file_that_others_cannot_read(tmp_path: Path) -> None:
    path = tmp_path / "password"
    path.write_text("hunter2\nmore\n")
    path.chmod(0o640)
    assert password_of(address(path)) == "hunter2"
    path.chmod(0o644)
    with pytest.raises(SourceFault, match="chmod 600") as caught:
        password_of(address(path))
    assert "hunter2" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"\n", b"\xff\xfe", b"a" * 5000, b"a\x00b\n"])
def test_a_file_without_a_password_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "password"
    path.write_bytes(content)
    path.chmod(0o600)
    with pytest.raises(SourceFault, match="password_file"):
        password_of(address(path))
    with pytest.raises(SourceFault, match="No such file"):
        password_of(address(tmp_path / "missing"))
