"""The benchmark on drives: pooled metrics, printed tables, and the documented input files of peers."""

import json
import stat
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import tables
from benchmarks.navigation import report, runs
from benchmarks.navigation.cases import CASES, DRIVES, GNSS_ALONE, ROWS, Row
from benchmarks.navigation.peers import PEERS
from benchmarks.navigation.peers.common import PeerInput, given, judged, protocol_gaps, thinned
from benchmarks.navigation.peers.kf_gins import KfGins
from benchmarks.navigation.peers.ob_gins import at_whole_seconds
from benchmarks.navigation.runs import MAPPINGS, Metrics, SolveRun, jobs_of, metrics_of, pooled
from cli.solve.metrics.metrics import METRICS
from tests.support.data import REPOSITORY

PLACE = (np.radians(30.4), np.radians(114.4), 20.0)


def test_every_row_names_a_case_and_a_metric_and_every_drive_a_mapping() -> None:
    assert {row.case for row in ROWS} <= set(CASES)
    assert {row.metric for row in ROWS} <= set(METRICS)
    assert all((MAPPINGS / f"{drive.mapping}.toml").is_file() for drive in DRIVES.values())
    assert {case.drive for case in CASES.values()} <= set(DRIVES)


def test_outages_of_shifted_runs_are_evaluated_as_one_set() -> None:
    runs = [
        [{"end_error_m": 3.0, "largest_error_m": 4.0, "distance_m": 300.0}],
        [{"end_error_m": 1.0, "largest_error_m": 2.0, "distance_m": 5.0}],
        [{"end_error_m": 2.0, "largest_error_m": 2.0, "distance_m": 100.0}],
    ]
    found = pooled(runs)
    assert found["outage_count"] == 3 and found["outage_end_error_median_m"] == 2.0
    assert found["outage_largest_error_rms_m"] == pytest.approx(np.sqrt((16 + 4 + 4) / 3))
    assert found["outage_end_error_share_median"] == pytest.approx(0.015), "5 m of way are none"
    assert set(found) <= set(METRICS)
    assert pooled([[]]) == {"outage_count": 0}


def test_a_case_is_one_run_or_one_an_outage_pattern() -> None:
    assert [job.arguments for job in jobs_of("truck", CASES["truck"])] == [("truck", ("--score-from", "0.0"))]
    shifted = jobs_of("rtk free 60 s", CASES["rtk free 60 s"])
    common = ("--score-from", "0.0", "--aiding", "free", "--outage")
    assert [job.arguments for job in shifted] == [
        ("rtk", (*common, f"60/180@{start}")) for start in ("650", "710", "770")
    ]


def test_a_case_of_which_a_run_is_missing_is_not_measured() -> None:
    cases = {"truck": CASES["truck"], "rtkexp free 15 s": CASES["rtkexp free 15 s"]}
    jobs = [job for key, case in cases.items() for job in jobs_of(key, case)]
    outage = {"end_error_m": 3.0, "largest_error_m": 4.0, "distance_m": 300.0}
    found = {number: SolveRun({"yaw_sd_rad": 0.01 * number}, [outage]) for number in range(len(jobs))}
    assert metrics_of(cases, jobs, found)["truck"] == {"yaw_sd_rad": 0.0}
    assert metrics_of(cases, jobs, found)["rtkexp free 15 s"]["outage_count"] == 3
    del found[2]
    assert set(metrics_of(cases, jobs, found)) == {"truck"}


@pytest.mark.parametrize("outages", [[], [{"end_error_m": 3.0, "distance_m": 300.0}]])
def test_a_run_has_what_obu_solve_wrote(monkeypatch: pytest.MonkeyPatch, outages: list[dict[str, float]]) -> None:
    def obu(arguments: list[str]) -> None:
        assert arguments[0] == "solve" and arguments[1].endswith("truck.mcap") and arguments[-1] == "free"
        folder = Path(arguments[3])
        (folder / "metrics.json").write_text('{"yaw_sd_rad": 0.1, "trust_seconds": null}')
        if outages:
            (folder / "outages.csv").write_text("end_error_m,distance_m\n3.0,300.0\n")

    monkeypatch.setattr(runs, "_obu", obu)
    assert runs.solve("truck", ("--aiding", "free")) == SolveRun({"yaw_sd_rad": 0.1, "trust_seconds": None}, outages)


def test_a_missed_goal_is_reported_in_the_units_of_its_row() -> None:
    assert report.shown(Row("a", "yaw", "yaw_rmse_rad", "deg"), {"yaw_rmse_rad": np.pi / 180}) == pytest.approx(1.0)
    assert report.shown(Row("a", "share", "outage_end_error_share_median", "%"),
                        {"outage_end_error_share_median": 0.02}) == pytest.approx(2.0)  # fmt: skip
    document = report.Document(
        measured_at="2026-01-01T00:00:00+00:00", machine="a machine", load_before=0.0, quick=False,
        cases={"truck": {"yaw_sd_rad": 0.0175}, "balzer": {"fixes_rejected": 0, "filter_resets": 0}},
        speed={"rtk": {"us_per_sample": 7.123, "samples": 10, "peak_mb": 50.0}},
        peers={"KF-GINS": {"absent": "OBU_KF_GINS names no program.", "sets": {}}},
    )  # fmt: skip
    text = report.page(document)
    assert "| truck | heading, standard deviation about its mean | 1 deg |  | <= 1 | **no** |" in text
    assert "| balzer | filter resets | 0 |  | <= 0 | yes |" in text
    assert "| comma | horizontal RMSE | not measured | not measured | <= 0.44 and <= receiver only |  |" in text
    assert "| ours | rtk | 7.12 | 50 |" in text and "KF-GINS: not run. OBU_KF_GINS names no program." in text


def test_the_documented_table_is_that_of_the_last_run() -> None:
    kept = REPOSITORY / "benchmarks" / "results" / "navigation.json"
    printed = (REPOSITORY / "docs" / "reference" / "drives.md").read_text(encoding="utf-8")
    page = report.HEAD + report.page(json.loads(kept.read_text(encoding="utf-8")))
    assert printed == tables.headed("docs/reference/drives.md", page), "run `make drives`"


def test_a_solution_worse_than_gnss_alone_misses_the_goal() -> None:
    def line(ours: float, at_fixes: float | None = None, alone: float | None = None) -> str:
        metrics: Metrics = {
            "horizontal_rmse_m": ours,
            "at_fixes_horizontal_rmse_m": at_fixes,
            "gnss_alone_horizontal_rmse_m": alone,
        }
        cells = report.rows_of({"navmatlab": metrics})
        return next(" | ".join(row[2:6]) for row in cells if row[:2] == ("navmatlab", "horizontal RMSE"))

    goals = "<= 0.65 and <= receiver only"
    assert line(0.6, 0.61, 0.69) == f"0.6 m | 0.69 m (ours 0.61 m) | {goals} | yes"
    assert line(0.6, 0.61, 0.59).endswith("**no**") and line(0.66, 0.61, 0.69).endswith("**no**")
    assert line(0.6) == f"0.6 m | not measured | {goals} | ", "undecided"
    assert line(0.66).endswith("**no**"), "one missed goal decides"


def test_every_row_with_truth_has_a_goal() -> None:
    without = {row.case for row in ROWS if row.goal is None and not row.at_most_gnss}
    assert without == {"balzer"}, "which has no truth"
    assert {name for row in ROWS if row.at_most_gnss for name in GNSS_ALONE[row.metric]} <= set(METRICS)


def test_the_how_to_holds_the_tables_of_the_last_run() -> None:
    kept = json.loads((REPOSITORY / "benchmarks" / "results" / "navigation.json").read_text(encoding="utf-8"))
    text = report.HOW_TO.read_text(encoding="utf-8")
    assert text == report.with_tables(text, kept), "run `python -m benchmarks.navigation --print`"
    assert {case for _, *cases in report.REAL_DRIVES for case in cases if case} <= set(CASES)
    with pytest.raises(ValueError, match="printed by"):
        report.with_tables("no marks", kept)


@pytest.fixture
def small_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PeerInput:
    """Make a set in the form of rtk_drive_57min, of a car that drives north at 10 m/s for a while."""
    folder = tmp_path / DRIVES["rtk"].folder
    folder.mkdir(parents=True)
    monkeypatch.setenv("OBU_DATA", str(tmp_path))
    truth_s, imu_s = np.arange(456250.0, 456720.0, 0.05), np.arange(456250.0, 456720.0, 0.05)
    north = (truth_s - truth_s[0]) * 10.0 / 6_352_000.0
    lla = np.column_stack([PLACE[0] + north, np.full(len(north), PLACE[1]), np.full(len(north), PLACE[2])])
    velocity, still = np.tile([10.0, 0.0, 0.0], (len(north), 1)), np.zeros((len(north), 3))
    np.savez(folder / "truth_20hz.npz", t_s=truth_s, lla=lla, velocity_ned_m_s=velocity, rpy_rad=still)
    np.savez(folder / "imu.npz", t_s=imu_s, dtheta_rad=still, dvel_m_s=np.tile([0.0, 0.0, -0.49], (len(imu_s), 1)))
    fixes_s = np.arange(456251.0021, 456719.0, 1.0)
    lat = np.degrees(PLACE[0] + (fixes_s - truth_s[0]) * 10.0 / 6_352_000.0)
    columns = [fixes_s, lat, np.full_like(lat, np.degrees(PLACE[1])), np.full_like(lat, PLACE[2])]
    rest = np.tile([0.01, 0.01, 0.02, 10.0, 0.0, 0.0, 0.03, 0.03, 0.05], (len(lat), 1))
    np.savetxt(folder / "gnssv.txt", np.column_stack([*columns, rest]), fmt="%.10f")
    np.savetxt(folder / "odo.txt", np.column_stack([imu_s[::2], np.full(len(imu_s[::2]), 10.0)]), fmt="%.3f")
    return given("rtk")


def test_a_set_is_read_with_the_true_state_at_the_start(small_set: PeerInput) -> None:
    assert small_set.rate_hz == 20 and small_set.imu.shape[1] == 7 and small_set.gnss.shape[1] == 13
    assert small_set.initial[:3] == pytest.approx([np.degrees(PLACE[0] + 500.0 / 6_352_000.0), 114.4, 20.0])
    assert small_set.initial[3:6] == pytest.approx([10.0, 0.0, 0.0])


def test_outages_of_peers_are_those_of_obu_solve(small_set: PeerInput) -> None:
    gaps = protocol_gaps(650)
    assert len(gaps) == 15 and gaps[0] == (456_900_000_000_000, 456_960_000_000_000)
    assert gaps[-1][1] == 459_480_000_000_000
    hidden = small_set.without([(456_300_000_000_000, 456_360_000_000_000)])
    assert len(small_set.gnss) - len(hidden.gnss) == 60


def test_fixes_are_carried_to_the_whole_second_that_ob_gins_wants(small_set: PeerInput) -> None:
    rows = at_whole_seconds(small_set.gnss)
    assert rows[:, 0] == pytest.approx(np.round(small_set.gnss[:, 0]), abs=1e-9)
    back_m = np.radians(small_set.gnss[:, 1] - rows[:, 1]) * 6_352_000.0
    assert back_m == pytest.approx(0.021, abs=2e-4), "2.1 ms at 10 m/s"
    fast = small_set.gnss.copy()
    fast[:, 0] += 0.2
    assert len(at_whole_seconds(fast)) == 0, "fixes between seconds are left out"


def test_a_result_equal_to_the_truth_has_no_error(small_set: PeerInput) -> None:
    time_s = np.arange(456300.0, 456719.0, 0.005)
    lat = np.degrees(PLACE[0] + (time_s - 456250.0) * 10.0 / 6_352_000.0)
    rows = np.column_stack([time_s, lat, np.full_like(lat, 114.4), np.full_like(lat, 20.0), np.zeros((len(lat), 6))])
    rows[:, 4], rows[:, 9] = 10.0, 0.5
    kept = thinned(rows)
    assert np.diff(kept[:, 0]) == pytest.approx(0.05, abs=1e-6)
    found = judged(kept, small_set.truth)
    assert found["horizontal_rmse_m"] < 0.01, "a meridian's metre is not quite that of a sphere"
    assert found["velocity_horizontal_rmse_m_s"] == 0.0 and found["yaw_rmse_deg"] == pytest.approx(0.5)


FAKE = """#!{python}
import sys
from pathlib import Path
import numpy as np
import yaml

config = yaml.safe_load(Path(sys.argv[1]).read_text())
imu, gnss = np.loadtxt(config["imupath"]), np.loadtxt(config["gnsspath"])
assert imu.shape[1] == config["imudatalen"] == 7 and gnss.shape[1] == 7
rows = imu[(imu[:, 0] > config["starttime"]) & (imu[:, 0] < gnss[-1, 0]), 0]
lat = np.interp(rows, gnss[:, 0], gnss[:, 1])
known = np.tile([config["initpos"][1], config["initpos"][2], *config["initvel"], *config["initatt"]], (len(rows), 1))
out = np.column_stack([np.zeros(len(rows)), rows, lat, known])
np.savetxt(Path(config["outputpath"]) / "KF_GINS_Navresult.nav", out, fmt="%.10f")
"""


def test_a_peer_reads_its_documented_files_and_is_compared_by_its_output(
    small_set: PeerInput, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "KF-GINS"
    program.write_text(FAKE.format(python=sys.executable))
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("OBU_KF_GINS", str(program))
    peer = KfGins()
    peer.sets, peer.outages = ("rtk",), False
    found = peer.measure(tmp_path / "work")
    assert found["absent"] is None
    result = found["sets"]["rtk"]
    assert result["accuracy"]["horizontal_rmse_m"] < 0.01 and result["accuracy"]["yaw_rmse_deg"] == 0.0
    assert result["us_per_sample"] > 0.0 and result["peak_mb"] > 5.0


def test_an_absent_or_failing_peer_is_reported_in_one_sentence(
    small_set: PeerInput, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for peer in PEERS:
        monkeypatch.delenv(peer.variable, raising=False)
        assert f"{peer.variable} names no program." in (peer.measure(tmp_path)["absent"] or "")
    monkeypatch.setenv("OBU_KF_GINS", "/bin/false")
    assert "It was started, but failed" in (KfGins().measure(tmp_path / "work")["absent"] or "")
    assert len(small_set.gnss) > 400
