"""The vehicle file: its keys, and the errors for invalid ones."""

from pathlib import Path

import pytest

from shared.errors import UserError
from shared.messages.base import Vector3
from shared.runtime.config import BrokerAddress, Section, load_vehicle, parse_vehicle


class Config(Section):
    antenna_body_m: Vector3 = (0.0, 0.0, 0.0)
    period_s: float = 1.0


def test_an_empty_file_gives_the_defaults() -> None:
    assert parse_vehicle("").section("core.fusion", Config) == Config()


def test_a_section_is_read_with_its_units() -> None:
    vehicle = parse_vehicle("[core.fusion]\nantenna_body_m = [1.0, 2.0, 3]")
    assert vehicle.section("core.fusion", Config).antenna_body_m == (1.0, 2.0, 3.0)


def test_a_mistyped_key_is_an_error_that_names_the_right_one() -> None:
    vehicle = parse_vehicle("[core.fusion]\nantenna_m = [1.0, 2.0, 3.0]")
    with pytest.raises(UserError, match="did you mean 'antenna_body_m'"):
        vehicle.section("core.fusion", Config)


def test_a_value_of_the_wrong_kind_names_its_section_and_key() -> None:
    with pytest.raises(UserError, match=r"\[core.fusion\] period_s = 'soon'"):
        parse_vehicle('[core.fusion]\nperiod_s = "soon"').section("core.fusion", Config)


@pytest.mark.parametrize("value", ["nan", "inf"])
def test_nan_and_infinity_are_rejected(value: str) -> None:
    with pytest.raises(UserError, match="period_s"):
        parse_vehicle(f"[core.fusion]\nperiod_s = {value}").section("core.fusion", Config)


def test_a_mistyped_section_is_an_error_that_names_the_right_one() -> None:
    with pytest.raises(UserError, match=r"did you mean \[core.fusion\]"):
        parse_vehicle("[core.fusoin]\n")


def test_a_key_outside_a_section_is_an_error() -> None:
    with pytest.raises(UserError, match="outside a section"):
        parse_vehicle('name = "truck"')


def test_invalid_toml_is_an_error_of_one_sentence() -> None:
    with pytest.raises(UserError, match="not valid TOML"):
        parse_vehicle("[core.fusion")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"gone\.toml"):
        load_vehicle(tmp_path / "gone.toml")


def test_a_file_that_is_not_text_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "noise.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UserError, match="UTF-8"):
        load_vehicle(path)


def test_an_extra_process_runs_only_where_it_has_a_section() -> None:
    assert "sensors.simulator" not in parse_vehicle("").processes
    assert "sensors.simulator" in parse_vehicle("[sensors.simulator]").processes
    assert "core.fusion" in parse_vehicle("").processes


def test_the_role_decides_which_processes_run() -> None:
    processes = parse_vehicle('[vehicle]\nrole = "rsu"\n[sensors.traffic]').processes
    assert {"sensors.traffic", "core.toll", "monitoring.ledger", "monitoring.recorder"} <= set(processes)
    assert "core.fusion" not in processes and "core.toll" not in parse_vehicle("").processes


def test_a_section_of_a_process_of_another_role_is_an_error() -> None:
    with pytest.raises(UserError, match=r"\[core.fusion\] does not run in role rsu"):
        parse_vehicle('[vehicle]\nrole = "rsu"\n[core.fusion]')


def test_an_unknown_role_is_an_error_that_names_the_roles() -> None:
    with pytest.raises(UserError, match="'obu' or 'rsu'"):
        parse_vehicle('[vehicle]\nrole = "ship"')


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("mqtt://broker:1884", BrokerAddress("broker", 1884)),
        ("broker", BrokerAddress("broker", 1883)),
        ("mqtt+unix:///run/obu-broker/socket", BrokerAddress(socket="/run/obu-broker/socket")),
        ("mqtt+unix:///a%20b/%C3%A9", BrokerAddress(socket="/a b/\u00e9")),
        (
            "mqtt+unix://me:secret@/run/socket",
            BrokerAddress(username="me", password="secret", socket="/run/socket"),
        ),
        ("mqtt://core.fusion:secret@10.0.0.1", BrokerAddress("10.0.0.1", 1883, "core.fusion", "secret")),
    ],
)
def test_the_address_of_the_broker_is_read(url: str, expected: BrokerAddress) -> None:
    assert BrokerAddress.parse(url) == expected


@pytest.mark.parametrize(
    "url", ["http://broker", "mqtt://broker:many", "mqtt://", "mqtt+unix://", "mqtt+unix://host/path"]
)
def test_an_invalid_address_is_an_error_with_an_example(url: str) -> None:
    with pytest.raises(UserError, match=r"mqtt://127.0.0.1:1883"):
        BrokerAddress.parse(url)


def test_a_password_is_not_logged() -> None:
    assert "secret" not in repr(BrokerAddress.parse("mqtt://me:secret@host"))


@pytest.mark.parametrize("name", ["", "+", "#", "a/b", "x" * 49, "car 7"])
def test_a_vehicle_name_that_is_no_topic_level_is_rejected(name: str) -> None:
    with pytest.raises(UserError, match="name"):
        _ = parse_vehicle(f'[vehicle]\nname = "{name}"').name
