"""Sections of the settings of core.fusion, and the errors for keys of earlier versions."""

import tomllib
from pathlib import Path

import pytest

from cli.solve.overrides import with_settings
from services.core.fusion.settings import Settings
from services.core.fusion.start.warm_start import fingerprint
from shared.errors import ConfigError
from shared.runtime.config import (
    GnssAntenna,
    Section,
    Vehicle,
    dotted_keys,
    load_vehicle,
    own_fields,
    parse_vehicle,
    with_values,
)
from shared.runtime.live import load_process
from shared.runtime.old_keys import PRESENT_KEYS, REMOVED
from tests.support.cases import each


@pytest.mark.parametrize(
    "fact",
    [
        "imu.body_from_sensor = [[0, 1, 0], [1, 0, 0], [0, 0, -1]]",
        "gnss.lever_arm_body_m = [0.0, 0.0, -1.0]",
        "gnss.lever_arm_sd_m = 0.1",
        "gnss.baseline_yaw_body_rad = 1.5",
        "rear_axle_body_m = [-1.0, 0.0, 0.5]",
        "alert_limit_horizontal_m = 5.0",
        "alert_limit_vertical_m = 5.0",
    ],
)
def test_a_saved_state_is_of_the_vehicle_with_these_facts(fact: str) -> None:
    plain = parse_vehicle("").section("core.fusion", Settings)
    stated = parse_vehicle(f"[vehicle]\n{fact}").section("core.fusion", Settings)
    assert fingerprint(plain) == fingerprint(Settings()) != fingerprint(stated)


def test_facts_of_the_vehicle_are_read_from_their_section_and_stay_when_settings_are_replaced() -> None:
    file = parse_vehicle("[vehicle.gnss]\nlever_arm_body_m = [0.3, 0.0, -1.2]\n[core.fusion.gnss]\ndelay_s = 0.1")
    settings = file.section("core.fusion", Settings)
    assert settings.vehicle == file.facts == Vehicle(gnss=GnssAntenna(lever_arm_body_m=(0.3, 0.0, -1.2)))
    changed = settings.with_values({"gnss.delay_s": 0.2, "vehicle.alert_limit_horizontal_m": 5.0})
    assert changed.vehicle.gnss == settings.vehicle.gnss and changed.vehicle.alert_limits_m == (5.0, 20.0)


@pytest.mark.parametrize("name", ["core.fusion", "core.spoofing", "core.trust", "parsers.imu"])
def test_facts_of_the_vehicle_in_the_section_of_a_process_are_an_error(name: str) -> None:
    file = parse_vehicle(f"[{name}.vehicle.gnss]\nlever_arm_body_m = [0.3, 0.0, -1.2]", "car.toml")
    with pytest.raises(ConfigError, match=rf"car\.toml: \[{name}\.vehicle\].*move it there"):
        load_process(name, file)


def test_new_names_of_old_keys_are_settings_and_old_names_are_not() -> None:
    keys = {f"core.fusion.{key}" for key in dotted_keys(Settings)} | {f"vehicle.{key}" for key in dotted_keys(Vehicle)}
    assert set(PRESENT_KEYS.values()) <= keys
    assert not (set(PRESENT_KEYS) | set(REMOVED)) & keys


@pytest.mark.parametrize(
    ("override", "clause"),
    [
        ("core.fusion.imu.body_from_imu=1", r"'imu.body_from_imu'; it is \[vehicle\.imu\] body_from_sensor now$"),
        ("estimate_delays=true", r"'estimate_delays'; it is no more: a delay of GNSS"),
    ],
)
def test_an_old_key_that_an_override_gives_is_an_error_that_names_what_became_of_it(override: str, clause: str) -> None:
    vehicle = with_settings(parse_vehicle(""), [override])
    with pytest.raises(ConfigError, match=clause):
        vehicle.section("core.fusion", Settings)


def test_a_mistyped_key_in_a_section_is_an_error_that_names_the_right_one() -> None:
    with pytest.raises(ConfigError, match=r"no setting 'gnss\.dely_s'; did you mean 'gnss\.delay_s'"):
        parse_vehicle("[core.fusion.gnss]\ndely_s = 0.1").section("core.fusion", Settings)


def test_a_wrong_value_in_a_section_is_named_with_its_section() -> None:
    with pytest.raises(ConfigError, match=r"\[core\.fusion\] gnss\.delay_s = 9\.0"):
        parse_vehicle("[core.fusion.gnss]\ndelay_s = 9.0").section("core.fusion", Settings)


def test_dotted_values_change_what_they_name_and_nothing_else() -> None:
    changed = Settings().with_values({"gnss.delay_s": 0.1, "odometer.enabled": False, "history_s": 1.0})
    assert changed.gnss.delay_s == 0.1 and not changed.odometer.enabled and changed.history_s == 1.0
    assert changed.with_values({"gnss.delay_s": 0.0, "odometer.enabled": True, "history_s": 2.5}) == Settings()
    table = {"gnss": {"delay_s": 0.2, "time_sd_s": 0.0}}
    assert with_values(table, {"gnss.delay_s": 0.1}) == {"gnss": {"delay_s": 0.1, "time_sd_s": 0.0}}
    assert table == {"gnss": {"delay_s": 0.2, "time_sd_s": 0.0}}, "the table itself is as it was"


def test_every_setting_has_a_description() -> None:
    bare = []
    for name, info in own_fields(Settings).items():
        section = info.annotation
        if isinstance(section, type) and issubclass(section, Section):
            bare += [f"{name}.{key}" for key, inner in section.model_fields.items() if not inner.description]
        elif not info.description:
            bare.append(name)
    assert bare == []


@each("path", sorted(Path().glob("*/vehicles/*.toml")) + sorted(Path().glob("*/*/vehicles/*.toml")))
def test_every_vehicle_file_of_the_repository_is_valid(path: Path) -> None:
    assert load_vehicle(path).section("core.fusion", Settings)
    assert tomllib.loads(path.read_text(encoding="utf-8"))["vehicle"]["name"]
