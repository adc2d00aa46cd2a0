"""Changes keep comments and order; what a file would mean is checked before it is written."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.errors import ConfigError, UserError
from shared.runtime.config import parse_vehicle
from shared.settings.catalogue import find, value_of
from shared.settings.edit import REMOVED, checked, differences, edited, touched, value_from
from tests.support.cases import each
from tests.support.drives.golden import VEHICLE

TEXT = VEHICLE.read_text()
BEFORE = parse_vehicle(TEXT)
NAMES = ("core.fusion.gnss.delay_s", "core.fusion.odometer.scale", "monitoring.status.port", "vehicle.name")


def test_comments_and_order_stay_and_one_line_differs() -> None:
    text = edited(TEXT, {"vehicle.gnss.lever_arm_sd_m": 0.05})
    old, new = TEXT.splitlines(), text.splitlines()
    ((before, after),) = [pair for pair in zip(old, new, strict=True) if pair[0] != pair[1]]
    assert before == "lever_arm_sd_m = 0.02 # the simulated antenna is there"
    assert after == before.replace("0.02", "0.05")


@each(
    ("name", "value"),
    [("core.fusion.gnss.delay_s", 0.08), ("core.trust.required_monitors", []), ("sensors.gnss.device", "/dev/ttyACM1"),
     ("vehicle.alert_limit_horizontal_m", 4.0), ("core.fusion.standstill.enabled", False)],
)  # fmt: skip
def test_a_new_key_is_found_again_in_its_section_and_can_be_taken_away(name: str, value: object) -> None:
    setting = find(name)
    after = checked(edited(TEXT, {name: value}), "car.toml")
    assert value_of(after, setting) == value
    again = parse_vehicle(edited(after.text, {name: REMOVED}))
    assert value_of(again, setting) == value_of(BEFORE, setting)


def test_to_take_away_what_is_not_there_changes_nothing() -> None:
    assert edited(TEXT, {"core.fusion.history_s": REMOVED, "sensors.gnss.device": REMOVED}) == TEXT


@given(st.dictionaries(st.sampled_from(NAMES[:3]), st.floats(0.5, 1.9).map(lambda value: round(value, 3))))
def test_the_differences_are_what_was_changed(values: dict[str, float]) -> None:
    changes = {name: 8000 + round(value) if name.endswith("port") else value for name, value in values.items()}
    after = checked(edited(TEXT, changes), "car.toml")
    found = {change.setting.name: change.after for change in differences(BEFORE, after)}
    assert changes.items() <= found.items() | {(n, v) for n, v in changes.items() if v == value_of(BEFORE, find(n))}
    assert {name for name in found if name not in changes} <= {
        "core.motion_conflict.velocity_delay_s", "core.spoofing.gnss.velocity_delay_s",
        "core.spoofing.gnss.position_delay_s",
    }, "they take the delay of core.fusion"  # fmt: skip


def test_processes_that_read_what_changed_start_again() -> None:
    after = checked(edited(TEXT, {"monitoring.status.port": 8081}), "car.toml")
    assert touched(differences(BEFORE, after), after, BEFORE) == ["monitoring.status"]
    after = checked(edited(TEXT, {"vehicle.gnss.lever_arm_sd_m": 0.05}), "car.toml")
    names = touched(differences(BEFORE, after), after, BEFORE)
    assert "core.fusion" in names and "monitoring.recorder" not in names
    after = checked(f"{TEXT}\n[controller.cam]\nstation_id = 9\n", "car.toml")
    assert touched(differences(BEFORE, after), after, BEFORE) == [
        "controller.cam", "monitoring.recorder", "monitoring.health", "monitoring.status"
    ], "it begins, and what observes all processes looks for it"  # fmt: skip


@each(
    ("name", "text", "value"),
    [("vehicle.name", "car7", "car7"), ("vehicle.name", '"car7"', "car7"), ("vehicle.name", "7", "7"),
     ("core.fusion.gnss.delay_s", "0.1", 0.1), ("core.fusion.gnss.position_only", "true", True),
     ("vehicle.gnss.lever_arm_body_m", "[0.3, 0, -1.2]", [0.3, 0, -1.2]), ("vehicle.role", "rsu", "rsu")],
)  # fmt: skip
def test_values_are_written_as_in_toml_and_text_without_quotes(name: str, text: str, value: object) -> None:
    assert value_from(text, find(name)) == value


@each(
    ("name", "text"),
    [
        ("core.fusion.gnss.delay_s", "much"),
        ("core.fusion.gnss.position_only", "yes"),
        ("vehicle.alert_limit_vertical_m", ""),
    ],
)
def test_what_is_no_value_of_the_setting_is_an_error_that_shows_one(name: str, text: str) -> None:
    with pytest.raises(UserError, match=name):
        value_from(text, find(name))


@each("changes", [{"core.fusion.gnss.delay_s": 9.0}, {"vehicle.name": "two words"}, {"vehicle.role": "boat"}])
def test_a_file_that_no_process_would_take_is_refused(changes: dict[str, object]) -> None:
    with pytest.raises(ConfigError):
        checked(edited(TEXT, changes), "car.toml")


@each(("name", "hint"), [("core.fusion.delay_s", "did you mean"), ("core.fussion.x", "core.fusion"), ("x", "section")])
def test_a_name_that_does_not_exist_is_an_error_with_the_nearest(name: str, hint: str) -> None:
    with pytest.raises(UserError, match=hint):
        find(name)
