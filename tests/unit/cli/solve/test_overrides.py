import pytest

from cli.solve.overrides import SWITCHES, Aiding, with_settings
from services.core.fusion.process import Config
from services.core.spoofing.process import Config as Spoofing
from shared.errors import UserError
from shared.runtime.config import parse_vehicle
from tests.support.cases import each

VEHICLE = parse_vehicle(
    "[vehicle.gnss]\nlever_arm_body_m = [1.0, 2.0, 3.0]\n[core.fusion.odometer]\nenabled = false\n", "car.toml"
)


def fusion(*settings: str) -> Config:
    return with_settings(VEHICLE, settings).section("core.fusion", Config)


def test_a_setting_overrides_that_of_the_vehicle_only() -> None:
    changed = fusion("vehicle.gnss.lever_arm_body_m=[0.0, 0.5, 0]", "core.fusion.gnss.delay_s = 0.1")
    assert changed.vehicle.gnss.lever_arm_body_m == (0.0, 0.5, 0.0) and changed.gnss.delay_s == 0.1
    assert not changed.odometer.enabled
    assert fusion().vehicle.gnss.lever_arm_body_m == (1.0, 2.0, 3.0), "the file itself is as it was"


def test_a_setting_without_a_process_belongs_to_core_fusion() -> None:
    assert fusion("gnss.delay_s=0.1") == fusion("core.fusion.gnss.delay_s=0.1") != fusion()
    assert fusion("history_s=1.5").history_s == 1.5


@pytest.mark.parametrize(
    ("aiding", "odometer", "non_holonomic"),
    [(Aiding.FREE, False, False), (Aiding.NHC, False, True), (Aiding.ODOMETER, True, True)],
)
def test_aiding_modes_switch_odometer_and_nhc(aiding: Aiding, odometer: bool, non_holonomic: bool) -> None:
    changed = fusion(*SWITCHES[aiding])
    assert (changed.odometer.enabled, changed.non_holonomic.enabled) == (odometer, non_holonomic)


def test_a_word_or_a_path_needs_no_quotes() -> None:
    for text in ("core.spoofing.grade=consumer", 'core.spoofing.grade="consumer"'):
        changed = with_settings(VEHICLE, [text])
        assert changed.section("core.spoofing", Spoofing).grade == "consumer"
    assert (
        with_settings(VEHICLE, ["core.spoofing.profile=/a/b-1.json"]).tables["core.spoofing"]["profile"]
        == "/a/b-1.json"
    )


@each(
    ("setting", "sentence"),
    [
        ("=false", "is invalid"),
        ("core.fusion=false", "is invalid"),
        ("core=false", "is invalid"),
        ("core.fusion.odometer..enabled=false", "is invalid"),
        ("core.fusion.odometer.enabled", "is invalid"),
        ("core.fusio.odometer.enabled=false", "did you mean core.fusion?"),
        ("core.fusion.odometer.enabled=no", "is not a value"),
        ("core.fusion.odometer.enabled=", "is not a value"),
    ],
)
def test_an_invalid_setting_is_reported_in_one_sentence(setting: str, sentence: str) -> None:
    with pytest.raises(UserError, match=sentence):
        with_settings(VEHICLE, [setting])


def test_an_unknown_setting_is_named_with_a_suggestion() -> None:
    with pytest.raises(UserError, match=r"has no setting 'odometer\.enable'; did you mean 'odometer\.enabled'"):
        fusion("core.fusion.odometer.enable=false")
