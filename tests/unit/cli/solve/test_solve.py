"""End-to-end test: import of CSV files of a simulated drive, solution, comparison with the simulated truth."""

import csv
import json
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import pytest

from cli.import_drive.import_drive import import_drive
from cli.solve.files import HEADER
from cli.solve.metrics.metrics import METRICS, TIMINGS, as_objects
from cli.solve.metrics.trust import TRUST
from cli.solve.overrides import Aiding
from cli.solve.report.drawing import Figure
from cli.solve.smoothing import SMOOTHED_METRICS
from cli.solve.solve import solve
from services.sensors.simulator.drive import simulate
from services.sensors.simulator.world import messages
from shared.errors import UserError
from shared.messages.base import RawBytes
from shared.messages.imu import ImuSamples
from shared.messages.neighbours import NeighbourStates
from shared.messages.trust import TrustLevel
from shared.recording import Recording, RecordingWriter
from shared.runtime.live import arrival_ns
from tests.support.bus.envelopes import sent
from tests.support.drives.csv_drive import write_drive

Metrics = dict[str, float]
WRITTEN = ["verdict", "verdict_codes", *as_objects(dict.fromkeys(METRICS))]  # keys of metrics.json

DURATION_S = 70.0


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drive")
    mapping = write_drive(folder, simulate("parking_lot", seed=3, duration_s=DURATION_S))
    import_drive(mapping, folder, folder / "drive.mcap")
    return folder / "drive.mcap"


@pytest.fixture(scope="module")
def solution(recording: Path) -> Path:
    assert solve(recording, out=recording.parent / "whole") == 0
    return recording.parent / "whole"


@pytest.fixture(scope="module")
def smoothed(recording: Path) -> Path:
    assert solve(recording, out=recording.parent / "smoothed", smooth=True) == 0
    return recording.parent / "smoothed"


@dataclass(frozen=True)
class SolveOutput:
    """Output folder of `obu solve --json`, and what it printed."""

    folder: Path
    out: str


@pytest.fixture(scope="module")
def with_outages(recording: Path) -> SolveOutput:
    """Three outages of 5 s, filtered and smoothed."""
    out, folder = StringIO(), recording.parent / "cut"
    with redirect_stdout(out), pytest.MonkeyPatch.context() as patch:
        one_empty_figure(patch)
        assert solve(recording, outage="5/15", smooth=True, out=folder, as_json=True) == 0
    return SolveOutput(folder, out.getvalue())


@pytest.fixture
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    one_empty_figure(monkeypatch)


def one_empty_figure(patch: pytest.MonkeyPatch) -> None:
    """Draw no other: drawing takes most of the time of a short recording."""
    patch.setattr("cli.solve.report.plots.figures_of", lambda *_: [Figure("Trajectory", "", "<svg></svg>")])


def metrics_in(folder: Path) -> Metrics:
    found: Metrics = json.loads((folder / "metrics.json").read_text())
    return found


def test_the_imported_messages_equal_the_simulated_ones(recording: Path) -> None:
    drive = simulate("parking_lot", seed=3, duration_s=DURATION_S)
    with Recording(recording) as opened:
        decoded = [envelope.decode() for envelope in opened]
    samples = [message for message in decoded if isinstance(message, ImuSamples)]
    assert [m.sampled_ns[0] - 1_700_000_000_000_000_000 for m in samples] == drive.t_ns.tolist()
    force = [component for m in samples[::100] for component in m.specific_force_body_m_s2[0]]
    assert force == pytest.approx(drive.force_b[::100].ravel().tolist(), abs=1e-6)


def test_the_solution_is_close_to_the_truth_of_the_simulation(solution: Path) -> None:
    found = metrics_in(solution)
    # A car park under an open sky with 1 Hz single-frequency GNSS, as in tests of the fusion: below a metre.
    assert found["horizontal_rmse_m"] < 1.0
    assert found["velocity_rmse_m_s"] < 0.1
    assert abs(found["yaw_rmse_rad"]) < 0.05 and found["roll_rmse_rad"] < 0.01 and found["pitch_rmse_rad"] < 0.01
    assert found["truth_count"] > 400 and found["fixes_rejected"] <= 3 and found["outage_count"] is None
    assert found["fixes_recorded"] >= found["fixes_used"] > 40
    assert list(found) == WRITTEN


def test_outages_remove_fixes_and_their_metrics_are_printed(solution: Path, with_outages: SolveOutput) -> None:
    whole, cut = metrics_in(solution), metrics_in(with_outages.folder)
    assert cut["outage_count"] == 3
    assert 15 <= cut["fixes_removed"] <= 21, "1 Hz: five or six fixes in each gap, evaluated or not"
    assert cut["fixes_used"] == pytest.approx(whole["fixes_used"] - cut["fixes_removed"], abs=2)
    # 10 s of inertial navigation with an MTi-630 end within 0.6 m of the error before (0.9 m for 95 %).
    assert cut["outage_end_error_max_m"] < whole["horizontal_max_m"] + 1.0
    found = json.loads(with_outages.out)
    assert list(found) == [*WRITTEN, *SMOOTHED_METRICS, *TIMINGS]
    assert {name: found[name] for name in (*WRITTEN, *SMOOTHED_METRICS)} == cut
    assert found["realtime_factor"] > 0.0


@pytest.mark.usefixtures("without_figures")
def test_outages_at_fixed_times_are_listed_and_settings_override_those_of_the_vehicle(
    recording: Path, tmp_path: Path
) -> None:
    solve(recording, outage="5/15@30", score_from=20.0, aiding=Aiding.FREE, out=tmp_path)
    with (tmp_path / "outages.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["start_s"]) for row in rows] == [30.0, 45.0, 60.0]
    found = metrics_in(tmp_path)
    assert found["outage_end_error_max_m"] == pytest.approx(max(float(row["end_error_m"]) for row in rows), abs=1e-4)
    assert found["truth_count"] == pytest.approx(500, abs=5), "50 of 70 s at 10 Hz"
    assert "core.fusion.non_holonomic.enabled=false" in (tmp_path / "report.html").read_text()
    with pytest.raises(UserError, match=r"^--set core\.fusion\.odometr=true: .*did you mean 'odometer\.\w+'"):
        solve(recording, settings=["core.fusion.odometr=true"], out=tmp_path)


@pytest.mark.slow
def test_the_same_recording_gives_the_same_files(
    recording: Path, solution: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    solve(recording, out=tmp_path)
    assert "\r" not in capsys.readouterr().err, "no progress bar without a terminal, but a line every ten seconds"
    files = sorted(path.name for path in solution.iterdir())
    assert files == ["metrics.json", "report.html", "solution.csv", "solution.kml"]
    for name in files:
        assert (solution / name).read_bytes() == (tmp_path / name).read_bytes(), name


def test_the_csv_has_one_line_per_solution_with_its_verdict(solution: Path) -> None:
    with (solution / "solution.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert tuple(rows[0]) == HEADER and len(rows) == metrics_in(solution)["solution_count"] + 1
    assert {row[-1] for row in rows[1:]} <= set(TrustLevel) and "caution" in {row[-1] for row in rows[1:]}


def test_core_trust_runs_and_can_be_left_out(recording: Path, solution: Path, tmp_path: Path) -> None:
    found = json.loads((solution / "metrics.json").read_text())
    assert sum(found["trust_seconds"].values()) == pytest.approx(found["duration_s"], abs=1e-3)
    assert found["gnss_excluded_s"] == 0.0 and found["harm_ratio"] == 1.0 and found["without_solution_s"] == 0.0
    report = (solution / "report.html").read_text()
    assert "Verdict of core.trust: " in report and "<h2>Verdict</h2>" in report
    with pytest.MonkeyPatch.context() as patch:
        one_empty_figure(patch)
        assert solve(recording, without="trust", out=tmp_path) == 0
    bare = json.loads((tmp_path / "metrics.json").read_text())
    unknown = as_objects(dict.fromkeys(TRUST))
    assert list(bare) == list(found) and all(bare[name] is None for name in unknown)
    assert {name: bare[name] for name in bare if name not in unknown} == {
        name: found[name] for name in found if name not in unknown
    }, "nothing was excluded, and then core.trust changes nothing"
    with pytest.raises(UserError, match=r"--without fusion is not possible; only core\.trust can be left out"):
        solve(recording, without="fusion", out=tmp_path)
    assert "core.trust" in (tmp_path / "report.html").read_text(), "among the settings"


@pytest.mark.usefixtures("without_figures")
def test_a_solution_file_is_accepted_as_truth(recording: Path, solution: Path, tmp_path: Path) -> None:
    solve(recording, truth=str(solution / "solution.csv"), out=tmp_path)
    found = metrics_in(tmp_path)
    assert found["truth_count"] > 400
    assert found["horizontal_rmse_m"] < 1e-3 and found["yaw_rmse_rad"] < 1e-6, "up to the rounding of the file"


@pytest.mark.usefixtures("without_figures")
def test_a_recording_of_raw_bytes_is_parsed_and_solved(tmp_path: Path) -> None:
    toml = '[vehicle]\nname = "raw"\n\n[vehicle.gnss]\nlever_arm_body_m = [0.3, 0.0, -1.2]\n'
    writer = RecordingWriter(tmp_path / "raw.mcap", vehicle="raw", vehicle_toml=toml)
    for message in messages("parking_lot", seed=3, duration_s=DURATION_S):
        writer.write(sent(message, arrival_ns(message) or 0))
        assert isinstance(message, RawBytes | NeighbourStates) or arrival_ns(message) is None
    writer.close()
    solve(tmp_path / "raw.mcap", outage="5/15", out=tmp_path / "out")
    found = metrics_in(tmp_path / "out")
    assert found["truth_count"] > 400 and found["outage_count"] == 3
    assert found["fixes_removed"] >= 12, "a gap begins and ends within the bytes of a fix"
    assert found["horizontal_rmse_m"] < 2.0


def test_an_unsolvable_recording_is_reported_in_one_sentence(recording: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="obu record"):
        solve(tmp_path / "absent.mcap", out=tmp_path)
    RecordingWriter(tmp_path / "empty.mcap").close()
    with pytest.raises(UserError, match=r"empty\.mcap holds no messages of a unit"):
        solve(tmp_path / "empty.mcap", out=tmp_path)
    with pytest.raises(UserError, match=r"--score-from begins at 1e\+06 s, but the duration of .* is \d+ s"):
        solve(recording, score_from=1e6, out=tmp_path)
    with pytest.raises(UserError, match=r"--outage begins at 9000 s, but .* use an earlier time"):
        solve(recording, outage="60/180@9000", out=tmp_path)
    with pytest.raises(UserError, match="no fix of the recording has RTK quality"):
        solve(recording, truth="fixes", out=tmp_path)
    with pytest.raises(UserError, match="--truth is fixes, recorded, none or a CSV file"):
        solve(recording, truth="fixed", out=tmp_path)
    with pytest.raises(UserError, match="--outage"):
        solve(recording, outage="10", out=tmp_path)
    (tmp_path / "vehicle.toml").write_text("[core.fusion]\nlever_arm_body = 1\n")
    with pytest.raises(UserError, match=r"did you mean \[vehicle\.gnss\] lever_arm_body_m"):
        solve(recording, vehicle=tmp_path / "vehicle.toml", out=tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot create the folder"):
        solve(recording, out=tmp_path / "file")


@pytest.mark.usefixtures("without_figures")
def test_the_report_states_that_there_is_no_truth(recording: Path, tmp_path: Path) -> None:
    solve(recording, truth="none", out=tmp_path)
    found = metrics_in(tmp_path)
    assert found["horizontal_rmse_m"] is None and found["innovation_horizontal_rms_m"] > 0.0
    assert "Truth: none." in (tmp_path / "report.html").read_text()


def test_the_error_for_a_parked_vehicle_states_the_missing_alignment(tmp_path: Path) -> None:
    mapping = write_drive(tmp_path, simulate("parking_lot", seed=3, duration_s=10.0))
    import_drive(mapping, tmp_path, tmp_path / "drive.mcap")
    with pytest.raises(UserError, match="never aligned"):
        solve(tmp_path / "drive.mcap", out=tmp_path / "out")


@pytest.mark.usefixtures("without_figures")
def test_a_truncated_recording_is_solved_up_to_its_end(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = recording.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) * 3 // 4])
    assert solve(tmp_path / "cut.mcap", out=tmp_path / "out") == 0
    assert "cut.mcap: " in capsys.readouterr().err
    assert 30.0 < metrics_in(tmp_path / "out")["duration_s"] < DURATION_S


def test_the_smoothed_drive_is_written_and_more_accurate_than_the_filtered_one(solution: Path, smoothed: Path) -> None:
    assert (smoothed / "solution.csv").read_bytes() == (solution / "solution.csv").read_bytes(), "the filtered track"
    found = metrics_in(smoothed)
    assert list(found) == [*WRITTEN, *SMOOTHED_METRICS]
    for name in ("horizontal_rmse_m", "vertical_rmse_m", "velocity_rmse_m_s", "yaw_rmse_rad"):
        assert found[f"smoothed_{name}"] < found[name], name
    assert (smoothed / "solution_smoothed.kml").read_text().count("<gx:Track>") == 1
    report = (smoothed / "report.html").read_text()
    assert "Position errors, filtered and smoothed" in report and "Smoothed: " in report
    assert "smoothed_horizontal_rmse_m" in report
    assert not [path.name for path in smoothed.iterdir() if path.stem.startswith("tmp")]


def test_the_smoothed_drive_has_smaller_outage_errors(with_outages: SolveOutput) -> None:
    found = metrics_in(with_outages.folder)
    assert found["smoothed_outage_inside_max_m"] < found["outage_inside_max_m"]
    assert found["smoothed_outage_largest_error_rms_m"] < found["outage_largest_error_rms_m"]


@pytest.mark.usefixtures("without_figures")
def test_a_smoothed_solution_is_accepted_as_truth(
    recording: Path, smoothed: Path, with_outages: SolveOutput, tmp_path: Path
) -> None:
    found = metrics_in(with_outages.folder)
    assert solve(recording, truth=str(smoothed / "solution_smoothed.csv"), outage="5/15", out=tmp_path) == 0
    compared = metrics_in(tmp_path)
    assert compared["truth_count"] > 400
    assert compared["outage_end_error_max_m"] == pytest.approx(found["outage_end_error_max_m"], abs=0.5)


def test_clocks_18_s_apart_are_the_verdict_with_what_to_set(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], without_figures: None
) -> None:
    mapping = write_drive(tmp_path, simulate("parking_lot", seed=3, duration_s=DURATION_S))
    lines = mapping.read_text().splitlines()
    gnss = lines.index("[gnss]")
    clock = next(k for k in range(gnss, len(lines)) if lines[k].startswith("time = "))
    lines[clock] = lines[clock].replace(" }", ", offset_s = 18.0 }")
    mapping.write_text("\n".join(lines))
    assert import_drive(mapping, tmp_path, tmp_path / "drive.mcap") == 0
    assert "probably 18 s apart" in capsys.readouterr().out
    assert solve(tmp_path / "drive.mcap", out=tmp_path / "out") == 0
    first = capsys.readouterr().out.splitlines()[0]
    found = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert first.startswith("This is no sound solution: ") and "probably 18 s apart" in first
    assert found["verdict"].startswith(first) and found["fixes_used_fraction"] < 0.5
    assert first.partition(" and ")[0] in (tmp_path / "out" / "report.html").read_text()


def test_a_sound_drive_says_what_share_of_the_fixes_was_used(solution: Path) -> None:
    found = json.loads((solution / "metrics.json").read_text())
    assert found["fixes_used_fraction"] > 0.95 and "sound" not in found["verdict"]
