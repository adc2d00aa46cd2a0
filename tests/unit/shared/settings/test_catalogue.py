"""Every setting has a name, what it is, and the value that a file gives it."""

import tomllib

import tomlkit

from shared.processes import PROCESSES, Role
from shared.runtime.config import dotted_keys, parse_vehicle
from shared.settings.catalogue import FACTS, catalogue, find, section_of, settings_of, value_of


def test_every_setting_of_every_section_is_listed_once_with_a_meaning() -> None:
    for name in (FACTS, *(row.name for row in PROCESSES)):
        found = list(settings_of(name))
        assert [setting.key for setting in found] == list(dotted_keys(section_of(name))), name
        assert all(setting.meaning for setting in found), name
        assert find(found[0].name) == found[0] if found else True


def test_a_default_is_the_value_of_an_empty_file() -> None:
    for role in Role:
        file = parse_vehicle(f'[vehicle]\nrole = "{role}"\n')
        for setting in catalogue(role):
            if setting.name != "vehicle.role" and setting.default is not None:
                value = value_of(file, setting)
                assert value == setting.default or setting.section.startswith("core."), setting.name


def test_bounds_and_choices_are_those_of_the_model() -> None:
    delay = find("core.fusion.gnss.delay_s")
    assert delay.bounds == ("at least -2.0", "at most 2.0") and delay.kind == "number"
    assert find("vehicle.role").choices == ("obu", "rsu")
    assert find("core.cooperative.method").choices == ("bank", "paper", "plain")


def test_every_default_can_be_written_as_toml() -> None:
    for setting in catalogue(Role.OBU):
        if setting.default is not None:
            assert tomllib.loads(tomlkit.dumps({"value": setting.default})) == {"value": setting.default}, setting.name
