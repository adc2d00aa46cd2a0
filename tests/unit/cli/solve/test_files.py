import csv
import math

import pytest

from cli.solve.files import HEADER, KML_POINTS, csv_lines, kml_points
from shared.track_files import cut_at_antimeridian
from tests.support.drives.tracks import START_NS, solution, track


def test_the_csv_has_every_column_with_unknown_values_empty() -> None:
    first = solution(0.0).model_copy(update={"gnss_age_s": None})
    rows = list(csv.DictReader(csv_lines(track([first, solution(0.5)]))))
    assert [tuple(row) for row in rows] == [HEADER, HEADER]
    assert rows[0]["gnss_age_s"] == "" and rows[1]["gnss_age_s"] == "0.200"
    assert rows[1]["sampled_ns"] == str(START_NS + 500_000_000)
    assert float(rows[1]["time_s"]) == 0.5 and rows[1]["phase"] == "navigating"
    assert float(rows[1]["latitude_deg"]) == pytest.approx(solution(0.5).latitude_deg, abs=1e-9)
    assert all(math.isfinite(float(value)) for name, value in rows[1].items() if name not in ("phase", "verdict"))
    assert rows[1]["verdict"] == "", "without core.trust"
    judged = csv.DictReader(csv_lines(track([first, solution(0.5)]), ["caution", "safe"]))
    assert [row["verdict"] for row in judged] == ["caution", "safe"]


def test_the_kml_points_are_those_of_the_track_with_their_stamps() -> None:
    points = kml_points(track(solution(0.1 * k) for k in range(30)))
    assert len(points) == 30 and points[-1].time_ns == START_NS + 2_900_000_000
    for point, time_s in ((points[0], 0.0), (points[-1], 2.9)):
        expected = solution(time_s)
        assert point.latitude_deg == pytest.approx(expected.latitude_deg, abs=1e-9)
        assert point.longitude_deg == pytest.approx(expected.longitude_deg, abs=1e-9)
        assert point.height_ellipsoid_m == pytest.approx(300.0)


def test_the_kml_is_in_utc_and_cut_at_the_antimeridian() -> None:
    moved = [
        solution(k).model_copy(update={"longitude_deg": (179.9995 + k * 2e-4 + 180.0) % 360.0 - 180.0})
        for k in range(9)
    ]
    points = kml_points(track(moved), 5_000_000_000)
    assert [point.time_ns for point in points] == [START_NS + (k + 5) * 1_000_000_000 for k in range(9)]
    segments = cut_at_antimeridian(points)
    assert [len(segment) for segment in segments] == [3, 6] and [*segments[0], *segments[1]] == points
    assert cut_at_antimeridian(points[:3]) == [points[:3]]


def test_the_number_of_points_of_the_kml_is_bounded() -> None:
    made = track([solution(0.0)])
    many = type(made)(made.stamps_ns.repeat(90_001), made.phases * 90_001, made.values.repeat(90_001, axis=0))
    assert len(kml_points(many)) <= KML_POINTS + 1
    assert kml_points(track([])) == []
