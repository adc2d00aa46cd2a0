"""The sets of hardware from which a set-up begins: valid, and each parses a recording of its devices."""

import json
from pathlib import Path
from typing import cast

import pytest

from cli.config.sets import begin
from services.monitoring.status.views.sets import sets
from shared.errors import UserError
from shared.messages.base import Message
from shared.messages.gnss import GnssFix, GnssRaw
from shared.messages.imu import ImuRaw, ImuSamples
from shared.messages.vehicle import CanRaw, VehicleSpeed
from shared.runtime.config import VehicleFile, load_vehicle
from shared.runtime.offline import OfflineUnit
from shared.settings.check import answer
from shared.settings.edit import checked
from shared.settings.question import Question
from tests.support.cases import each
from tests.support.data import REPOSITORY, recording

SETS = REPOSITORY / "deploy" / "vehicles" / "sets"
NAMES = sorted(path.stem for path in SETS.glob("*.toml"))
CHUNK, EVERY_NS = 400, 20_000_000


def parsed(vehicle: VehicleFile, kind: type[GnssRaw | ImuRaw], path: Path, most: int = 60_000) -> list[Message]:
    """What the unit makes of the first bytes of a file, each chunk 20 ms after the one before."""
    data = path.read_bytes()[:most]
    raw = (
        kind(received_ns=10**15 + k * EVERY_NS, source="device", data=data[k * CHUNK : (k + 1) * CHUNK])
        for k in range(len(data) // CHUNK + 1)
    )
    return list(OfflineUnit(vehicle).run(raw))


@each("name", NAMES)
def test_a_set_is_a_valid_file_of_a_vehicle_and_can_be_begun_from(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / f"{name}.toml"
    assert begin(name, out=out, vehicle_name="van-3") == 0
    assert checked(out.read_text(), str(out)).facts.name == "van-3"
    with pytest.raises(UserError, match="already exists"):
        begin(name, out=out)
    capsys.readouterr()
    assert begin() == 0 and name in capsys.readouterr().out


def test_a_set_that_is_not_there_is_an_error_that_lists_them(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="f9p_xsens, f9r, m9n_line_imu, nmea_obd, simulated"):
        begin("f9x", out=tmp_path / "out.toml")


def test_the_page_shows_each_set_with_what_it_is_and_what_it_sets() -> None:
    shown = {str(one["name"]): one for one in sets()}
    assert sorted(shown) == NAMES
    settings = shown["f9r"]["settings"]
    assert isinstance(settings, dict) and settings["parsers.gnss.use_receiver_imu"] == "true"
    assert all(str(one["what"]).strip() for one in shown.values())
    assert shown["simulated"]["runs"] == {
        "sensors.gnss": False, "sensors.imu": False, "sensors.can": False, "sensors.simulator": True
    }  # fmt: skip


def test_a_table_that_is_one_setting_is_one_value_and_a_process_is_none() -> None:
    settings = sets(["parsers.imu.line", "sensors.simulator"])
    lines = next(one["settings"] for one in settings if one["name"] == "m9n_line_imu")
    assert isinstance(lines, dict) and json.loads(lines["parsers.imu.line"])["form"] == "csv"
    simulated = next(one["settings"] for one in settings if one["name"] == "simulated")
    assert isinstance(simulated, dict) and simulated["sensors.simulator.scenario"] == '"urban"'
    # It is the file of the demo; only the vehicle's name and the page's port are those of each.
    whole, own = (load_vehicle(SETS / name).tables for name in ("../simulated.toml", "simulated.toml"))
    assert {k: v for k, v in whole.items() if k not in ("vehicle", "monitoring.status")} == {
        k: v for k, v in own.items() if k != "vehicle"
    }


@each("name", NAMES)
def test_a_set_can_be_chosen_on_the_page_of_a_unit_of_any_other(name: str) -> None:
    chosen = next(one for one in sets(["parsers.imu.line"]) if one["name"] == name)
    runs, settings = (cast("dict[str, object]", chosen[part]) for part in ("runs", "settings"))
    changes = {one: str(on).lower() for one, on in runs.items()} | cast("dict[str, str | None]", settings)
    for path in SETS.glob("*.toml"):
        if path.stem == name:
            continue
        found = answer(Question(path=str(path), text=path.read_text(), changes=changes))
        assert not found.refusals, (path.stem, found.refusals)
        assert {one for one, on in runs.items() if on} <= found.digests.keys()


@pytest.mark.recording
def test_f9p_and_xsens_read_recordings_of_both() -> None:
    vehicle = load_vehicle(SETS / "f9p_xsens.toml")
    made = parsed(vehicle, GnssRaw, recording("gpsd_receiver_logs/ublox-zed-f9p-rtk.log"))
    assert sum(isinstance(message, GnssFix) for message in made) > 3
    made = parsed(vehicle, ImuRaw, recording("xsens_xbus/1/output.bin"))
    assert sum(len(message.sampled_ns) for message in made if isinstance(message, ImuSamples)) > 50


@pytest.mark.recording
def test_f9r_reads_a_recording_of_one() -> None:
    made = parsed(load_vehicle(SETS / "f9r.toml"), GnssRaw, recording("gpsd_receiver_logs/ublox-zed-f9r.log"))
    assert sum(isinstance(message, GnssFix) for message in made) > 3


@pytest.mark.recording
def test_nmea_and_obd_read_recordings_of_both() -> None:
    vehicle = load_vehicle(SETS / "nmea_obd.toml")
    name = "google_f9k_span/MTV.Local1.ublox-F9K.20200206-181434.nmea"
    made = parsed(vehicle, GnssRaw, recording(name))
    assert sum(isinstance(message, GnssFix) for message in made) > 10
    with recording("canedge_obd_gnss/drive164/candump.log").open() as file:
        lines = [next(file) for _ in range(4000)]
    frames = [
        CanRaw(received_ns=10**15 + k * 10**7, source="can", data="".join(lines[40 * k : 40 * k + 40]).encode())
        for k in range(100)
    ]
    speeds = [message for message in OfflineUnit(vehicle).run(frames) if isinstance(message, VehicleSpeed)]
    assert len(speeds) > 10


@pytest.mark.recording
def test_lines_of_text_are_read_as_a_low_cost_unit_has_sent_them() -> None:
    vehicle = load_vehicle(SETS / "m9n_line_imu.toml")
    made = parsed(vehicle, ImuRaw, recording("rtkexp_drive/raw_imu_1934.csv"))
    samples = [
        force for message in made if isinstance(message, ImuSamples) for force in message.specific_force_body_m_s2
    ]
    assert len(samples) > 500
    assert samples[10][2] == pytest.approx(-9.8, abs=0.6), "g, and z of the sensor upwards"
