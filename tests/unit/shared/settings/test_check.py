"""What a change of settings would do, before anything is written."""

import json

import pytest

from shared.runtime.config import parse_vehicle
from shared.settings.check import Code, answer, digests
from shared.settings.question import Question

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
    ],
)
def test_what_cannot_be_changed_is_refused_by_its_code(name: str, value: str, code: Code) -> None:
    found = answer(Question(path="car.toml", text=TEXT, changes={name: value}))
    assert [one.code for one in found.refusals] == [code] and not found.text


def test_passwords_of_addresses_are_never_told() -> None:
    text = TEXT.replace("serial:///dev/ttyACM0", "tcp://user:hidden@10.0.0.1:2947")
    found = answer(Question(path="car.toml", text=text, changes={"sensors.gnss.device": '"serial:///dev/ttyACM1"'}))
    told = json.dumps([one.model_dump() for one in (*found.differences, *found.settings)])
    assert "hidden" not in told and "10.0.0.1" in told


def test_an_earlier_text_is_restored_as_a_whole_and_a_broken_one_is_refused() -> None:
    earlier = TEXT.replace("0.1", "0.2")
    found = answer(Question(path="car.toml", text=TEXT, replacement=earlier, earlier=(TEXT,)))
    assert found.text == earlier and found.counts == (len(found.differences),)
    broken = answer(Question(path="car.toml", text=TEXT, replacement="[vehicle"))
    assert [one.code for one in broken.refusals] == [Code.INVALID]
