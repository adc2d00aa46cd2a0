"""Vehicle files of earlier versions: refused by the unit, rewritten by `obu migrate`, translated inside recordings."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from services.core.fusion.settings import Settings as Fusion
from shared.errors import ConfigError
from shared.messages.gnss import FixType, GnssFix
from shared.messages.imu import ImuSamples
from shared.runtime.config import LEVEL_MOUNTING, Matrix3, parse_vehicle
from shared.runtime.migration import migrated, mounting_of_samples
from shared.runtime.mounting import RecordedAxes
from shared.runtime.old_keys import PRESENT_KEYS, in_section
from tests.support.cases import each

OLD = """# my car
[vehicle]
name = "car" # of the family

[parsers.imu]
minimum_delay_s = 0.004
body_from_sensor = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]

[core.fusion]
gnss_delay_s = 0.1 # measured
odometer = false

[core.fusion.imu]
body_from_imu = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
vibration_factor = 2.0
"""


def rows(matrix: object) -> list[list[float]]:
    return [[float(value) for value in row] for row in np.asarray(matrix)]


def old_text(parser: object = None, fusion: object = None) -> str:
    text = "" if parser is None else f"[parsers.imu]\nbody_from_sensor = {rows(parser)}\n"
    return text if fusion is None else f"{text}[core.fusion.imu]\nbody_from_imu = {rows(fusion)}\n"


@each("key", PRESENT_KEYS)
def test_a_file_with_an_old_key_is_refused_by_a_sentence_with_the_new_key_and_the_remedy(key: str) -> None:
    section, _, name = key.rpartition(".")
    with pytest.raises(ConfigError) as raised:
        parse_vehicle(f"[{section}]\n{name} = 1", "car.toml")
    new = in_section(PRESENT_KEYS[key])
    assert str(raised.value) == (
        f"car.toml: [{section}] {name} is of an earlier version; it is {new} now. "
        "`obu migrate car.toml` rewrites the file"
    )


@pytest.mark.parametrize("value", ["true", "false"])
def test_a_setting_without_a_successor_is_refused_by_what_does_its_work_and_removed(value: str) -> None:
    text = f"[core.fusion]\nestimate_delays = {value} # of the GNSS receiver\nhistory_s = 2.0\n"
    work = "a delay of GNSS that the check of the set-up finds is corrected without a setting"
    with pytest.raises(ConfigError) as raised:
        parse_vehicle(text, "car.toml")
    assert str(raised.value) == (
        f"car.toml: [core.fusion] estimate_delays is of an earlier version; it is no more: {work}. "
        "`obu migrate car.toml` rewrites the file"
    )
    new, changes = migrated(text, "car.toml")
    assert changes == [f"[core.fusion] estimate_delays is left out; {work}"]
    assert parse_vehicle(new).tables["core.fusion"] == {"history_s": 2.0}
    assert migrated(new, "car.toml") == (new, []), "once is enough"


def test_every_old_key_is_rewritten_and_all_else_stays() -> None:
    text, changes = migrated(OLD, "car.toml")
    vehicle = parse_vehicle(text, "car.toml")
    assert vehicle.facts.imu.body_from_sensor == ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)), (
        "the correction times the mounting"
    )
    assert vehicle.tables["core.fusion"] == {
        "imu": {"vibration_factor": 2.0}, "gnss": {"delay_s": 0.1}, "odometer": {"enabled": False},
    }  # fmt: skip
    assert vehicle.tables["parsers.imu"] == {"minimum_delay_s": 0.004}
    assert text.startswith('# my car\n[vehicle]\nname = "car" # of the family\n') and "# measured" in text
    assert len(changes) == 3 and any(line.endswith("-> [vehicle.imu] body_from_sensor") for line in changes)
    assert migrated(text, "car.toml") == (text, []), "once is enough"


FACTS = """[core.fusion.gnss]
lever_arm_body_m = [0.3, 0.0, -1.2] # by tape
lever_arm_sd_m = 0.02
delay_s = 0.1

[core.fusion.dual_antenna]
baseline_yaw_body_rad = 1.5

[core.fusion.non_holonomic]
rear_axle_body_m = [-1.0, 0.0, 0.5]

[core.fusion.integrity]
risk = 0.01
alert_limit_horizontal_m = 5.0
alert_limit_vertical_m = 8.0
"""
LEVEL = "body_from_sensor = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]"


@pytest.mark.parametrize(
    "head",
    [
        "",
        '[vehicle]\nname = "car"\n',
        f"[vehicle.imu]\n{LEVEL}\n",
        f'[vehicle]\nname = "car"\n[vehicle.imu]\n{LEVEL}\n[parsers.gnss]\n',
        f'[vehicle.imu]\n{LEVEL}\n[core.trust]\n[vehicle]\nname = "car"\n',
        'vehicle.name = "car"\n',
        'vehicle = {name = "car"}\n',
    ],
)
def test_facts_of_the_vehicle_move_into_its_section_however_the_file_writes_that(head: str) -> None:
    text, changes = migrated(head + FACTS, "car.toml")
    vehicle, before = parse_vehicle(text, "car.toml"), parse_vehicle(head).facts
    assert vehicle.facts == before.with_values({
        "gnss.lever_arm_body_m": (0.3, 0.0, -1.2), "gnss.lever_arm_sd_m": 0.02, "gnss.baseline_yaw_body_rad": 1.5,
        "rear_axle_body_m": (-1.0, 0.0, 0.5), "alert_limit_horizontal_m": 5.0, "alert_limit_vertical_m": 8.0,
    })  # fmt: skip
    fusion = vehicle.section("core.fusion", Fusion)
    assert fusion.vehicle == vehicle.facts and fusion.gnss.delay_s == 0.1 and fusion.integrity.risk == 0.01
    assert "# by tape" in text or "{" in text, "comments stay, but an inline table has no room for them"
    assert len(changes) == 7 and migrated(text, "car.toml") == (text, []), "once is enough"


def test_facts_of_the_first_release_move_to_where_they_are_now() -> None:
    text, _ = migrated("[core.fusion]\nlever_arm_body_m = [0.3, 0.0, -1.2]\nalert_limit_vertical_m = 8\n", "car.toml")
    assert parse_vehicle(text).facts.gnss.lever_arm_body_m == (0.3, 0.0, -1.2)
    assert parse_vehicle(text).facts.alert_limits_m == (10.0, 8.0)


def test_what_another_process_stated_again_is_left_out_and_named() -> None:
    again = "[core.spoofing]\ngnss.lever_arm_body_m = [0.0, 0.0, -1.0]\nlong.rear_axle_distance_m = 2.5\n"
    text, changes = migrated(FACTS + again, "car.toml")
    facts = parse_vehicle(text).facts
    assert facts.gnss.lever_arm_body_m == (0.3, 0.0, -1.2) and facts.rear_axle_body_m == (-1.0, 0.0, 0.5)
    arm, axle = (line.split("; ") for line in changes if "left out" in line)
    assert arm[0] == "[core.spoofing.gnss] lever_arm_body_m = [0.0, 0.0, -1.0] is left out"
    assert arm[1] == "[vehicle.gnss] lever_arm_body_m is that of all processes"
    assert axle[0] == "[core.spoofing.long] rear_axle_distance_m = 2.5 is left out"
    assert axle[1] == "[vehicle] rear_axle_body_m is that of all processes"
    alone = parse_vehicle(migrated(again, "car.toml")[0])
    assert alone.facts == parse_vehicle("").facts, "the position was made without it, and stays so"


def test_a_section_that_has_no_key_any_more_is_removed() -> None:
    text, changes = migrated("[core.fusion.dual_antenna]\n", "car.toml")
    assert parse_vehicle(text).section("core.fusion", Fusion) == Fusion() and len(changes) == 1
    wrong = "[core.fusion.dual_antenna]\nlength_m = 1.0\n"
    assert "length_m" in migrated(wrong, "car.toml")[0], "an unknown key stays, and is named when the file is read"


@given(first=st.integers(0, 2**32), second=st.integers(0, 2**32), which=st.sampled_from(["both", "parser", "fusion"]))
def test_samples_are_in_the_axes_in_which_the_earlier_version_used_them(first: int, second: int, which: str) -> None:
    parser = Rotation.random(rng=first).as_matrix() if which != "fusion" else np.array(LEVEL_MOUNTING)
    fusion = Rotation.random(rng=second).as_matrix() if which != "parser" else np.eye(3)
    text = old_text(parser if which != "fusion" else None, fusion if which != "parser" else None)
    vehicle = parse_vehicle(migrated(text, "car.toml")[0])
    assert np.array(vehicle.facts.imu.body_from_sensor) == pytest.approx(fusion @ parser, abs=1e-8)
    assert np.array(mounting_of_samples(text, "car.toml")) == pytest.approx(parser, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (OLD + "\n[vehicle.imu]\nbody_from_sensor = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n", "remove the older one"),
        (OLD + "\n[core.fusion.gnss]\ndelay_s = 0.2\n", "holds both"),
        (FACTS + "[vehicle]\nalert_limit_vertical_m = 9.0\n", "holds both"),
        ("[core.fusion]\nrear_axle_body_m = [0, 0, 0]\n" + FACTS, "holds both"),
        (old_text(parser=2.0 * np.eye(3)), r"\[parsers.imu\] body_from_sensor: .*length one"),
        ("[parsers.imu]\nbody_from_sensor = 'level'\n", r"\[parsers.imu\] body_from_sensor"),
        ("[core.fusion\n", "not valid TOML"),
    ],
)
def test_what_cannot_be_rewritten_is_named(text: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        migrated(text, "car.toml")


def samples() -> ImuSamples:
    return ImuSamples(
        received_ns=3, source="imu", sampled_ns=(1, 2), magnetic_field_body=(0.3, 0.1, 0.9),
        specific_force_body_m_s2=((0.1, 0.2, -9.8), (0.3, 0.4, -9.7)),
        angular_rate_body_rad_s=((0.01, 0.02, 0.03), (0.0, 0.0, 0.5)),
    )  # fmt: skip


def axes(mounting: Matrix3 | None, then: Matrix3 | None) -> RecordedAxes:
    text = "" if mounting is None else f"[vehicle.imu]\nbody_from_sensor = {rows(mounting)}"
    return RecordedAxes(replace(parse_vehicle(text), samples_mounting=then))


def test_recorded_samples_are_turned_from_the_mounting_of_then_to_that_of_now() -> None:
    quarter: Matrix3 = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0))
    turned = axes(quarter, LEVEL_MOUNTING).apply(samples())
    assert isinstance(turned, ImuSamples)
    assert turned.specific_force_body_m_s2 == ((-0.2, 0.1, -9.8), (-0.4, 0.3, -9.7))
    assert turned.angular_rate_body_rad_s[0] == (-0.02, 0.01, 0.03)
    assert turned.magnetic_field_body == (-0.1, 0.3, 0.9)
    assert (turned.sampled_ns, turned.received_ns) == ((1, 2), 3)


def test_samples_of_the_same_mounting_and_other_messages_stay_as_they_are() -> None:
    one = samples()
    assert axes(None, LEVEL_MOUNTING).apply(one) is one
    assert axes(LEVEL_MOUNTING, None).apply(one) is one, "of a unit that drives, not of a recording"
    fix = GnssFix(sampled_ns=1, received_ns=1, source="gnss", fix_type=FixType.NONE)
    assert axes(((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)), LEVEL_MOUNTING).apply(fix) is fix
