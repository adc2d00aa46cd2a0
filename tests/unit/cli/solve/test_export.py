import csv
import math
import xml.etree.ElementTree as ET

import pytest

from cli.solve.report.export import HEADER, KML_POINTS, csv_lines, kml_text
from tests.support.tracks import START_NS, solution, track


def test_the_csv_has_every_column_with_unknown_values_empty() -> None:
    first = solution(0.0).model_copy(update={"gnss_age_s": None})
    rows = list(csv.DictReader(csv_lines(track([first, solution(0.5)]))))
    assert [tuple(row) for row in rows] == [HEADER, HEADER]
    assert rows[0]["gnss_age_s"] == "" and rows[1]["gnss_age_s"] == "0.200"
    assert rows[1]["sampled_ns"] == str(START_NS + 500_000_000)
    assert float(rows[1]["time_s"]) == 0.5 and rows[1]["phase"] == "navigating"
    assert float(rows[1]["latitude_deg"]) == pytest.approx(solution(0.5).latitude_deg, abs=1e-9)
    assert all(math.isfinite(float(value)) for name, value in rows[1].items() if name != "phase")


def test_the_kml_is_xml_with_the_track_in_longitude_latitude_order() -> None:
    made = track(solution(0.1 * k) for k in range(30))
    root = ET.fromstring(kml_text(made, "a <drive> & more"))
    space = {"k": "http://www.opengis.net/kml/2.2"}
    assert root.findtext("k:Document/k:name", namespaces=space) == "a <drive> & more"
    text = root.findtext(".//k:coordinates", namespaces=space)
    assert text is not None
    points = [tuple(map(float, point.split(","))) for point in text.split()]
    assert points[0][:2] == pytest.approx((solution(0.0).longitude_deg, solution(0.0).latitude_deg), abs=1e-8)
    assert points[-1][:2] == pytest.approx((solution(2.9).longitude_deg, solution(2.9).latitude_deg), abs=1e-8)


def test_the_number_of_points_of_the_kml_is_bounded() -> None:
    made = track([solution(0.0)])
    many = type(made)(made.stamps_ns.repeat(90_001), made.phases * 90_001, made.values.repeat(90_001, axis=0))
    assert kml_text(many, "long").count(",300.00") <= KML_POINTS + 1
