"""What a change of settings would do, before anything is written."""

import json

import pytest

from shared.runtime.config import parse_vehicle
from shared.settings.check import Code, answer, digests
from shared.settings.question import Answer, Question

TEXT = """# A comment.
[vehicle]
name = "car"

[sensors.gnss]
device = "serial:///dev/ttyACM0" # of the receiver

[core.fusion.gnss]
delay_s = 0.1
"""


def test_a_change_tells_its_differences_what_follows_and_who_starts_again() -> None:
    found = answer(Question(path="car.toml", text=TEXT, changes={"core.fusion.gnss.delay_s": "0.08"}))
    assert not found.refusals and "# A comment." in found.text and "# of the receiver" in found.text
    values = {one.name: (one.before, one.after) for one in found.differences}
    assert values["core.fusion.gnss.delay_s"] == ("0.1", "0.08")
    assert values["core.motion_conflict.velocity_delay_s"] == ("0.1", "0.08"), "it follows"
    assert set(found.touched) == {"core.fusion", "core.motion_conflict", "core.spoofing"}


def test_exactly_the_processes_that_are_touched_and_the_recorder_have_other_digests() -> None:
    found = answer(Question(path="car.toml", text=TEXT, changes={"core.fusion.gnss.delay_s": "0.08"}))
    before = digests(parse_vehicle(TEXT, "car.toml"))
    assert {name for name in before if before[name] != found.digests[name]} == {*found.touched, "monitoring.recorder"}


def test_none_takes_a_value_out_of_the_text() -> None:
    found = answer(Question(path="car.toml", text=TEXT, changes={"core.fusion.gnss.delay_s": None}))
    assert "delay_s" not in found.text and not found.refusals


@pytest.mark.parametrize(
    ("name", "value", "code"),
    [
        ("core.fusion.gnss.delay_s", "99", Code.INVALID),
        ("core.fusion.gnss.delay_s", '"soon"', Code.INVALID),
        ("core.fusion.gnss.delay_s", "{", Code.INVALID),
        ("core.fusion.gnss.delay_s", "0.1", Code.NOTHING),
        ("core.fusion.gnss.colour", "1", Code.UNKNOWN),
        ("sensors.imu.device", '"serial:///dev/x"', Code.UNKNOWN),  # it does not run here
        ("vehicle.name", '"other"', Code.FIXED),
        ("vehicle.role", '"rsu"', Code.FIXED),
        ("monitoring.status.static_dir", '"/etc"', Code.FIXED),
        ("sensors.gnss.device", '"tcp://user:secret@10.0.0.1:2947"', Code.SECRET),
        ("sensors.gnss.device", '"file:///etc/shadow"', Code.FIXED),
        ("sensors.gnss.device", '"tcp://10.0.0.1:1?password_file=/etc/shadow"', Code.FIXED),
        ("monitoring.recorder.folder", '"/etc"', Code.FIXED),
        ("monitoring.status.map_file", '"/etc/shadow"', Code.FIXED),
        ("controller.mode.gnss_outputs", "[null]", Code.INVALID),
    ],
)
def test_what_cannot_be_changed_is_refused_by_its_code(name: str, value: str, code: Code) -> None:
    found = answer(Question(path="car.toml", text=TEXT, changes={name: value}))
    assert [one.code for one in found.refusals] == [code] and not found.text


def test_passwords_of_addresses_are_never_told() -> None:
    text = TEXT.replace("serial:///dev/ttyACM0", "tcp://user:hidden@10.0.0.1:2947")
    changed = answer(Question(path="car.toml", text=text, changes={"sensors.gnss.device": '"serial:///dev/ttyACM1"'}))
    assert [one.code for one in changed.refusals] == [Code.SECRET], "the change would lose the password"
    found = answer(Question(path="car.toml", text=text, changes={"core.fusion.gnss.delay_s": "0.08"}))
    told = json.dumps([one.model_dump() for one in (*found.differences, *found.settings)])
    assert "hidden" not in told and "10.0.0.1" in told


def test_an_earlier_text_is_restored_as_a_whole_and_a_broken_one_is_refused() -> None:
    earlier = TEXT.replace("0.1", "0.2")
    found = answer(Question(path="car.toml", text=TEXT, replacement=earlier, earlier=(TEXT,)))
    assert found.text == earlier and found.counts == (len(found.differences),)
    broken = answer(Question(path="car.toml", text=TEXT, replacement="[vehicle"))
    assert [one.code for one in broken.refusals] == [Code.INVALID]


def test_a_text_that_holds_and_is_invalid_can_be_replaced() -> None:
    broken = TEXT.replace("0.1", '"soon"')
    found = answer(Question(path="car.toml", text=broken, replacement=TEXT))
    assert found.text == TEXT and not found.refusals and "core.fusion" in found.touched


def test_a_value_that_is_too_long_to_be_shown_is_neither_cut_nor_changed() -> None:
    text = TEXT + f'\n[monitoring.status]\nallowed_hosts = ["{"a" * 5000}"]\n'
    found = answer(Question(path="car.toml", text=text))
    row = next(row for row in found.settings if row.name == "monitoring.status.allowed_hosts")
    assert json.loads(row.value) and len(row.value) < 100
    refused = answer(Question(path="car.toml", text=text, changes={row.name: "[]"}))
    assert [one.code for one in refused.refusals] == [Code.FIXED]


def test_the_page_starts_again_where_a_device_of_the_unit_changes() -> None:
    found = answer(Question(path="car.toml", text=TEXT, changes={"sensors.gnss.device": '"serial:///dev/ttyACM1"'}))
    assert {"sensors.gnss", "monitoring.status"} <= set(found.touched)
    before = digests(parse_vehicle(TEXT, "car.toml"))
    assert before["monitoring.status"] != found.digests["monitoring.status"]


def asked(**changes: str | None) -> Answer:
    """Answer to changes whose names have two underscores for a point."""
    named = {name.replace("__", "."): value for name, value in changes.items()}
    return answer(Question(path="car.toml", text=TEXT, changes=named))


def test_a_process_is_switched_on_with_its_settings_and_another_one_off() -> None:
    found = asked(sensors__simulator="true", sensors__simulator__seed="7", sensors__gnss=None)
    assert not found.refusals
    assert parse_vehicle(found.text).tables["sensors.simulator"] == {"seed": 7} and "[sensors.gnss]" not in found.text
    values = {one.name: (one.before, one.after) for one in found.differences}
    assert (values["sensors.simulator"], values["sensors.gnss"]) == (("false", "true"), ("true", "false"))
    assert {"sensors.simulator", "sensors.gnss", "monitoring.health"} <= set(found.touched)
    runs = {row.name: row.value for row in found.settings if row.name.count(".") == 1}
    assert runs["sensors.simulator"] == "true" and runs["sensors.gnss"] == "false" and "core.fusion" not in runs


@pytest.mark.parametrize(
    ("name", "value", "code"),
    [
        ("sensors.simulator", '"yes"', Code.INVALID),
        ("sensors.simulator.seed", "7", Code.UNKNOWN),  # it does not run
        ("core.fusion", "false", Code.UNKNOWN),  # it always runs
        ("sensors.replay", "true", Code.UNKNOWN),
        ("sensors.traffic", "true", Code.UNKNOWN),  # of another role
        ("parsers.can.dbc_file", '"/etc/passwd"', Code.FIXED),
    ],
)
def test_what_is_no_switch_of_this_unit_is_refused(name: str, value: str, code: Code) -> None:
    (refused,) = asked(**{name: value}).refusals
    assert refused.code == code


def test_of_files_those_of_a_set_of_hardware_may_be_chosen_alone() -> None:
    signals = {f"parsers__can__wheel_speed_signals__{place}": '"A"' for place in ("front_left", "front_right")}
    found = asked(parsers__can__dbc_file='"deploy/vehicles/simulated.dbc"', **signals)
    assert Code.FIXED not in {one.code for one in found.refusals}
