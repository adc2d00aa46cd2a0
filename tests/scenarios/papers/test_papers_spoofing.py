"""`obu papers spoofing` with nine drives instead of 36; with 36 it is marked slow."""

import json
from pathlib import Path

import numpy as np
import pytest

from cli.papers import papers
from cli.papers.report import Paper, publish
from cli.papers.spoofing.campaign import CUT_OFFS_HZ, Detection, Mode, episodes, measure
from cli.papers.spoofing.paper import (
    COLUMNS,
    REFERENCE_DETECTED,
    REFERENCE_FALSE,
    ModeResult,
    deviations,
    evaluate,
    outside_tolerance,
    reproduce,
)
from services.core.spoofing.windows.metrics import Metric
from shared.errors import UserError

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def paper(tmp_path_factory: pytest.TempPathFactory) -> Paper:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OBU_DATA", str(tmp_path_factory.mktemp("none")))
        return reproduce(9, progress=False)


def test_the_acceptance_limits_hold_and_absent_recordings_are_skipped(paper: Paper) -> None:
    """The paper's thresholds: at most 1 % a metric and 5 % any; replays, climb and drag-off with the gyroscope."""
    assert paper.deviations == []
    assert len(paper.skipped) == 2 and all("set OBU_DATA" in text for text in paper.skipped)


def test_standard_deviations_have_the_size_of_the_reference(
    paper: Paper, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Reference: P 4.6 to 19 deg/s raw, 1.6 to 4.4 windowed; G 0.11 to 0.4 deg/s, 0.07 to 0.09 m/s²."""
    assert publish(paper, json=True, out=tmp_path) == 0
    modes = json.loads(capsys.readouterr().out)["modes"]

    def sigma(mode: str, metric: Metric) -> list[float]:
        found: list[float] = modes[mode]["sigma"][metric.value]
        return found

    heading = Metric.HEADING_RATE
    assert all(4.6 < np.degrees(value) < 19.0 for value in sigma("paper_raw", heading))
    assert all(1.6 < np.degrees(value) < 4.4 for value in sigma("paper", heading))
    assert all(0.11 * 0.75 < np.degrees(value) < 0.4 * 1.25 for value in sigma("gyroscope", heading)[1:3]), (
        "5 to 20 m/s"
    )
    assert all(0.54 * 0.75 < value < 2.31 for value in sigma("paper_raw", Metric.ACCELERATION_EAST))
    assert max(sigma("matched", Metric.ACCELERATION_EAST)) < 0.3 * max(sigma("paper", Metric.ACCELERATION_EAST))
    assert sigma("gyroscope", Metric.ACCELERATION_EAST)[0] == pytest.approx(0.08, rel=0.25)
    assert all(value == pytest.approx(0.18, rel=0.25) for value in sigma("paper_raw", Metric.ALTITUDE_RATE))
    assert all(value == pytest.approx(0.045, rel=0.25) for value in sigma("paper", Metric.ALTITUDE_RATE))
    assert len(list(tmp_path.glob("*.svg"))) == 7


def test_without_barometer_a_climb_is_not_detected(paper: Paper) -> None:
    without = paper.document["without_barometer"]
    assert isinstance(without, dict)
    assert without["attacks"]["climb to 1 m/s"]["within_30_s_percent"] < 50.0
    assert without["attacks"]["static replay"]["within_30_s_percent"] == 100.0


def test_the_cut_off_changes_the_metric_and_removes_it_where_both_sides_are_filtered(paper: Paper) -> None:
    rows = paper.document["cut_offs"]
    assert isinstance(rows, list)
    sigma = {(row["mode"], row["cut_off_hz"]): row["acceleration_sigma_m_s2"] for row in rows}
    assert sigma["paper", 0.06] > 1.1 * max(sigma["paper", 0.03], sigma["paper", 0.45]), "the filter's phase adds"
    assert all(0.21 < sigma["paper", cut_off] < 0.76 for cut_off in CUT_OFFS_HZ), "of an independent computation"
    assert sigma["matched", 0.24] < 0.3 * sigma["matched", 0.03]


def test_the_same_seed_gives_the_same_drive_and_a_wrong_sigma_is_detected() -> None:
    drive = measure(3)
    again = measure(3)
    assert (drive.velocity == again.velocity).all()
    result = evaluate([drive], [again], Mode.GYROSCOPE)
    assert 0.0 < result.false["any"] < 6.0 and result.k >= 3.0
    assert result.validation_episodes_per_hour == 0.0, "threshold of at most one an hour on the same quarter of an hour"


def test_too_few_drives_are_reported_with_an_example() -> None:
    with pytest.raises(UserError, match="--drives 6"):
        papers.spoofing(5, json=False, out=None)


def test_episodes_are_counted_once_however_long_they_last() -> None:
    assert episodes(np.array([True, True, False, True, False, False, True])) == 3


def test_limits_that_are_exceeded_are_deviations() -> None:
    poor = ModeResult({}, {"heading_rate": 1.5, "any": 6.0}, 3.0, 0.0, {
        "static replay": Detection([11], 1), "climb to 1 m/s": Detection([], 1),
        "other drive replayed": Detection([2], 1), "drag-off to 3 m/s": Detection([31, 20], 40),
    })  # fmt: skip
    assert len(deviations({Mode.PAPER_RAW: poor, Mode.GYROSCOPE: poor})) == 5


def test_numbers_more_than_a_quarter_off_the_reference_are_named() -> None:
    exact = dict(zip(COLUMNS, REFERENCE_FALSE[Mode.PAPER_RAW], strict=True))
    shares = {name: Detection([1] * row[0], 100) for name, row in REFERENCE_DETECTED.items()}
    assert outside_tolerance({Mode.PAPER_RAW: ModeResult({}, exact, 3.5, 0.0, shares)}) == []
    off = ModeResult({}, exact | {"any": 0.8}, 3.5, 0.0, shares | {"static replay": Detection([1] * 41, 100)})
    (text,) = outside_tolerance({Mode.PAPER_RAW: off})
    assert "any 0.80 (0.22) %" in text and "static replay 41 (55) %" in text and "climb" not in text


@pytest.mark.recording
def test_the_gyroscope_of_a_phone_agrees_with_the_course_and_its_compass_does_not() -> None:
    from cli.papers.spoofing.campaign import differences
    from cli.papers.spoofing.recorded import RECORDING, phone_drives
    from tests.support.data import recording

    drives = phone_drives(recording(RECORDING))
    assert len(drives) == 4
    for name, drive in drives.items():
        compass, gyroscope = (
            np.degrees(np.nanstd(differences(drive, mode)[Metric.HEADING_RATE]))
            for mode in (Mode.PAPER, Mode.GYROSCOPE)
        )
        assert compass > 2.0, name
        assert gyroscope < (1.5 if name == "2025-06-18" else 0.8), "that phone was handled during the drive"


def test_36_drives_meet_the_acceptance_limits() -> None:
    assert reproduce(36, progress=False).deviations == []
